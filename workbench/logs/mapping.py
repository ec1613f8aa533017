"""The mapping file: which foreign column, in which unit, is which column of a run log.

Schema `aerodima/log-mapping/1`, YAML, strict; `workbench/logs/README.md` explains it with an
example that runs.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StrictBool, StrictFloat, StrictInt, field_validator, model_validator

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.scenario.signal_table import (
    RIG_KINDS,
    TIME,
    Column,
    rig_columns,
    sensor_columns,
    truth_columns,
)

Number = Annotated[float, Field(strict=False)]

_DEGREE = math.pi / 180.0
"""One degree, rad."""
_KMH = 1.0 / 3.6
"""One kilometre per hour, m/s."""
_MPH = 1609.344 / 3600
"""One mile per hour, m/s."""
_KNOT = 1852.0 / 3600
"""One knot, m/s."""
_FACTORS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "rev": 2.0 * math.pi},
    "rad/s": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": _DEGREE,
        "rev/s": 2.0 * math.pi,
        "rpm": 2.0 * math.pi / 60.0,
    },
    "A": {"A": 1.0, "mA": 1e-3, "uA": 1e-6},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": STANDARD_GRAVITY, "gf": STANDARD_GRAVITY * 1e-3},
    "N m": {
        "N m": 1.0,
        "mN m": 1e-3,
        "N cm": 1e-2,
        "N mm": 1e-3,
        "kgf cm": STANDARD_GRAVITY * 1e-2,
    },
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": _KMH, "mph": _MPH, "kn": _KNOT},
    "m/s2": {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY * 1e-3},
    "W": {"W": 1.0, "mW": 1e-3, "kW": 1e3},
    "kg": {"kg": 1.0, "g": 1e-3},
    "1": {"1": 1.0, "%": 1e-2},
}
_SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "°/s": "deg/s", "dps": "deg/s", "radians": "rad",
    "sec": "s", "seconds": "s", "µs": "us", "kph": "km/h", "kmh": "km/h", "knots": "kn",
    "mps": "m/s",
    "m/s^2": "m/s2", "m/s²": "m/s2", "Nm": "N m", "N*m": "N m", "N·m": "N m", "mNm": "mN m",
    "Nmm": "N mm",
    "Ncm": "N cm", "percent": "%", "": "1", "-": "1", "amp": "A", "kgf*cm": "kgf cm",
}  # fmt: skip

_SUFFIXES = {
    "_rad_per_s": "rad/s", "_m_per_s2": "m/s2", "_m_per_s": "m/s", "_n_m_s": "N m s",
    "_n_m": "N m", "_n_s": "N s",
    "_rad": "rad", "_kg": "kg", "_n": "N", "_m": "m", "_w": "W", "_a": "A", "_s": "s",
}  # fmt: skip


def unit_factor(name: str, si: str, where: str) -> float:
    """SI value of one unit called `name`, which measures the quantity whose SI unit is `si`.

    Args:
        name: as written in a mapping file, `deg/s`; `Nm`, `°` and the like are understood too.
        si: `Column.unit`; "" counts as `1`.
        where: place named in the message.

    Raises:
        LogError: no such unit, or one of another quantity (`g` is an acceleration or a mass, as
            `si` says).
    """
    wanted = si or "1"
    name = _SPELLINGS.get(name.strip(), name.strip())
    units = _FACTORS.get(wanted, {wanted: 1.0})
    if name in units:
        return units[name]
    allowed = ", ".join(units)
    others = [other for other, table in _FACTORS.items() if name in table]
    if others:
        raise LogError(
            f"{where}: unit {name!r} does not measure what is in {wanted}; allowed: {allowed}"
        )
    raise LogError(f"{where}: unknown unit {name!r}; {nearest(name, units)}")


def unit_in_name(name: str) -> str:
    """SI unit at the end of a column or metadata name, `wind_speed_m_per_s` -> `m/s`; `1` when
    there is none.
    """
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(suffix):
            return unit
    return "1"


class ColumnSource(StrictModel):
    """Where one of our columns comes from: SI value = scale * unit * (foreign value - zero)."""

    from_: str | None = Field(
        None, alias="from", description="name of the foreign column", min_length=1
    )
    constant: StrictFloat | StrictInt | None = Field(
        None, description="instead of `from`: the same SI value in each row"
    )
    unit: str | None = Field(
        None, description="unit of the foreign column; the SI unit when left out"
    )
    scale: Number = Field(
        1.0, description="further factor: -1 turns a sign, 1.18e-4 makes rad of counts"
    )
    zero: Number = Field(0.0, description="foreign value that means zero, in the foreign unit")
    time: str | None = Field(None, description="foreign column with this column's own times")
    time_unit: str | None = Field(
        None, description="unit of `time`; that of the log's time when left out"
    )
    largest: Number | None = Field(
        None, description="largest plausible magnitude in the SI unit", gt=0
    )

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        if (self.from_ is None) == (self.constant is None):
            raise ValueError("needs either `from` or `constant`")
        if self.time_unit is not None:
            unit_factor(self.time_unit, "s", "time_unit")
        return self

    @field_validator("scale")
    @classmethod
    def _not_zero(cls, value: float) -> float:
        if value == 0.0:
            raise ValueError("a scale of 0 would delete the signal")
        return value


class TimeSource(StrictModel):
    """The time of the log's rows."""

    from_: str = Field(alias="from", description="foreign column with the times", min_length=1)
    unit: str = Field("s", description="unit of the foreign times")
    starts_at: Number | None = Field(
        None, description="shift times so that the first row has this one, s"
    )


class MetadataValue(StrictModel):
    """A fact about the whole log that is not in its SI unit, `{value: 36, unit: km/h}`."""

    value: StrictFloat | StrictInt
    unit: str


class CsvFormat(StrictModel):
    """How a text file is written."""

    delimiter: str = Field(
        default=",", description="between cells; `\\t` for tabulators", min_length=1, max_length=1
    )
    decimal: Literal[".", ","] = Field(default=".", description="decimal sign")
    skip_lines: int = Field(default=0, description="lines before the line with the names", ge=0)
    skip_after_names: int = Field(
        default=0, description="lines after it, with units for example", ge=0
    )
    comment: str | None = Field(
        default=None, description="lines from this sign on are left out", min_length=1, max_length=1
    )
    encoding: str = Field(default="utf-8-sig", description="text encoding")


class ScenarioSource(StrictModel):
    """The car and what was driven, or the rig: a name or file, and overrides such as
    `manoeuvre.speed=4`.
    """

    base: str = Field(description="shipped scenario or YAML file")
    set: tuple[str, ...] = Field((), description="overrides, section.key=value")


class Mapping(StrictModel):
    """A mapping file."""

    schema_: Literal["aerodima/log-mapping/1"] = Field(
        alias="schema", description="schema of the file"
    )
    kind: Literal["static", "swing", "bar_swing", "robot_swing", "car_log", "car_run"] = Field(
        description="what was logged"
    )
    time: TimeSource
    columns: dict[str, ColumnSource] = Field(
        description="our column -> where it comes from", min_length=1
    )
    metadata: dict[
        str, StrictBool | StrictFloat | StrictInt | str | MetadataValue | tuple[Number, ...]
    ] = Field(
        default_factory=dict,
        description="facts about the whole log: tail, axis, wind_speed_m_per_s, ...",
    )
    csv: CsvFormat = Field(default_factory=CsvFormat, description="how a text file is written")
    sparse: StrictBool = Field(
        False, description="an empty cell is no lost sample: several rates in one table"
    )
    check_rates: StrictBool = Field(
        True, description="compare every logged rate with the derivative of its angle"
    )
    scenario: ScenarioSource | None = Field(
        None, description="what was driven; for a rig log, the rig"
    )

    @model_validator(mode="after")
    def _columns_and_units_are_known(self) -> Self:
        known = known_columns()
        for name in self.columns:
            if name == TIME:
                raise ValueError(f"columns.{name}: times are mapped under `time`")
            if name not in known:
                raise ValueError(f"columns.{name}: no such column; {nearest(name, known)}")
            self.unit_factor(name)
        unit_factor(self.time.unit, "s", "time")
        _ = self.facts
        if self.kind in RIG_KINDS and "angle_rad" not in self.columns:
            raise ValueError(f"columns: a log of kind {self.kind!r} needs angle_rad")
        return self

    @property
    def facts(self) -> dict[str, Any]:
        """Metadata in SI units."""
        return {
            name: value.value * unit_factor(value.unit, unit_in_name(name), f"metadata.{name}")
            if isinstance(value, MetadataValue)
            else value
            for name, value in self.metadata.items()
        }

    def unit_factor(self, name: str) -> float:
        """SI value of one foreign unit of our column `name`."""
        unit = self.columns[name].unit
        si = known_columns()[name].unit
        if unit is None:
            return 1.0
        return unit_factor(unit, si, f"columns.{name}")


def known_columns() -> dict[str, Column]:
    """Every column that a mapping may fill, by name: of the rig, of the car, and of its truth
    (motion capture).
    """
    return {column.name: column for column in [*rig_columns(), *sensor_columns(), *truth_columns()]}


def load_mapping(path: Path | str) -> Mapping:
    """Reads a mapping file.

    Raises:
        LogError: missing, not YAML, unknown key or column, unit of another quantity; names file,
            key and what is allowed.
    """
    return mapping_from(read_yaml(Path(path), LogError), str(path))


def mapping_from(data: dict[str, Any], where: str = "mapping") -> Mapping:
    """A mapping from the content of its file; LogError as for `load_mapping`."""
    return checked(Mapping, data, where, LogError)
