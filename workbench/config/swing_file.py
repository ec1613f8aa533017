"""Swing files: a tail movement as knots in time, with the gains, limits and trigger that belong to it.

One YAML file of schema `aerodima/swing/1`. Time 0 is the moment the trigger releases the swing. Positions, rates and
torques are those of the tail joints (roll 0 upright, positive to the right; pitch positive forwards), written for the
turn direction that the file names; for the other direction roll is mirrored (`swing_at`). Plain Python and NumPy: the
tracker must also run where Drake has no wheel.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
import yaml
from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator

from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.checked_files import StrictModel, checked, read_yaml
from aerodima.workbench.config.swing_curve import hermite
from aerodima.workbench.errors import SwingFileError

SCHEMA = "aerodima/swing/1"

_LIMIT_MARGIN = 1e-6
_SAMPLES_PER_INTERVAL = 16

Row = Annotated[tuple[float, ...], Field(strict=False)]
Samples = Annotated[tuple[float, ...], Field(strict=False, min_length=2)]


def _from_zero(times: tuple[float, ...]) -> tuple[float, ...]:
    if times[0] != 0.0:
        raise ValueError(f"{times[0]!r} is first; allowed: 0, the moment of release")
    for number, (before, after) in enumerate(pairwise(times), start=1):
        if after <= before:
            raise ValueError(f"{number}: {after!r} follows {before!r}; allowed: strictly increasing times")
    return times


Times = Annotated[Samples, AfterValidator(_from_zero)]
"""s, since the release."""
Direction = Literal["left", "right"]
FeedbackState = Literal["car_roll", "car_roll_rate", "tail_roll", "tail_roll_rate", "tail_pitch", "tail_pitch_rate"]
FEEDBACK_STATES: tuple[str, ...] = get_args(FeedbackState)
"""rad and rad/s; roll positive to the right."""


class _Strict(StrictModel):
    model_config = ConfigDict(strict=True)


class Knots(_Strict):
    """States at the knots, all of the length of `time_s`; cubic Hermite between them."""

    time_s: Times = Field(description="times since the release, s, strictly increasing, the first 0")
    roll_position_rad: Samples = Field(description="tail roll, rad")
    roll_velocity_rad_per_s: Samples = Field(description="tail roll rate, rad/s")
    pitch_position_rad: Samples = Field(description="tail pitch, rad")
    pitch_velocity_rad_per_s: Samples = Field(description="tail pitch rate, rad/s")
    roll_torque_n_m: Samples | None = Field(None, description="feed-forward torque of the roll motor, N m")
    pitch_torque_n_m: Samples | None = Field(None, description="feed-forward torque of the pitch motor, N m")

    @model_validator(mode="after")
    def _equally_long(self) -> Self:
        _refuse_other_length(self, *type(self).model_fields)
        return self

    def states(self, joint: Literal["roll", "pitch"]) -> tuple[np.ndarray, np.ndarray]:
        """Positions (rad) and rates (rad/s) of one joint at the knots, shape (knots,)."""
        return (
            np.asarray(getattr(self, f"{joint}_position_rad")),
            np.asarray(getattr(self, f"{joint}_velocity_rad_per_s")),
        )


def _refuse_other_length(series: Any, *names: str) -> None:
    count = len(series.time_s)
    for name in names:
        samples = getattr(series, name)
        if samples is not None and len(samples) != count:
            raise ValueError(f"{name}: {len(samples)} values; allowed: {count}, as many as time_s")


class JointGains(_Strict):
    """Gains of one tail joint in the motor's own law (design section 6)."""

    kp: float = Field(description="position gain, N m/rad", ge=0, le=500)
    kd: float = Field(description="velocity gain, N m s/rad", ge=0, le=5)


class GainPhase(_Strict):
    """Gains from `start_s` on."""

    start_s: float = Field(description="time since the release, s", ge=0)
    roll: JointGains
    pitch: JointGains


class Feedback(_Strict):
    """Time-varying linear feedback around a motion of the car: torque = nominal torque - gain (x - nominal x).

    States are those of `FEEDBACK_STATES`, in the turn direction of the file: car roll and rate positive to the right,
    as its IMU estimates them, and the tail's joints. Roll of the car and roll of the tail are mirrored together.
    Between the times everything is linear. A state that is further from its nominal value than `funnel` is out of the
    reach of the feedback: the tracker then gives the swing up.
    """

    states: Annotated[tuple[FeedbackState, ...], Field(strict=False, min_length=1)] = Field(description="their names")
    time_s: Times = Field(description="times since the release, s, strictly increasing, the first 0")
    nominal: Annotated[tuple[Row, ...], Field(strict=False)] = Field(description="(times, states), rad and rad/s")
    roll_torque_n_m: Samples = Field(description="nominal torque of the roll motor, N m")
    roll_gains: Annotated[tuple[Row, ...], Field(strict=False)] = Field(description="(times, states), N m per state")
    pitch_torque_n_m: Samples | None = Field(None, description="nominal torque of the pitch motor, N m")
    pitch_gains: Annotated[tuple[Row, ...], Field(strict=False)] | None = Field(
        None, description="(times, states); without them pitch follows the knots"
    )
    funnel: Row = Field(description="largest deviation of each state, rad and rad/s")

    @model_validator(mode="after")
    def _shaped(self) -> Self:
        count, width = len(self.time_s), len(self.states)
        if len(set(self.states)) != width:
            raise ValueError(f"states: {list(self.states)}; allowed: each state once")
        for name in ("nominal", "roll_gains", "pitch_gains"):
            rows = getattr(self, name)
            if rows is not None and (len(rows) != count or any(len(row) != width for row in rows)):
                raise ValueError(f"{name}: must be {count} rows (times) of {width} values (states)")
        _refuse_other_length(self, "roll_torque_n_m", "pitch_torque_n_m")
        if (self.pitch_gains is None) != (self.pitch_torque_n_m is None):
            raise ValueError("pitch_gains: allowed together with pitch_torque_n_m")
        if len(self.funnel) != width or min(self.funnel) <= 0.0:
            raise ValueError(f"funnel: {list(self.funnel)}; allowed: {width} values above 0, one per state")
        return self


class Gains(_Strict):
    """Gains while the tail waits (`hold`) and in the phases of the swing; feedback if the swing is tracked with it."""

    hold: JointGains
    phases: Annotated[tuple[GainPhase, ...], Field(strict=False, min_length=1)]
    feedback: Feedback | None = None

    @field_validator("phases")
    @classmethod
    def _in_order(cls, phases: tuple[GainPhase, ...]) -> tuple[GainPhase, ...]:
        _from_zero(tuple(phase.start_s for phase in phases))
        return phases


class Limits(_Strict):
    """What the knots and the curve between them must not leave; symmetric."""

    roll_position_rad: float = Field(description="largest magnitude of the roll angle, rad", gt=0, le=math.pi)
    pitch_position_rad: float = Field(description="largest magnitude of the pitch angle, rad", gt=0, le=math.pi)
    velocity_rad_per_s: float = Field(description="largest joint rate, rad/s", gt=0)
    torque_n_m: float = Field(description="largest motor torque, N m", gt=0)


class Trigger(_Strict):
    """What releases the swing: yaw rate or steering command into the planned turn, or a time since its announcement."""

    kind: Literal["yaw_rate", "steering", "time"] = "yaw_rate"
    threshold_rad_per_s: float | None = Field(None, description="yaw_rate: into the planned turn, rad/s", gt=0)
    threshold_rad: float | None = Field(None, description="steering: command into the planned turn, rad", gt=0)
    delay_s: float = Field(0.0, description="from the trigger to the release, s; time: since the announcement", ge=0)

    @model_validator(mode="after")
    def _has_threshold(self) -> Self:
        for name, kind in (("threshold_rad_per_s", "yaw_rate"), ("threshold_rad", "steering")):
            if (self.kind == kind) != (getattr(self, name) is not None):
                raise ValueError(f"{name}: allowed and needed with kind {kind} only")
        return self


class Provenance(_Strict):
    """Where the swing comes from."""

    source: str = Field(description="what made it: a table, a command")
    scenario: str | None = Field(None, description="scenario it was made with")
    seed: int | None = Field(None, description="seed of the solver's starts", ge=0)
    settings: Annotated[tuple[str, ...], Field(strict=False)] = Field((), description="overrides of that scenario")
    options: dict[str, float | int | str] = Field(default_factory=dict, description="of the command that made it")
    found: dict[str, float | int | str] = Field(
        default_factory=dict, description="what it found, such as collocation_error_rad; unit at the end of the name"
    )
    solver_log: str | None = Field(None, description="file of the solver's log")
    versions: dict[str, str] = Field(
        default_factory=dict, description="project, drake, python, numpy, and numba where it compiles steps"
    )


class SwingFile(_Strict):
    """A swing. `car` holds the parameters it was made for, as `section.key` of a scenario in SI units."""

    schema_: Literal["aerodima/swing/1"] = Field("aerodima/swing/1", alias="schema")
    name: str = Field(min_length=1, max_length=80)
    direction: Direction = Field(description="turn that the knots are written for")
    trigger: Trigger
    knots: Knots
    gains: Gains
    limits: Limits
    provenance: Provenance
    car: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        joints: tuple[Literal["roll", "pitch"], ...] = ("roll", "pitch")
        for joint in joints:
            allowed = getattr(self.limits, f"{joint}_position_rad")
            self._refuse_beyond(f"knots.{joint}_position_rad", allowed, f"limits.{joint}_position_rad")
            self._refuse_beyond(
                f"knots.{joint}_velocity_rad_per_s", self.limits.velocity_rad_per_s, "limits.velocity_rad_per_s"
            )
            self._refuse_beyond(f"knots.{joint}_torque_n_m", self.limits.torque_n_m, "limits.torque_n_m")
            self._refuse_overshoot(joint, allowed)
        return self

    def _refuse_beyond(self, key: str, allowed: float, limit: str) -> None:
        for number, value in enumerate(getattr(self.knots, key.removeprefix("knots.")) or ()):
            if abs(value) > allowed + _LIMIT_MARGIN:
                raise ValueError(f"{key}.{number}: {value!r}; allowed: -{allowed:g} to {allowed:g} ({limit})")

    def _refuse_overshoot(self, joint: Literal["roll", "pitch"], allowed: float) -> None:
        times = np.asarray(self.knots.time_s)
        fine = np.interp(
            np.arange((len(times) - 1) * _SAMPLES_PER_INTERVAL + 1) / _SAMPLES_PER_INTERVAL,
            np.arange(len(times)),
            times,
        )
        position, _ = hermite(fine, times, *self.knots.states(joint))
        worst = int(np.argmax(np.abs(position)))
        if abs(position[worst]) > allowed + _LIMIT_MARGIN:
            raise ValueError(
                f"knots.{joint}_position_rad: the curve reaches {position[worst]:g} at {fine[worst]:g} s; allowed: "
                f"-{allowed:g} to {allowed:g} (limits.{joint}_position_rad)"
            )


def read_swing(path: Path | str) -> SwingFile:
    """Read a swing file.

    Raises:
        SwingFileError: missing file, bad YAML, a key named twice, another schema, unknown key, value not allowed, NaN;
            names file, key and value.
    """
    return swing_from_dict(read_yaml(Path(path), SwingFileError), str(path))


def swing_from_dict(data: Any, where: str = "swing") -> SwingFile:
    """A swing from plain data; `where` is the file named in errors (SwingFileError)."""
    return checked(SwingFile, data, where, SwingFileError, schema=SCHEMA)


def write_swing(swing: SwingFile, path: Path | str, force: bool = False) -> Path:
    """Write a swing file, whole or not at all; SwingFileError when it exists (without `force`) or cannot be written."""
    text = yaml.safe_dump(swing.model_dump(mode="json", by_alias=True, exclude_none=True), sort_keys=False, width=110)
    return write_atomically(Path(path), text, force, SwingFileError)


def car_mismatches(swing: SwingFile, scenario: Mapping[str, Any], tolerance: float = 1e-9) -> list[str]:
    """How the car of a resolved scenario differs from the one the swing was made for: one line per parameter.

    Args:
        swing: the file; a swing without `car` fits any car.
        scenario: resolved scenario as a dict.
        tolerance: relative difference that counts as equal.
    """
    lines = []
    for name, made_for in swing.car.items():
        section, _, key = name.partition(".")
        value = (scenario.get(section) or {}).get(key)
        if value is None:
            lines.append(f"{name}: made for {made_for:g}, the scenario has no such parameter")
        elif not math.isclose(float(value), made_for, rel_tol=tolerance, abs_tol=1e-12):
            lines.append(f"{name}: made for {made_for:g}, the scenario has {float(value):g}")
    return lines
