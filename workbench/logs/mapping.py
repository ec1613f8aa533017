"""The mapping file: which foreign column, in which unit, is which column of a run log.

Schema `aerodima/log-mapping/1`, YAML, strict; `workbench/logs/README.md` explains it with an
example that runs.
"""

from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, StrictBool, StrictFloat, StrictInt, model_validator

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Json, Settings
from aerodima.workbench.core.key_errors import nearest
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
Name = Annotated[str, Field(min_length=1)]


@cache
def _tables() -> dict[str, Json]:
    """Reads units, their spellings and the endings of names."""
    return read_yaml(Path(__file__).with_name("units.yaml"), LogError)


def unit_factor(name: str, si: str, where: str) -> float:
    """Looks up the SI value of one unit called `name`, which measures the quantity whose SI unit is
    `si`.

    Args:
        name: unit as written in a mapping file, `deg/s`; `Nm`, `°` and the like are understood too.
        si: SI unit of a column, `Column.unit`; "" counts as `1`.
        where: place named in the message.

    Raises:
        LogError: no such unit, or one of another quantity (`g` is an acceleration or a mass, as
            `si` says).
    """
    wanted = si or "1"
    name = _tables()["spellings"].get(name.strip(), name.strip())
    units = _tables()["units"].get(wanted, {wanted: 1.0})
    if name in units:
        return units[name]
    if any(name in table for table in _tables()["units"].values()):
        raise LogError(
            f"{where}: unit {name!r} does not measure what is in {wanted}; it must be one of "
            f"{', '.join(units)}"
        )
    raise LogError(f"{where}: unknown unit {name!r}; {nearest(name, units)}")


def time_factor(unit: str, where: str) -> float | None:
    """Looks up the seconds of one unit of time; None for the form of a date, such as
    `%d.%m.%Y %H:%M:%S`.
    """
    return None if "%" in unit else unit_factor(unit, "s", where)


def unit_in_name(name: str) -> str:
    """Reads the SI unit at the end of a name, `wind_speed_m_per_s` -> `m/s`; "" without one."""
    return next(
        (unit for suffix, unit in _tables()["endings"].items() if name.endswith(suffix)), ""
    )


class ColumnSource(StrictModel):
    """Source of a column of the run log: SI value = scale * unit * (foreign value - zero)."""

    from_: str | None = Field(
        None, alias="from", description="name of the foreign column", min_length=1
    )
    constant: StrictFloat | StrictInt | None = Field(
        None, description="SI value that is the same in each row, instead of `from`"
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
        further = self.model_fields_set - {"from_", "constant", "largest"}
        if further and self.from_ is None:
            names = ", ".join(sorted(further))
            raise ValueError(f"constant: is an SI value; must be without {names}")
        if self.time_unit is not None:
            time_factor(self.time_unit, "time_unit")
        if self.scale == 0.0:
            raise ValueError("scale: a scale of 0 would delete the signal")
        return self


class TimeSource(StrictModel):
    """Source of the times of the log's rows."""

    from_: str = Field(alias="from", description="foreign column with the times", min_length=1)
    unit: str = Field(
        "s", description="unit of the foreign times, or the form of a date, `%d.%m.%Y %H:%M:%S`"
    )
    offsets: dict[int, Number] = Field(
        default_factory=dict,
        description="seconds to add to the times of a file with another clock, by its number, "
        "from 2",
    )
    starts_at: Number | None = Field(
        None, description="time of the first row, s; all times are shifted"
    )
    repeated: Literal["first", "last"] | None = Field(
        None, description="row that counts among those with the same time; an error when left out"
    )


class MetadataValue(StrictModel):
    """A fact about the whole log that is not in its SI unit, `{value: 36, unit: km/h}`."""

    value: StrictFloat | StrictInt
    unit: str


class CsvFormat(StrictModel):
    """Format of a text file."""

    delimiter: str = Field(
        default=",",
        description="character between cells; `\\t` for tabs",
        min_length=1,
        max_length=1,
    )
    decimal: Literal[".", ","] = Field(default=".", description="decimal sign")
    names: tuple[str, ...] | None = Field(
        default=None,
        description="names of the columns of a file without a line of names; `[]`: 1, 2, ...",
    )
    skip_lines: int = Field(
        default=0, description="number of lines before the line with the names", ge=0
    )
    skip_after_names: int = Field(
        default=0,
        description="number of lines after the line with the names, with units for example",
        ge=0,
    )
    comment: str | None = Field(
        default=None,
        description="character from which the rest of a line is ignored",
        min_length=1,
        max_length=1,
    )
    encoding: str = Field(default="utf-8-sig", description="text encoding")


class ScenarioSource(StrictModel):
    """The car and its manoeuvre, or the rig: a name or file, and overrides such as
    `manoeuvre.speed=4`.
    """

    base: str = Field(description="shipped scenario, or YAML file by its path from the mapping's")
    set: Settings = Field((), description="overrides, section.key=value")


class Mapping(StrictModel):
    """Content of a mapping file."""

    schema_: Literal["aerodima/log-mapping/1"] = Field(
        alias="schema", description="schema of the file"
    )
    kind: Literal["static", "swing", "bar_swing", "robot_swing", "car_log", "car_run"] = Field(
        description="kind of experiment or drive that was logged"
    )
    stamps: dict[str, tuple[Name, Name]] = Field(
        default_factory=dict,
        description="new foreign column of times -> seconds and nanoseconds, or date and time of "
        "day",
    )
    quaternions: dict[str, tuple[Name, Name, Name, Name]] = Field(
        default_factory=dict,
        description="name -> w, x, y, z, which turn the axes of the body to those of the world; "
        "makes the foreign columns `<name>.roll`, `.pitch` and `.yaw`, rad",
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
    csv: CsvFormat = Field(default_factory=CsvFormat, description="format of a text file")
    sparse: StrictBool = Field(
        False, description="true: an empty cell is not a lost sample (several rates in one table)"
    )
    check_rates: StrictBool = Field(
        True, description="true: every logged rate is compared with the derivative of its angle"
    )
    scenario: ScenarioSource | None = Field(
        None, description="scenario that was driven; for a rig log, the rig"
    )
    _folder: Path = PrivateAttr(Path())

    @model_validator(mode="after")
    def _columns_and_units_are_known(self) -> Self:
        problems = []
        for name in self.columns:
            try:
                self.unit_factor(name)
            except LogError as error:
                problems.append(str(error))
        if self.kind in RIG_KINDS and "angle_rad" not in self.columns:
            problems.append(f"columns: a log of kind {self.kind!r} needs angle_rad")
        if problems:
            raise ValueError("; ".join(problems))
        time_factor(self.time.unit, "time")
        _ = self.facts
        return self

    @property
    def folder(self) -> Path:
        """Folder of the mapping file; the working folder for a mapping without a file."""
        return self._folder

    @property
    def facts(self) -> Json:
        """Converts the metadata to SI units."""
        facts: Json = dict(self.metadata)
        for name, value in self.metadata.items():
            if isinstance(value, MetadataValue):
                factor = unit_factor(value.unit, unit_in_name(name), f"metadata.{name}")
                facts[name] = value.value * factor
        return facts

    def unit_factor(self, name: str) -> float:
        """Looks up the SI value of the foreign unit of column `name` of the run log; LogError if
        there is no such column or unit.
        """
        known = known_columns()
        if name == TIME:
            raise LogError(f"columns.{name}: times are mapped under `time`")
        if name not in known:
            raise LogError(f"columns.{name}: no such column; {nearest(name, known)}")
        unit = self.columns[name].unit
        if unit is None:
            return 1.0
        return unit_factor(unit, known[name].unit, f"columns.{name}")


def known_columns() -> dict[str, Column]:
    """Lists every column that a mapping may fill, by name: of the rig, of the car, and of its truth
    (motion capture).
    """
    return {column.name: column for column in [*rig_columns(), *sensor_columns(), *truth_columns()]}


def load_mapping(path: Path | str) -> Mapping:
    """Reads a mapping file.

    Raises:
        LogError: missing, not YAML, unknown key or column, unit of another quantity; names file,
            key and what is allowed.
    """
    mapping = mapping_from(read_yaml(Path(path), LogError), str(path))
    mapping._folder = Path(path).parent
    return mapping


def mapping_from(data: Json, where: str = "mapping") -> Mapping:
    """Checks the content of a mapping file; LogError as for `load_mapping`."""
    return checked(Mapping, data, where, LogError)
