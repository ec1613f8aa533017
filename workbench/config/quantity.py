"""Physical quantities in pydantic models: every number states its unit, its range and what it is."""

import difflib
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

NO_UNIT = "1"
"""Unit of a dimensionless number, a name, a flag or a count."""


def quantity(unit: str, description: str, **limits: float) -> Any:
    """Declares a field of `QuantityModel`.

    Args:
        unit: SI unit as written in the YAML files, `1` when dimensionless.
        description: what the number is, in one line.
        limits: pydantic's `ge`, `gt`, `le`, `lt`, in that unit.
    """
    described: Any = {"unit": unit}
    bounds: Any = limits
    return Field(description=description, json_schema_extra=described, **bounds)


class QuantityModel(BaseModel):
    """Frozen section of a scenario. Unknown keys, NaN and foreign units are refused.

    A value is a plain number in the unit of the field or a text that repeats that unit, such as `3.33 m/s`.
    Another unit is an error and not converted: a scenario has one reading.
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
            raise ValueError(f"{key}: {value!r} has the unit {unit.strip()!r}; allowed is {expected!r}")
        try:
            return field.annotation(number)
        except ValueError:
            return value


def unit_of(model: type[BaseModel], key: str) -> str:
    """Unit that `quantity` declared for a field; `1` for fields without one."""
    extra = model.model_fields[key].json_schema_extra
    return str(extra.get("unit", NO_UNIT)) if isinstance(extra, dict) else NO_UNIT


def nearest(name: str, known: list[str]) -> str:
    """Tail of an error about an unknown name: the closest known one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {close[0]!r}?" if close else "allowed: " + ", ".join(sorted(known))
