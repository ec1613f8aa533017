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
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.config.range_check import check_range
from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.controllers.tail_law import EPSILON, NO_COMMAND, Observation, sign
from aerodima.workbench.errors import UserError

MODES = ("none", "held", "swing")
ACCELERATION_Y = IMU.index("acceleration_y")
TRIGGERS = ("yaw_rate", "lateral_acceleration", "steering")


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


@dataclass(frozen=True)
class SwingSettings:
    """Numbers of the law. Angles rad, rates rad/s, kp N m/rad, kd N m s/rad, times s.

    The defaults are those of models/parameters/controller.yaml, and a test holds them together.

    Args:
        mode: "none" gives no command, "held" never swings, "swing" is the thesis' law.
        hold_angle: roll angle at rest, measured from upright, to either side.
        swing_kp: usually 0; any other gain pulls the swinging tail towards upright.
        trigger: what starts the swing once it exceeds its threshold into the announced turn: the published yaw rate
            (rad/s), the lateral acceleration of the IMU (m/s2), or the steering command (rad); the last one with a
            delay is a swing that begins a set time after the steering.
        travel: roll travel after which position control takes over.
        recock_speed: speed of the reference that leads the tail back.
        rate: controller rate, Hz.
        stall_factor: the swing is given up for SETTLE after this many times travel / swing_speed, so that a blocked
            tail is not pushed for ever.
        ready_angle: how far the tail may stand from the inside and still be held there at once; else it is led there.

    Raises:
        UserError: a value is not finite or out of range.
    """

    mode: str = "swing"
    hold_angle: float = math.pi / 2
    hold_kp: float = 17.0
    hold_kd: float = 5.0
    swing_speed: float = 8.0
    swing_kp: float = 0.0
    swing_kd: float = 3.0
    settle_kp: float = 5.0
    settle_kd: float = 2.0
    trigger: str = "yaw_rate"
    trigger_yaw_rate: float = 1.0
    trigger_lateral_acceleration: float = 3.0
    trigger_steering_angle: float = 0.1
    delay: float = 0.0
    travel: float = math.radians(130.0)
    recock_speed: float = 1.0
    pitch_angle: float = 0.0
    rate: float = 100.0
    stall_factor: float = 3.0
    ready_angle: float = 0.35

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise UserError(f"tail.mode: {self.mode!r}; allowed: {', '.join(MODES)}")
        if self.trigger not in TRIGGERS:
            raise UserError(f"controller.trigger: {self.trigger!r}; allowed: {', '.join(TRIGGERS)}")
        half_turn = math.pi
        check_range("controller.hold_angle", self.hold_angle, 0.0, half_turn, "rad", above_low=True)
        check_range("controller.pitch_angle", self.pitch_angle, -half_turn, half_turn, "rad")
        for phase in ("hold", "swing", "settle"):
            check_range(f"controller.{phase}_kp", getattr(self, f"{phase}_kp"), 0.0, 500.0, "N m/rad")
            check_range(f"controller.{phase}_kd", getattr(self, f"{phase}_kd"), 0.0, 5.0, "N m s/rad")
        for name in ("swing_speed", "recock_speed"):
            check_range(f"controller.{name}", getattr(self, name), 0.0, 50.0, "rad/s", above_low=True)
        check_range("controller.trigger_yaw_rate", self.trigger_yaw_rate, 0.0, 100.0, "rad/s", above_low=True)
        check_range(
            "controller.trigger_lateral_acceleration",
            self.trigger_lateral_acceleration,
            0.0,
            100.0,
            "m/s2",
            above_low=True,
        )
        check_range("controller.trigger_steering_angle", self.trigger_steering_angle, 0.0, 1.2, "rad", above_low=True)
        check_range("controller.delay", self.delay, 0.0, 10.0, "s")
        check_range("controller.travel", self.travel, 0.0, 2.0 * self.hold_angle, "rad", above_low=True)
        check_range("controller.rate", self.rate, 0.0, math.inf, "Hz", above_low=True)
        check_range("controller.stall_factor", self.stall_factor, 1.0, math.inf, "times")
        check_range("controller.ready_angle", self.ready_angle, 0.0, half_turn, "rad")

    @classmethod
    def from_scenario(cls, scenario: Any) -> "SwingSettings":
        """Settings from `scenario.controller` and `scenario.tail.mode` (any object with these attributes)."""
        controller = scenario.controller
        return cls(
            mode=scenario.tail.mode,
            hold_angle=controller.hold_angle,
            hold_kp=controller.hold_kp,
            hold_kd=controller.hold_kd,
            swing_speed=controller.swing_speed,
            swing_kp=controller.swing_kp,
            swing_kd=controller.swing_kd,
            settle_kp=controller.settle_kp,
            settle_kd=controller.settle_kd,
            trigger=controller.trigger,
            trigger_yaw_rate=controller.trigger_yaw_rate,
            trigger_lateral_acceleration=controller.trigger_lateral_acceleration,
            trigger_steering_angle=controller.trigger_steering_angle,
            delay=controller.delay,
            travel=controller.travel,
            recock_speed=controller.recock_speed,
            pitch_angle=controller.pitch_angle,
            rate=controller.rate,
        )


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

    settings: SwingSettings = SwingSettings()

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
