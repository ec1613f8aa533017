"""Numbers with a unit and a range: fields of the sections of a file."""

import math
from ast import literal_eval
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.ranges import NO_UNIT, check_range

STANDARD_GRAVITY = 9.80665
"""Acceleration that a sensor calls 1 g, m/s2 (CGPM 1901)."""
RATE_TOLERANCE = 1e-9
"""Relative tolerance for rounding in a rate of exactly 1/step or a delay of whole periods."""


def quantity(unit: str, description: str, interval: str = "", **options: Any) -> Any:
    """Declare a field of `QuantityModel`.

    Args:
        unit: SI unit as written in the YAML files, `1` when dimensionless.
        description: what the number is, in one line.
        interval: values allowed, in that unit, such as `(0, 30]`: above 0 and at most 30.
        options: further options of pydantic's `Field`, such as a one-sided limit `gt`,
            `min_length` or `default`.
    """
    if interval:  # (0, 30] is {"gt": 0, "le": 30}
        low, high = interval[1:-1].split(", ")
        options[{"(": "gt", "[": "ge"}[interval[0]]] = literal_eval(low)
        options[{")": "lt", "]": "le"}[interval[-1]]] = literal_eval(high)
    described: Any = {"unit": unit}
    return Field(description=description, json_schema_extra=described, **options)


class QuantityModel(BaseModel):
    """Frozen section of a scenario; unknown keys, NaN and foreign units are refused.

    A value is a plain number in the unit of the field or a text that repeats that unit, such as
    `3.33 m/s`. Another unit is an error and is not converted: a scenario has one reading only.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _read_units(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        return {key: cls._read_value(key, value) for key, value in data.items()}

    @classmethod
    def _read_value(cls, key: str, value: Any) -> Any:
        field = cls.model_fields.get(key)
        if field is None or field.annotation not in (float, int) or not isinstance(value, str):
            return value
        number, _, unit = value.strip().partition(" ")
        allowed = unit_of(cls, key)
        if unit.strip() not in ("", allowed):
            hint = angle_hint(allowed)
            raise ValueError(f"{key}: unit {unit.strip()!r} must be {allowed!r}{hint}")
        try:
            return field.annotation(number)
        except ValueError:
            return value


def unit_of(model: type[BaseModel], key: str) -> str:
    """Look up the unit that `quantity` declared for a field; `1` for fields without one."""
    extra = model.model_fields[key].json_schema_extra
    if isinstance(extra, dict):
        return str(extra.get("unit", NO_UNIT))
    return NO_UNIT


def angle_hint(unit: str) -> str:
    """Return a hint on the size of a degree where the unit is rad; "" for other units."""
    return "; 1 degree is 0.0174533 rad" if unit == "rad" else ""


def check_rate(rate: float, step: float, name: str) -> None:
    """Raise ScenarioError unless 0 < rate <= 1/step: a plant that moves every `step` shows nothing
    new in between.

    Args:
        rate: rate that is checked, Hz.
        step: time step of the plant, s.
        name: name of the setting that holds the rate, e.g. "imu.rate".
    """
    check_range(name, rate, 0.0, math.inf, "Hz", above_low=True, error=ScenarioError)
    if rate * step > 1.0 + RATE_TOLERANCE:
        raise ScenarioError(
            f"{name}: {rate:g} Hz must be at most 1/step, {1.0 / step:g} Hz with step {step:g} s"
        )
