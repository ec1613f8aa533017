"""Swing files: a tail movement as knots in time, with its gains, limits and trigger.

One YAML file of schema `aerodima/swing/1`. Time 0 is the moment the trigger releases the swing.
Positions, rates and torques are those of the tail joints (roll 0 upright, positive to the right;
pitch positive forwards), written for the turn direction that the file names; for the other
direction roll is mirrored (`swing_at`). Between the knots the motion is a cubic. Plain Python and
NumPy: the player must also run where Drake has no wheel.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator

from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import SwingFileError
from aerodima.workbench.core.file_reading import Facts, Json, Settings
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml

SCHEMA = "aerodima/swing/1"

_LIMIT_MARGIN = 1e-6
"""Rounding by which a value may lie beyond its limit, rad, rad/s or N m."""
_SAMPLES_PER_INTERVAL = 16
"""Number of points per interval of the knots at which the curve is checked."""

Samples = Annotated[tuple[float, ...], Field(strict=False, min_length=2)]
Direction = Literal["left", "right"]
Joint = Literal["roll", "pitch"]
JOINTS: tuple[Joint, ...] = ("roll", "pitch")


def _from_zero(times: tuple[float, ...]) -> tuple[float, ...]:
    if times[0] != 0.0:
        raise ValueError(f"{times[0]!r} must be 0, the moment of release")
    for number, (before, after) in enumerate(pairwise(times), start=1):
        if after <= before:
            raise ValueError(f"{number}: {after!r} must be later than {before!r}")
    return times


Times = Annotated[Samples, AfterValidator(_from_zero)]
"""Times since the release, s."""


class _Strict(StrictModel):
    model_config = ConfigDict(strict=True)


class Knots(_Strict):
    """States at the knots, all of the length of `time_s`; cubic Hermite between them."""

    time_s: Times
    """Times since the release, s, strictly increasing, the first 0."""
    roll_position_rad: Samples
    """Tail roll, rad."""
    roll_velocity_rad_per_s: Samples
    """Tail roll rate, rad/s."""
    pitch_position_rad: Samples
    """Tail pitch, rad."""
    pitch_velocity_rad_per_s: Samples
    """Tail pitch rate, rad/s."""
    roll_torque_n_m: Samples | None = None
    """Feed-forward torque of the roll motor, N m."""
    pitch_torque_n_m: Samples | None = None
    """Feed-forward torque of the pitch motor, N m."""

    @model_validator(mode="after")
    def _equally_long(self) -> Self:
        count = len(self.time_s)
        for name in type(self).model_fields:
            samples = getattr(self, name)
            if samples is not None and len(samples) != count:
                raise ValueError(f"{name}: {len(samples)} values must be {count}, one per time_s")
        return self

    def states(self, joint: Joint) -> ArrayPair:
        """Return positions (rad) and rates (rad/s) of one joint at the knots, shape (knots,)."""
        return (
            np.asarray(getattr(self, f"{joint}_position_rad")),
            np.asarray(getattr(self, f"{joint}_velocity_rad_per_s")),
        )


class JointGains(_Strict):
    """Gains of one tail joint in the motor's own law (design section 6)."""

    kp: float = Field(ge=0, le=500)
    """Position gain, N m/rad."""
    kd: float = Field(ge=0, le=5)
    """Velocity gain, N m s/rad."""


class GainPhase(_Strict):
    """Gains that hold from `start_s` on."""

    start_s: float = Field(ge=0)
    """Time since the release, s."""
    roll: JointGains
    pitch: JointGains


class Gains(_Strict):
    """Gains while the tail waits (`hold`) and in the phases of the swing."""

    hold: JointGains
    phases: Annotated[tuple[GainPhase, ...], Field(strict=False, min_length=1)]

    @field_validator("phases")
    @classmethod
    def _in_order(cls, phases: tuple[GainPhase, ...]) -> tuple[GainPhase, ...]:
        _from_zero(tuple(phase.start_s for phase in phases))
        return phases


class Limits(_Strict):
    """Symmetric limits of the knots and of the curve between them."""

    roll_position_rad: float = Field(gt=0, le=math.pi)
    """Largest magnitude of the roll angle, rad."""
    pitch_position_rad: float = Field(gt=0, le=math.pi)
    """Largest magnitude of the pitch angle, rad."""
    velocity_rad_per_s: float = Field(gt=0)
    """Largest joint rate, rad/s."""
    torque_n_m: float = Field(gt=0)
    """Largest motor torque, N m."""


class Trigger(_Strict):
    """Event that releases the swing: yaw rate or steering command into the planned turn, or a time
    since its announcement.
    """

    kind: Literal["yaw_rate", "steering", "time"] = "yaw_rate"
    threshold_rad_per_s: float | None = Field(None, gt=0)
    """Yaw rate into the planned turn, rad/s; for kind yaw_rate only."""
    threshold_rad: float | None = Field(None, gt=0)
    """Steering command into the planned turn, rad; for kind steering only."""
    delay_s: float = Field(0.0, ge=0)
    """Time from the trigger, or for kind time from the announcement, to the release, s."""

    @model_validator(mode="after")
    def _has_threshold(self) -> Self:
        for name, kind in (("threshold_rad_per_s", "yaw_rate"), ("threshold_rad", "steering")):
            if (self.kind == kind) != (getattr(self, name) is not None):
                raise ValueError(f"{name}: must be given with kind {kind}, and only then")
        return self


class Provenance(_Strict):
    """Origin of the swing."""

    source: str
    """Table or command that the swing comes from."""
    scenario: str | None = None
    """Scenario that the swing was made with."""
    seed: int | None = Field(None, ge=0)
    """Seed of the solver's starts."""
    settings: Annotated[Settings, Field(strict=False)] = ()
    """Overrides of that scenario."""
    options: dict[str, float | int | str] = Field(default_factory=dict)
    """Options of the command that made the swing."""
    found: dict[str, float | int | str] = Field(default_factory=dict)
    """Results of that command, such as peak_roll_rad; names end in their unit."""
    solver_log: str | None = None
    """Name of the file with the solver's log."""
    versions: dict[str, str] = Field(default_factory=dict)
    """Versions of project, drake, python, numpy."""


class SwingFile(_Strict):
    """Content of a swing file.

    `car` holds the parameters of the car that the swing was made for, as `section.key` of a
    scenario in SI units.
    """

    schema_: str = Field(SCHEMA, alias="schema")
    name: str = Field(min_length=1, max_length=80)
    direction: Direction
    """Turn direction that the knots are written for."""
    trigger: Trigger
    knots: Knots
    gains: Gains
    limits: Limits
    provenance: Provenance
    car: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for joint in JOINTS:
            self._refuse_beyond(f"{joint}_position_rad", f"{joint}_position_rad")
            self._refuse_beyond(f"{joint}_velocity_rad_per_s", "velocity_rad_per_s")
            self._refuse_beyond(f"{joint}_torque_n_m", "torque_n_m")
            self._refuse_overshoot(joint)
        return self

    def plain(self) -> Json:
        """Return the swing as the plain data of a swing file."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)

    def _refuse_beyond(self, knots: str, limit: str) -> None:
        largest = getattr(self.limits, limit)
        for number, value in enumerate(getattr(self.knots, knots) or ()):
            if abs(value) > largest + _LIMIT_MARGIN:
                raise ValueError(
                    f"knots.{knots}.{number}: {value!r} must be within +-{largest:g} "
                    f"(limits.{limit})"
                )

    def _refuse_overshoot(self, joint: Joint) -> None:
        largest = getattr(self.limits, f"{joint}_position_rad")
        times = np.asarray(self.knots.time_s)
        knots = np.arange(len(times))
        fine_knots = np.arange(knots[-1] * _SAMPLES_PER_INTERVAL + 1) / _SAMPLES_PER_INTERVAL
        fine = np.interp(fine_knots, knots, times)
        position, _ = hermite(fine, times, *self.knots.states(joint))
        worst = int(np.argmax(np.abs(position)))
        if abs(position[worst]) > largest + _LIMIT_MARGIN:
            raise ValueError(
                f"knots.{joint}_position_rad: the curve reaches {position[worst]:g} at "
                f"{fine[worst]:g} s; it must be within +-{largest:g} (limits.{joint}_position_rad)"
            )


def read_swing(path: Path | str) -> SwingFile:
    """Read a swing file.

    Raises:
        SwingFileError: missing file, bad YAML, a key named twice, another schema, unknown key,
            value not allowed, NaN; names file, key and value.
    """
    return swing_from_dict(read_yaml(Path(path), SwingFileError), str(path))


def swing_from_dict(data: Any, where: str = "swing") -> SwingFile:
    """Make a swing from plain data; `where` is the file named in errors (SwingFileError)."""
    return checked(SwingFile, data, where, SwingFileError, schema=SCHEMA)


def write_swing(swing: SwingFile, path: Path | str, force: bool = False) -> Path:
    """Write a swing file whole or not at all; SwingFileError if it exists or cannot be written."""
    text = yaml.safe_dump(swing.plain(), sort_keys=False, width=110)
    return write_atomically(Path(path), text, force, SwingFileError)


def car_mismatches(swing: SwingFile, scenario: Facts) -> list[str]:
    """List how the car of a resolved scenario differs from the one that the swing was made for.

    Args:
        swing: content of the swing file; a swing without `car` fits any car.
        scenario: resolved scenario as a dict.
    """
    lines = []
    for name, made_for in swing.car.items():
        section, _, key = name.partition(".")
        values = scenario.get(section)
        value = values.get(key) if isinstance(values, dict) else None
        if not isinstance(value, int | float):
            lines.append(f"{name}: made for {made_for:g}, the scenario has no such parameter")
        elif not math.isclose(value, made_for, rel_tol=1e-9, abs_tol=1e-12):
            lines.append(f"{name}: made for {made_for:g}, the scenario has {value:g}")
    return lines


@dataclass(frozen=True)
class SwingPoint:
    """Tail commands at one time or many, each of the shape of the times asked for; rad, rad/s,
    N m.
    """

    roll_position: FloatArray
    roll_velocity: FloatArray
    pitch_position: FloatArray
    pitch_velocity: FloatArray
    roll_torque: FloatArray
    pitch_torque: FloatArray


def swing_at(swing: SwingFile, time: ArrayLike, direction: Direction | None = None) -> SwingPoint:
    """Evaluate positions, rates and feed-forward torques at times since the release.

    Positions are cubic Hermite polynomials through the knots, rates their derivatives, torques
    linear between knots. Before 0 the tail rests at the first knot, after the last knot at the
    last: rates and torques are then zero.

    Args:
        swing: content of the swing file.
        time: times since the release, s, any shape.
        direction: turn to make, None for that of the file; roll is mirrored if it is not the turn
            that the file was made for.
    """
    t = np.asarray(time, dtype=np.float64)
    times = np.asarray(swing.knots.time_s)
    side = 1.0 if direction in (None, swing.direction) else -1.0
    roll, roll_rate = hermite(t, times, *swing.knots.states("roll"))
    pitch, pitch_rate = hermite(t, times, *swing.knots.states("pitch"))
    return SwingPoint(
        roll_position=side * roll,
        roll_velocity=side * roll_rate,
        pitch_position=pitch,
        pitch_velocity=pitch_rate,
        roll_torque=side * _torque(t, times, swing.knots.roll_torque_n_m),
        pitch_torque=_torque(t, times, swing.knots.pitch_torque_n_m),
    )


def gains_at(swing: SwingFile, time: float) -> tuple[JointGains, JointGains]:
    """Look up roll and pitch gains at a time since the release, s; before it the hold gains."""
    begun = [phase for phase in swing.gains.phases if phase.start_s <= time]
    if begun:
        return (begun[-1].roll, begun[-1].pitch)
    return (swing.gains.hold, swing.gains.hold)


def hermite(
    t: FloatArray,
    times: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
) -> ArrayPair:
    """Interpolate value and derivative by cubic Hermite polynomials; at rest outside the knots.

    Args:
        t: times at which to interpolate, s, any shape.
        times: times of the knots, s, strictly increasing, shape (n,).
        position: values at the knots, shape (n,).
        velocity: derivatives at the knots, per second, shape (n,).
    """
    i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    h = times[i + 1] - times[i]
    share = np.clip((t - times[i]) / h, 0.0, 1.0)
    value, rate = cubic(share, h, (position[i], position[i + 1]), (velocity[i], velocity[i + 1]))
    return value, np.where((t < times[0]) | (t > times[-1]), 0.0, rate)


def cubic(
    share: NDArray,
    h: NDArray,
    positions: tuple[NDArray, NDArray],
    velocities: tuple[NDArray, NDArray],
) -> Any:
    """Evaluate a cubic between two knots and its derivative; arrays of any shape.

    Args:
        share: part of the interval that has gone by, 0 to 1.
        h: length of the interval, s.
        positions: values at the two ends of the interval.
        velocities: derivatives at the two ends, per second.
    """
    rise = positions[1] - positions[0]
    start = h * velocities[0]
    end = h * velocities[1]
    quadratic = 3.0 * rise - 2.0 * start - end
    third = start + end - 2.0 * rise
    value = positions[0] + share * (start + share * (quadratic + share * third))
    return value, (start + share * (2.0 * quadratic + 3.0 * share * third)) / h


def _torque(t: FloatArray, times: FloatArray, torque: tuple[float, ...] | None) -> FloatArray:
    if torque is None:
        return np.zeros_like(t)
    return np.interp(t, times, torque, left=0.0, right=0.0)
