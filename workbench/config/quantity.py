"""Physical quantities: every number of a model states its unit, its range and what it is; units of foreign logs.

The units are a table and not a unit library: a log needs some forty units, and a unit that is not here must be an error
in any case.
"""

import difflib
import math
from collections.abc import Collection
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from aerodima.workbench.errors import LogError, UserError

NO_UNIT = "1"
"""Unit of a dimensionless number, a name, a flag or a count."""


def quantity(unit: str, description: str, **limits: float) -> Any:
    """Declares a field of `QuantityModel`.

    Args:
        unit: SI unit as written in the YAML files, `1` when dimensionless.
        description: what the number is, in one line.
        limits: pydantic's `ge`, `gt`, `le`, `lt`, and `default` where the file may leave it out, in that unit.
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


def nearest(name: str, known: Collection[str]) -> str:
    """Tail of an error about an unknown name: the closest known one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {close[0]!r}?" if close else "allowed: " + ", ".join(sorted(known))


STANDARD_GRAVITY = 9.80665
"""What a sensor calls 1 g, m/s2 (CGPM 1901)."""

_MILE, _NAUTICAL_MILE = 1609.344, 1852.0
_FACTORS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "rad/s": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": math.pi / 180.0,
        "rev/s": 2.0 * math.pi,
        "rpm": 2.0 * math.pi / 60.0,
    },
    "A": {"A": 1.0, "mA": 1e-3, "uA": 1e-6},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": STANDARD_GRAVITY, "gf": STANDARD_GRAVITY * 1e-3},
    "N m": {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2, "N mm": 1e-3, "kgf cm": STANDARD_GRAVITY * 1e-2},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3},
    "m/s": {
        "m/s": 1.0,
        "mm/s": 1e-3,
        "cm/s": 1e-2,
        "km/h": 1.0 / 3.6,
        "mph": _MILE / 3600,
        "kn": _NAUTICAL_MILE / 3600,
    },
    "m/s2": {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3},
    "W": {"W": 1.0, "mW": 1e-3, "kW": 1e3},
    "N s": {"N s": 1.0},
    "N m s": {"N m s": 1.0},
    "N m/rad": {"N m/rad": 1.0, "N m/deg": 180.0 / math.pi},
    "N m s/rad": {"N m s/rad": 1.0, "N m s/deg": 180.0 / math.pi},
    "kg": {"kg": 1.0, "g": 1e-3},
    "1": {"1": 1.0, "%": 1e-2},
}
_SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "dps": "deg/s", "radians": "rad",
    "sec": "s", "seconds": "s", "µs": "us", "kph": "km/h", "kmh": "km/h", "knots": "kn", "mps": "m/s",
    "m/s^2": "m/s2", "m/s²": "m/s2", "Nm": "N m", "N*m": "N m", "N·m": "N m", "mNm": "mN m", "Nmm": "N mm",
    "Ncm": "N cm", "percent": "%", "": "1", "-": "1", "amp": "A", "kgf*cm": "kgf cm",
}  # fmt: skip

_SUFFIXES = {
    "_rad_per_s": "rad/s", "_m_per_s2": "m/s2", "_m_per_s": "m/s", "_n_m_s": "N m s", "_n_m": "N m", "_n_s": "N s",
    "_rad": "rad", "_kg": "kg", "_n": "N", "_m": "m", "_w": "W", "_a": "A", "_s": "s",
}  # fmt: skip


def unit_factor(name: str, si: str, where: str) -> float:
    """SI value of one unit called `name`, which measures the quantity whose SI unit is `si`.

    Args:
        name: as written in a mapping file, `deg/s`; `Nm`, `°` and the like are understood too.
        si: `Column.unit`; "" counts as `1`.
        where: place named in the message.

    Raises:
        LogError: no such unit, or one of another quantity (`g` is an acceleration or a mass, as `si` says).
    """
    wanted = si or "1"
    name = _SPELLINGS.get(name.strip(), name.strip())
    units = _FACTORS.get(wanted, {wanted: 1.0})
    if name in units:
        return units[name]
    allowed = ", ".join(units)
    others = [other for other, table in _FACTORS.items() if name in table]
    if others:
        raise LogError(f"{where}: unit {name!r} does not measure what is in {wanted}; allowed: {allowed}")
    raise LogError(f"{where}: unknown unit {name!r}; {nearest(name, units)}")


def unit_in_name(name: str) -> str:
    """SI unit at the end of a column or metadata name, `wind_speed_m_per_s` -> `m/s`; `1` when there is none."""
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(suffix):
            return unit
    return "1"


def check_range(name: str, value: float, low: float, high: float, unit: str, *, above_low: bool = False) -> None:
    """Raises UserError unless `value` is finite and within [low, high], or (low, high] with `above_low`.

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
    lower = f"{'>' if above_low else '>='} {low:g}"
    upper = f" and <= {high:g}" if math.isfinite(high) else ""
    raise UserError(f"{name}: {value:g} {unit}; allowed: {lower}{upper} {unit}")
