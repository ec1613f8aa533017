"""A conditioning recipe: the steps that make a log fit for identification, in a YAML file.

Schema `aerodima/log-recipe/1`, strict; `workbench/logs/README.md` explains every step. What was done stands in the
conditioned log's metadata (`extra.conditioning`), filters included: an interval needs to know how many independent
samples are left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StrictBool, model_validator

from aerodima.workbench.config.checked_files import StrictModel, checked, read_yaml
from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.config.signal_table import RIG_KINDS
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs import conditioning
from aerodima.workbench.logs.conditioning import Conditioned
from aerodima.workbench.logs.mapping import known_columns
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import (
    GPS_FILTER,
    IMU_FILTER,
    RIG_FILTER_10_HZ,
    RIG_FILTER_20_HZ,
    Interval,
    LowPass,
    check_signals,
    resting_parts,
)

DESIGNS = {"rig_10_hz": RIG_FILTER_10_HZ, "rig_20_hz": RIG_FILTER_20_HZ, "imu": IMU_FILTER, "gps": GPS_FILTER}
"""Filters by name: those of the thesis (design section 11)."""
MOST_ROWS_PER_S = 1e5
"""Of a resampled log: a hundred times the rigs' rate; a slip of the exponent would fill the memory."""
RIG_REST: Mapping[str, Interval] = {"angular_velocity_rad_per_s": (-0.02, 0.02), "angle_rad": (-0.1, 0.1)}
"""The rig rests when the tail hangs and does not move; a tail held up is loaded, so it is not at rest."""
CAR_REST: Mapping[str, Interval] = {"speed_m_per_s": (-0.2, 0.2), "imu_gyro_z_rad_per_s": (-0.1, 0.1)}
"""The car rests when it stands."""

Columns = Annotated[tuple[str, ...], Field(description="names, `*` stands for any text", min_length=1)]
Limits = Annotated[tuple[float, float], Field(description="lowest and highest value")]


class Rest(StrictModel):
    """What counts as rest."""

    within: dict[str, Limits] | None = Field(
        default=None, description="column -> limits; by default those of the rig or the car"
    )
    shortest_s: float = Field(default=0.5, description="a shorter standstill is not rest", gt=0)
    parts: tuple[Limits, ...] | None = Field(
        default=None, description="instead of detection: first and last time of each part, s", min_length=1
    )


class Fill(StrictModel):
    """Bridge gaps and NaN by straight lines."""

    step: Literal["fill"]
    longest_s: float = Field(description="longest gap that is bridged, s", gt=0)


class KeepLongest(StrictModel):
    """Keep the longest piece without gap and NaN."""

    step: Literal["keep_longest"]


class Cut(StrictModel):
    """Keep the rows between two times."""

    step: Literal["cut"]
    from_s: float | None = Field(default=None, description="first time, s; the first row when left out")
    to_s: float | None = Field(default=None, description="last time, s; the last row when left out")
    restart_time: StrictBool = Field(default=False, description="the first row gets the time 0")


class CutToMotion(StrictModel):
    """Keep the motion between two rests, and some rest around it."""

    step: Literal["cut_to_motion"]
    before_s: float = Field(default=0.2, description="rest kept before the motion, s", ge=0)
    after_s: float = Field(default=0.2, description="rest kept after it, s", ge=0)
    restart_time: StrictBool = Field(default=False, description="the first row gets the time 0")


class Filter(StrictModel):
    """Zero-phase Butterworth low pass."""

    step: Literal["filter"]
    columns: Columns
    design: Literal["rig_10_hz", "rig_20_hz", "imu", "gps"] | None = Field(
        default=None, description="one of the thesis' filters"
    )
    order: int | None = Field(default=None, description="order, when no design is named", ge=1, le=10)
    cutoff_hz: float | None = Field(default=None, description="cut-off frequency, when no design is named", gt=0)

    @model_validator(mode="after")
    def _is_named_or_designed(self) -> Self:
        if (self.design is None) == (self.order is None or self.cutoff_hz is None):
            raise ValueError("needs `design`, or `order` and `cutoff_hz`")
        return self


class Drift(StrictModel):
    """Subtract the line through the resting parts."""

    step: Literal["drift"]
    columns: Columns
    level: Literal["zero", "keep"] = Field(
        default="zero", description="`keep` when the true signal at rest is not zero"
    )


class Offsets(StrictModel):
    """Add the offsets that the force sensor was zeroed at."""

    step: Literal["offsets"]
    tail: Literal["1", "2", "3"] | None = Field(
        default=None, description="tail of Table 4.4; that of the log when left out"
    )


class Resample(StrictModel):
    """Put the log on an even grid."""

    step: Literal["resample"]
    rate_hz: float = Field(description="rows per second", gt=0, le=MOST_ROWS_PER_S)


class Differentiate(StrictModel):
    """Make a rate out of an angle."""

    step: Literal["differentiate"]
    angle: str = Field(default="angle_rad", description="column of the angle")
    rate: str = Field(default="angular_velocity_rad_per_s", description="column that is made")


Step = Annotated[
    Fill | KeepLongest | Cut | CutToMotion | Filter | Drift | Offsets | Resample | Differentiate,
    Field(discriminator="step"),
]


class Recipe(StrictModel):
    """A recipe file."""

    schema_: Literal["aerodima/log-recipe/1"] = Field(alias="schema", description="schema of the file")
    rest: Rest = Field(default_factory=Rest, description="what counts as rest")
    steps: tuple[Step, ...] = Field(description="in the order in which they are done", min_length=1)


@dataclass(frozen=True)
class RecipeResult:
    """The conditioned log, what was done, and the resting parts that were used (s, in the times of the first log)."""

    run_log: RunLog
    notes: tuple[str, ...]
    rest: tuple[Interval, ...]


def load_recipe(path: Path | str) -> Recipe:
    """Reads a recipe; LogError names file, step, key and what is allowed."""
    return recipe_from(read_yaml(Path(path), LogError), str(path))


def recipe_from(data: dict[str, Any], where: str = "recipe") -> Recipe:
    """A recipe from the content of its file; LogError as for `load_recipe`."""
    return checked(Recipe, data, where, LogError)


def apply_recipe(run_log: RunLog, recipe: Recipe) -> RecipeResult:
    """Conditions a log. The result has sorted times, no gap and no NaN.

    Raises:
        LogError: a step cannot be done (names the step, the column and the time), or a gap or NaN is left.
    """
    notes: list[str] = []
    rest: list[Interval] = []
    before, shift, shown = run_log, 0.0, []
    for number, step in enumerate(recipe.steps):
        if isinstance(step, Drift | CutToMotion):
            rest = _rest_of(run_log, recipe.rest, step.step)
            shown = [(start + shift, end + shift) for start, end in rest]
        try:
            done = _apply(run_log, step, rest)
        except LogError as error:
            raise LogError(f"{error} (step {number + 1}, {step.step})") from None
        run_log, shift = done.run_log, shift + done.time_shift
        notes += [f"{step.step}: {note}" for note in done.notes]
    _refuse_unfit(run_log)
    entry = {
        "recipe": recipe.model_dump(mode="json", by_alias=True, exclude_defaults=True),
        "offsets": any(isinstance(step, Offsets) for step in recipe.steps),
        "time_shift_s": shift,
        "notes": notes,
    }
    extra = {**run_log.extra, "conditioning": [*conditioning.earlier_conditioning(before), entry]}
    return RecipeResult(replace(run_log, extra=extra), tuple(notes), tuple(shown))


def _apply(run_log: RunLog, step: Any, rest: list[Interval]) -> Conditioned:
    match step:
        case Fill():
            return conditioning.fill(run_log, step.longest_s)
        case KeepLongest():
            return conditioning.keep_longest(run_log)
        case Cut():
            first, last = float(run_log.time[0]), float(run_log.time[-1])
            start, end = first if step.from_s is None else step.from_s, last if step.to_s is None else step.to_s
            return conditioning.cut(run_log, start, end, step.restart_time)
        case CutToMotion():
            start, end = _motion(run_log, rest)
            return conditioning.cut(run_log, start - step.before_s, end + step.after_s, step.restart_time)
        case Filter():
            design = DESIGNS[step.design] if step.design else LowPass(step.order or 0, step.cutoff_hz or 0.0)
            columns, notes = _matching(run_log, step.columns)
            done = conditioning.filtered(run_log, columns, design)
            return replace(done, notes=(*done.notes, *notes))
        case Drift():
            columns, notes = _matching(run_log, step.columns)
            done = conditioning.remove_drift(run_log, columns, rest, step.level)
            return replace(done, notes=(*done.notes, *notes))
        case Offsets():
            return conditioning.add_offsets(run_log, step.tail)
        case Resample():
            return conditioning.resampled(run_log, step.rate_hz)
        case Differentiate():
            return conditioning.rate_from_angle(run_log, step.angle, step.rate)
    raise TypeError(f"no such step: {step!r}")


def _rest_of(run_log: RunLog, rest: Rest, step: str) -> list[Interval]:
    """The resting parts of a log; LogError that says what to do when there is none."""
    if rest.parts is not None:
        return [(start, end) for start, end in rest.parts]
    within = rest.within or (RIG_REST if run_log.kind in RIG_KINDS else CAR_REST)
    parts = resting_parts(run_log, within, rest.shortest_s)
    if parts:
        return parts
    limits = ", ".join(f"{name} in [{low:g}, {high:g}]" for name, (low, high) in within.items())
    raise LogError(
        f"{run_log.name}: no resting part: nowhere {limits} for {rest.shortest_s:g} s. State its times "
        f"as rest.parts, other limits as rest.within, or leave the step {step!r} out"
    )


def _motion(run_log: RunLog, rest: list[Interval]) -> Interval:
    """From the end of the first to the start of the last rest; a log that begins or ends in motion keeps that end."""
    first, last = float(run_log.time[0]), float(run_log.time[-1])
    length = 0.02 * (last - first)
    start = rest[0][1] if rest[0][0] <= first + length else first
    end = rest[-1][0] if rest[-1][1] >= last - length and rest[-1][0] > start else last
    return start, end


def _matching(run_log: RunLog, patterns: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Columns of a log that the patterns name, and notes about known columns that it has not."""
    present = [name for name in run_log.table.columns if name != "time_s"]
    chosen: list[str] = []
    notes = []
    for pattern in patterns:
        found = [name for name in present if fnmatchcase(name, pattern)]
        if not found and not any(fnmatchcase(name, pattern) for name in known_columns()):
            raise LogError(f"{run_log.name}: no column {pattern!r}; {nearest(pattern, present)}")
        if not found:
            notes.append(f"the log has no {pattern}")
        chosen += [name for name in found if name not in chosen]
    if not chosen:
        raise LogError(f"{run_log.name}: none of the columns {', '.join(patterns)} is there")
    return chosen, notes


def _refuse_unfit(run_log: RunLog) -> None:
    try:
        check_signals(run_log.time, conditioning.signals_of(run_log))
    except LogError as error:
        raise LogError(f"{run_log.name}: after all steps: {error}; add a step `fill` or `keep_longest`") from None
