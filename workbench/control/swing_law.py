"""Laws that swing the tail: their states; the thesis' law: hold inside, trigger, swing over the
top, settle outside.

Thesis Table 6.4 read with ERRATA E28 (130 degrees is travel, the swing speed points over the top);
design section 8. No Drake: the same law runs on a computer for which Drake has no wheel.
`law_of_scenario` makes it, `TailController` calls it in a diagram,
`aerodima.hardware.driving.plain_loop.LawPilot` without Drake.

Signs: tail roll angle 0 = straight up, positive to the right; yaw rate positive to the left. For a
left turn the tail waits on the left (-90 degrees) and swings with positive roll rate. A right turn
is the exact mirror image.

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
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import Field, model_validator

from aerodima.workbench.control.tail_law import EPSILON, NO_COMMAND, Observation, sign
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import checked
from aerodima.workbench.scenario.law_parameters import ControllerParameters
from aerodima.workbench.scenario.scenario_file import load_parameter_file
from aerodima.workbench.scenario.signal_table import IMU

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
    """A played swing was given up: this law finishes it (`swing_player`)."""


class SwingSettings(ControllerParameters):
    """Numbers of the law: those of a scenario's section `controller`, with its units and limits,
    and some of its own.

    Args:
        mode: "none" gives no command, "held" never swings, "swing" is the thesis' law.
        stall_factor: the swing is given up for SETTLE after this many times travel / swing_speed,
            so that a blocked tail is not pushed for ever.
        ready_angle: how far the tail may stand from the inside and still be held there at once,
            rad; else it is led there.
    """

    mode: Literal["none", "held", "swing"] = "swing"
    stall_factor: float = Field(3.0, ge=1)
    ready_angle: float = Field(0.35, ge=0, le=math.pi)

    @model_validator(mode="after")
    def _travels_over_the_top(self) -> "SwingSettings":
        if self.travel > 2.0 * self.hold_angle:
            raise ValueError(
                f"travel: {self.travel:g} rad; allowed: <= twice hold_angle, "
                f"{2.0 * self.hold_angle:g} rad"
            )
        return self

    @classmethod
    def published(cls, **changes: Any) -> "SwingSettings":
        """The settings of `models/parameters/controller.yaml` with some changes; UserError names
        one out of range.
        """
        entries = load_parameter_file(
            model_path("parameters/controller.yaml"), ControllerParameters
        )
        return checked(
            cls, {key: entry.value for key, entry in entries.items()} | changes, "controller"
        )

    @classmethod
    def from_scenario(cls, scenario: Any) -> "SwingSettings":
        """Settings from `controller` and `tail.mode` of a scenario, or of any object with them."""
        values = {
            key: getattr(scenario.controller, key) for key in ControllerParameters.model_fields
        }
        return checked(cls, {**values, "mode": scenario.tail.mode}, "controller")


@dataclass(frozen=True)
class SwingMemory:
    """What a law remembers between ticks. Angles as the car reports them, not mirrored.

    Args:
        state: a `SwingState`.
        since: time at which the state was entered, s.
        turn: the announcement acted upon last, +1 left, -1 right, 0 none.
        announced: when that was, s.
        mirror: +1 swings in the law's own direction, -1 mirrored, 0 before the first known angle.
        start_roll, start_pitch: of the tail when the state was entered, rad.
        roll_angle, pitch_angle: last known, rad.
    """

    state: float = SwingState.OFF
    since: float = 0.0
    turn: float = 0.0
    announced: float = 0.0
    mirror: float = 0.0
    start_roll: float = 0.0
    start_pitch: float = 0.0
    roll_angle: float = 0.0
    pitch_angle: float = 0.0


Memory = TypeVar("Memory", bound=SwingMemory)
Tick = tuple[Memory, np.ndarray, np.ndarray]
"""New memory, commands to the pitch and the roll motor, each (5): rad, rad/s, N m/rad, N m s/rad, N
m."""


class Wait(NamedTuple):
    """A tail that waits: roll and pitch, rad; gains, N m/rad and N m s/rad; delay from the release
    to the swing, s.
    """

    roll: float
    pitch: float
    kp: float
    kd: float
    delay: float


class SwingMachine(ABC, Generic[Memory]):
    """The state machine of the picture above, for every law that swings (a `TailLaw`).

    A law says where the tail waits, what releases it, when its swing is over and what it commands.
    """

    settings: SwingSettings
    memory_type: type[Memory]
    direction = 1.0
    """+1 if the law is written for turns to the left, -1 to the right."""

    @property
    def rate(self) -> float:
        """Controller rate, Hz."""
        return self.settings.rate

    @property
    def memory_size(self) -> int:
        """Number of floats that `step` carries from tick to tick."""
        return len(fields(self.memory_type))

    def start(self) -> np.ndarray:
        """Memory (memory_size,) before the first tick."""
        return _as_array(self.memory_type())

    def step(
        self, memory: np.ndarray, observation: Observation
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick: new memory (memory_size,), pitch and roll command (5), number of the state."""
        after, pitch_command, roll_command = self.tick(
            self.memory_type(*memory.tolist()), observation
        )
        return _as_array(after), pitch_command, roll_command, int(after.state)

    def tick(self, memory: Memory, observation: Observation) -> Tick[Memory]:
        """One tick of the law.

        An unknown time, roll angle or plan changes no state; a swinging tail is then held where it
        was last seen. Before the tail's angle is known once, and without a tail, all gains are
        zero.
        """
        known = math.isfinite(observation.time + observation.roll_angle + observation.planned_turn)
        if known and self.settings.mode != "none":
            pitch = self._pitch_angle(memory, observation)
            seen = replace(memory, roll_angle=observation.roll_angle, pitch_angle=pitch)
            memory = self._advance(seen, observation)
        if memory.state == SwingState.OFF:
            return memory, NO_COMMAND, NO_COMMAND
        if not known and memory.state == SwingState.SWING:
            return memory, self._held(memory.pitch_angle), self._held(memory.roll_angle)
        time = observation.time if math.isfinite(observation.time) else memory.since
        return self._commands(memory, observation, time)

    def _advance(self, memory: Memory, observation: Observation) -> Memory:
        """The next state for a known time, roll angle and plan."""
        plan = sign(observation.planned_turn)
        time = observation.time
        if memory.state == SwingState.OFF or (plan != memory.turn and not self._swinging(memory)):
            return self._plan(memory, plan, time)
        elapsed = time - memory.since + EPSILON
        if (
            memory.state == SwingState.HOLD
            and memory.turn != 0.0
            and self._released(memory, observation)
        ):
            memory = enter(SwingState.DELAY, memory, time)
            elapsed = EPSILON
        if memory.state == SwingState.DELAY and elapsed >= self._wait.delay:
            return enter(SwingState.SWING, memory, time)
        if memory.state == SwingState.SWING:
            return self._swing(memory, observation, elapsed)
        if memory.state == SwingState.RECOCK and elapsed >= self._recock_time(memory):
            return enter(SwingState.HOLD, memory, time)
        return memory

    def _plan(self, memory: Memory, plan: float, time: float) -> Memory:
        """Acts on a new announcement, also on the first: leads the tail to where it waits for that
        turn.

        A withdrawn announcement (0) only cancels the delay. Without any announcement at the start
        the tail is held on the side where it is found (upright counts as that of the law's own
        direction).
        """
        memory = replace(memory, turn=plan, announced=time)
        if plan == 0.0 and memory.state != SwingState.OFF:
            if memory.state == SwingState.DELAY:
                return enter(SwingState.HOLD, memory, time)
            return memory
        found = sign(memory.roll_angle * self._wait.roll) or 1.0
        memory = replace(memory, mirror=plan * self.direction if plan != 0.0 else found)
        ready = (
            self._away(memory, memory.roll_angle, memory.pitch_angle) <= self.settings.ready_angle
        )
        return enter(SwingState.HOLD if ready else SwingState.RECOCK, memory, time)

    def _away(self, memory: Memory, roll: float, pitch: float) -> float:
        """Largest distance of a joint from where it waits, rad."""
        return max(abs(roll - memory.mirror * self._wait.roll), abs(pitch - self._wait.pitch))

    def _recock_time(self, memory: Memory) -> float:
        return (
            self._away(memory, memory.start_roll, memory.start_pitch) / self.settings.recock_speed
        )

    def _held(self, angle: float) -> np.ndarray:
        """Command (5) that holds a joint."""
        return np.array([angle, 0.0, self._wait.kp, self._wait.kd, 0.0])

    def _swinging(self, memory: Memory) -> bool:
        """Whether a new announcement must wait until the swing is over."""
        return memory.state == SwingState.SWING

    @property
    @abstractmethod
    def _wait(self) -> Wait:
        """Where and how the tail waits for a turn in the law's own direction."""

    @abstractmethod
    def _pitch_angle(self, memory: Memory, observation: Observation) -> float:
        """Pitch angle of the tail that the law uses, rad."""

    @abstractmethod
    def _released(self, memory: Memory, observation: Observation) -> bool:
        """Whether a fresh signal shows that the announced turn has begun."""

    @abstractmethod
    def _swing(self, memory: Memory, observation: Observation, elapsed: float) -> Memory:
        """The memory while the tail swings, `elapsed` s after its release: enters the next state
        when it is over.
        """

    @abstractmethod
    def _commands(self, memory: Memory, observation: Observation, time: float) -> Tick[Memory]:
        """What the tail is to do in any state but OFF."""


def _as_array(memory: SwingMemory) -> np.ndarray:
    # `vars` keeps the order of the fields; `astuple` would copy deeply.
    return np.array(list(vars(memory).values()))


def enter(state: SwingState, memory: Memory, time: float) -> Memory:
    """Memory with a state that begins at a time, s."""
    return replace(
        memory,
        state=float(state),
        since=time,
        start_roll=memory.roll_angle,
        start_pitch=memory.pitch_angle,
    )


@dataclass(frozen=True)
class SwingLaw(SwingMachine[SwingMemory]):
    """The thesis' law, Table 6.4, with slow gains for the re-cock.

    The pitch joint is held and not looked at.
    """

    settings: SwingSettings = field(default_factory=SwingSettings.published)
    memory_type = SwingMemory

    @property
    def _wait(self) -> Wait:
        settings = self.settings
        return Wait(
            -settings.hold_angle,
            settings.pitch_angle,
            settings.hold_kp,
            settings.hold_kd,
            settings.delay,
        )

    def _pitch_angle(self, memory: SwingMemory, observation: Observation) -> float:
        return self.settings.pitch_angle

    def _released(self, memory: SwingMemory, observation: Observation) -> bool:
        """False for NaN and for the wrong sign."""
        turn = memory.turn
        settings = self.settings
        if settings.mode != "swing":
            return False
        if settings.trigger == "steering":
            return turn * observation.steering_angle > settings.trigger_steering_angle
        if not observation.imu_valid:
            return False
        if settings.trigger == "lateral_acceleration":
            return turn * observation.imu[ACCELERATION_Y] > settings.trigger_lateral_acceleration
        return turn * observation.yaw_rate > settings.trigger_yaw_rate

    def _swing(self, memory: SwingMemory, observation: Observation, elapsed: float) -> SwingMemory:
        settings = self.settings
        travelled = memory.turn * (memory.roll_angle - memory.start_roll)
        stalled = elapsed >= settings.stall_factor * settings.travel / settings.swing_speed
        over = travelled >= settings.travel or stalled
        if over:
            return enter(SwingState.SETTLE, memory, observation.time)
        return memory

    def _commands(
        self, memory: SwingMemory, observation: Observation, time: float
    ) -> Tick[SwingMemory]:
        settings = self.settings
        outside = memory.mirror * self.settings.hold_angle
        roll = self._held(-outside)
        if memory.state == SwingState.SWING:
            roll = np.array(
                [0.0, memory.turn * settings.swing_speed, settings.swing_kp, settings.swing_kd, 0.0]
            )
        elif memory.state == SwingState.SETTLE:
            roll = np.array([outside, 0.0, settings.settle_kp, settings.settle_kd, 0.0])
        elif memory.state == SwingState.RECOCK:
            speed = math.copysign(settings.recock_speed, -outside - memory.start_roll)
            position = memory.start_roll + speed * (time - memory.since)
            if time - memory.since + EPSILON >= self._recock_time(memory):
                position = -outside
                speed = 0.0
            roll = np.array([position, speed, settings.settle_kp, settings.settle_kd, 0.0])
        return memory, self._held(settings.pitch_angle), roll
