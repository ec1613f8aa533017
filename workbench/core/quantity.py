"""Numbers with a unit and a range: fields of the sections of a file."""

import math
from ast import literal_eval
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.core.errors import UserError

NO_UNIT = "1"
"""Unit of a dimensionless number, a name, a flag or a count."""
STANDARD_GRAVITY = 9.80665
"""What a sensor calls 1 g, m/s2 (CGPM 1901)."""


def quantity(unit: str, description: str, interval: str = "", **options: Any) -> Any:
    """Declare a field of `QuantityModel`.

    Args:
        unit: SI unit as written in the YAML files, `1` when dimensionless.
        description: what the number is, in one line.
        interval: values allowed, in that unit, such as `(0, 30]`: above 0 and at most 30.
        options: of pydantic's `Field`; a one-sided limit such as `gt`, `min_length`, `default`.
    """
    if interval:
        options |= limits_of(interval)
    described: Any = {"unit": unit}
    return Field(description=description, json_schema_extra=described, **options)


def limits_of(interval: str) -> dict[str, float]:
    """Read an interval such as `(0, 30]` as pydantic's limits: `{"gt": 0, "le": 30}`."""
    low, high = interval[1:-1].split(", ")
    lower = {"(": "gt", "[": "ge"}[interval[0]]
    upper = {")": "lt", "]": "le"}[interval[-1]]
    return {lower: literal_eval(low), upper: literal_eval(high)}


class QuantityModel(BaseModel):
    """Frozen section of a scenario. Unknown keys, NaN and foreign units are refused.

    A value is a plain number in the unit of the field or a text that repeats that unit, such as
    `3.33 m/s`. Another unit is an error and not converted: a scenario has one reading.
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
        expected = unit_of(cls, key)
        if unit.strip() not in ("", expected):
            raise ValueError(
                f"{key}: {value!r} has the unit {unit.strip()!r}; allowed is {expected!r}"
            )
        try:
            return field.annotation(number)
        except ValueError:
            return value


def unit_of(model: type[BaseModel], key: str) -> str:
    """Unit that `quantity` declared for a field; `1` for fields without one."""
    extra = model.model_fields[key].json_schema_extra
    if isinstance(extra, dict):
        return str(extra.get("unit", NO_UNIT))
    return NO_UNIT


def check_range(
    name: str,
    value: float,
    low: float,
    high: float,
    unit: str,
    *,
    above_low: bool = False,
    error: type[UserError] = UserError,
) -> None:
    """Raises UserError (of the class `error`) unless `value` is finite and within [low, high]; see
    `above_low`.

    Args:
        name: where the value comes from, e.g. "controller.swing_speed".
        value: in the unit of the limits.
        low: smallest value allowed.
        high: largest value allowed; may be infinite.
        unit: printed after value and limits.
        above_low: refuse `low` itself.
    """
    if math.isfinite(value) and value <= high and (value > low if above_low else value >= low):
        return
    limits = {f"{'>' if above_low else '>='} {low:g}": low, f"<= {high:g}": high}
    if unit == NO_UNIT:
        shown = ""
    else:
        shown = f" {unit}"
    allowed = " and ".join(text for text, limit in limits.items() if math.isfinite(limit))
    raise error(
        f"{name}: {value:g}{shown}; allowed: {allowed + shown if allowed else 'a finite number'}"
    )
