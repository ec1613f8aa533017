"""The thesis' tail law as plain Python: hold inside, trigger on yaw rate, swing over the top, settle outside.

Thesis Table 6.4 read with ERRATA E28 (130 degrees is travel, the swing speed points over the top); design section 8.
No Drake: the same law runs on a computer for which Drake has no wheel. `TailController` wraps it as a system.

Signs: tail roll angle 0 = straight up, positive to the right; yaw rate positive to the left. For a left turn the tail
waits on the left (-90 degrees) and swings with positive roll rate. A right turn is the exact mirror image.

```
           inside reached            yaw rate            delay over           travel done
  RECOCK ------------------> HOLD -------------> DELAY ------------> SWING -------------> SETTLE
     ^                         ^                   |                                        |
     |                         +-- turn cancelled -+                                        |
     +-------- another turn announced, tail on its outside ---------------------------------+
                               ^-- another turn announced, tail already on its inside ------+
```
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from aerodima.workbench.config.car_parameters import ControllerParameters
from aerodima.workbench.config.checked_files import checked
from aerodima.workbench.config.scenario_file import load_parameter_file
from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.controllers.tail_law import EPSILON, NO_COMMAND, Observation, sign
from aerodima.workbench.resources import model_path

ACCELERATION_Y = IMU.index("acceleration_y")


class SwingState(IntEnum):
    """States in the numbering of Table 6.4; OFF, RECOCK and FALLBACK are ours."""

    OFF = 0
    """No command is given: there is no tail, or its angle is not known yet."""
    HOLD = 1
    DELAY = 2
    SWING = 3
    SETTLE = 4
    RECOCK = 5
    """Slow return to the inside before the next turn to the same side."""
    FALLBACK = 6
    """A tracked swing left its funnel: this law finishes it (`swing_tracker_law`)."""


class SwingSettings(ControllerParameters):
    """Numbers of the law: those of a scenario's section `controller`, with its units and limits, and some of its own.

    Args:
        mode: "none" gives no command, "held" never swings, "swing" is the thesis' law.
        stall_factor: the swing is given up for SETTLE after this many times travel / swing_speed, so that a blocked
            tail is not pushed for ever.
        ready_angle: how far the tail may stand from the inside and still be held there at once, rad; else it is led
            there.
    """

    mode: Literal["none", "held", "swing"] = "swing"
    stall_factor: float = Field(3.0, ge=1)
    ready_angle: float = Field(0.35, ge=0, le=math.pi)

    @model_validator(mode="after")
    def _travels_over_the_top(self) -> "SwingSettings":
        if self.travel > 2.0 * self.hold_angle:
            raise ValueError(
                f"travel: {self.travel:g} rad; allowed: <= twice hold_angle, {2.0 * self.hold_angle:g} rad"
            )
        return self

    @classmethod
    def published(cls, **changes: Any) -> "SwingSettings":
        """The settings of `models/parameters/controller.yaml` with some changes; UserError names one out of range."""
        entries = load_parameter_file(model_path("parameters/controller.yaml"), ControllerParameters)
        return checked(cls, {key: entry.value for key, entry in entries.items()} | changes, "controller")

    @classmethod
    def from_scenario(cls, scenario: Any) -> "SwingSettings":
        """Settings from `scenario.controller` and `scenario.tail.mode` (any object with these attributes)."""
        values = {key: getattr(scenario.controller, key) for key in ControllerParameters.model_fields}
        return checked(cls, {**values, "mode": scenario.tail.mode}, "controller")


class SwingMemory(NamedTuple):
    """What the law remembers between ticks; `tuple(memory)` and `SwingMemory(*values)` carry it through a vector.

    Args:
        state: a `SwingState`.
        since: time at which the state was entered, s.
        side: the side of the tail's target, +1 right, -1 left, 0 before the first known angle.
        turn: the announcement acted upon last, +1 left, -1 right, 0 none.
        start_angle: tail roll when the state was entered, rad.
        roll_angle: last known tail roll, rad.
    """

    state: float = SwingState.OFF
    since: float = 0.0
    side: float = 0.0
    turn: float = 0.0
    start_angle: float = 0.0
    roll_angle: float = 0.0


FRESH = SwingMemory()
"""Memory before the first tick."""


def step(
    memory: SwingMemory, observation: Observation, settings: SwingSettings
) -> tuple[SwingMemory, np.ndarray, np.ndarray]:
    """One tick of the law.

    Args:
        memory: of the tick before; `FRESH` at the start.
        observation: of this tick.
        settings: constant during a run.

    Returns:
        New memory, command to the pitch motor (5) and to the roll motor (5): position rad, velocity rad/s, kp, kd,
        torque N m. An unknown time, roll angle or plan changes no state; a swinging tail is then held where it was
        last seen. Before the tail's angle is known once, all gains are zero.
    """
    if settings.mode == "none":
        return memory, NO_COMMAND, NO_COMMAND
    if math.isfinite(observation.time + observation.roll_angle + observation.planned_turn):
        memory = _advance(memory._replace(roll_angle=observation.roll_angle), observation, settings)
        roll_command = _roll_command(memory, observation.time, settings)
    elif memory.state == SwingState.SWING:
        roll_command = np.array([memory.roll_angle, 0.0, settings.hold_kp, settings.hold_kd, 0.0])
    else:
        time = observation.time if math.isfinite(observation.time) else memory.since
        roll_command = _roll_command(memory, time, settings)
    if memory.state == SwingState.OFF:
        return memory, NO_COMMAND, NO_COMMAND
    pitch_command = np.array([settings.pitch_angle, 0.0, settings.hold_kp, settings.hold_kd, 0.0])
    return memory, pitch_command, roll_command


def _advance(memory: SwingMemory, observation: Observation, settings: SwingSettings) -> SwingMemory:
    """The state machine for a known time, roll angle and plan."""
    plan = sign(observation.planned_turn)
    if memory.state != SwingState.SWING and (memory.state == SwingState.OFF or plan != memory.turn):
        return _plan(memory, plan, observation, settings)
    time_in_state = observation.time - memory.since + EPSILON
    if memory.state == SwingState.HOLD and _triggered(plan, observation, settings):
        memory = _enter(SwingState.DELAY, memory, observation.time)
        time_in_state = EPSILON
    if memory.state == SwingState.DELAY and time_in_state >= settings.delay:
        return _enter(SwingState.SWING, memory._replace(side=memory.turn), observation.time)
    if memory.state == SwingState.SWING:
        travelled = memory.turn * (memory.roll_angle - memory.start_angle)
        stalled = time_in_state >= settings.stall_factor * settings.travel / settings.swing_speed
        if travelled >= settings.travel or stalled:
            return _enter(SwingState.SETTLE, memory, observation.time)
    if memory.state == SwingState.RECOCK and _recock_reference(memory, observation.time, settings)[1] == 0.0:
        return _enter(SwingState.HOLD, memory, observation.time)
    return memory


def _plan(memory: SwingMemory, plan: float, observation: Observation, settings: SwingSettings) -> SwingMemory:
    """Acts on a new announcement, also on the first one: leads the tail to the inside of the announced turn.

    A withdrawn announcement (0) only cancels the delay. Without any announcement at the start the tail is held on the
    side where it is found (upright counts as left).
    """
    memory = memory._replace(turn=plan)
    if plan == 0.0 and memory.state != SwingState.OFF:
        return _enter(SwingState.HOLD, memory, observation.time) if memory.state == SwingState.DELAY else memory
    side = -plan if plan != 0.0 else (sign(memory.roll_angle) or -1.0)
    memory = memory._replace(side=side)
    ready = abs(memory.roll_angle - side * settings.hold_angle) <= settings.ready_angle
    return _enter(SwingState.HOLD if ready else SwingState.RECOCK, memory, observation.time)


def _triggered(plan: float, observation: Observation, settings: SwingSettings) -> bool:
    """Whether a fresh signal shows that the announced turn has begun; false for NaN and for the wrong sign."""
    if settings.mode != "swing" or plan == 0.0:
        return False
    if settings.trigger == "steering":
        return plan * observation.steering_angle > settings.trigger_steering_angle
    if not observation.imu_valid:
        return False
    if settings.trigger == "lateral_acceleration":
        return plan * observation.imu[ACCELERATION_Y] > settings.trigger_lateral_acceleration
    return plan * observation.yaw_rate > settings.trigger_yaw_rate


def _roll_command(memory: SwingMemory, time: float, settings: SwingSettings) -> np.ndarray:
    """Command (5) of a state; Table 6.4, and the slow gains for the re-cock."""
    target = memory.side * settings.hold_angle
    if memory.state in (SwingState.HOLD, SwingState.DELAY):
        return np.array([target, 0.0, settings.hold_kp, settings.hold_kd, 0.0])
    if memory.state == SwingState.SWING:
        return np.array([0.0, memory.turn * settings.swing_speed, settings.swing_kp, settings.swing_kd, 0.0])
    if memory.state == SwingState.SETTLE:
        return np.array([target, 0.0, settings.settle_kp, settings.settle_kd, 0.0])
    if memory.state == SwingState.RECOCK:
        position, velocity = _recock_reference(memory, time, settings)
        return np.array([position, velocity, settings.settle_kp, settings.settle_kd, 0.0])
    return NO_COMMAND


def _recock_reference(memory: SwingMemory, time: float, settings: SwingSettings) -> tuple[float, float]:
    """Position (rad) and velocity (rad/s) of the ramp from where the tail was to the inside; velocity 0 at its end."""
    target = memory.side * settings.hold_angle
    distance = target - memory.start_angle
    travelled = settings.recock_speed * (time - memory.since)
    if travelled + EPSILON >= abs(distance):
        return target, 0.0
    direction = math.copysign(1.0, distance)
    return memory.start_angle + direction * travelled, direction * settings.recock_speed


def _enter(state: SwingState, memory: SwingMemory, time: float) -> SwingMemory:
    return memory._replace(state=float(state), since=time, start_angle=memory.roll_angle)


@dataclass(frozen=True)
class SwingLaw:
    """The law with its settings, in the form that `TailController` runs (see its `TailLaw`)."""

    settings: SwingSettings = field(default_factory=SwingSettings.published)

    @property
    def rate(self) -> float:
        """Controller rate, Hz."""
        return self.settings.rate

    @property
    def memory_size(self) -> int:
        """Number of floats that `step` carries from tick to tick."""
        return len(FRESH)

    def start(self) -> np.ndarray:
        """Memory (memory_size,) before the first tick."""
        return np.array(FRESH)

    def step(self, memory: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick: new memory (memory_size,), pitch command (5), roll command (5), number of the state."""
        after, pitch_command, roll_command = step(SwingMemory(*memory.tolist()), observation, self.settings)
        return np.array(after), pitch_command, roll_command, int(after.state)
