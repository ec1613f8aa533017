"""State machine around the laws that swing the tail, and the thesis' law as a `TailLaw`.

`law_of_scenario` makes the law, `TailController` calls it in a diagram,
`aerodima.hardware.driving.plain_loop.LawPilot` without Drake. A right turn is the exact mirror
image of a left one.

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
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from aerodima.workbench.control.swing_law import (
    JointCommand,
    SwingPhase,
    SwingSettings,
    SwingState,
    is_over,
    is_released,
    next_phase,
    roll_command,
)
from aerodima.workbench.control.tail_law import EPSILON, NO_COMMAND, LawStep, Observation, sign
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.signal_table import IMU

ACCELERATION_Y = IMU.index("acceleration_y")


@dataclass(frozen=True)
class SwingMemory:
    """Memory of a law between ticks. Angles are as the car reports them, not mirrored.

    Args:
        state: a `SwingState`.
        since: time at which the state was entered, s.
        turn: announcement acted upon last, +1 left, -1 right, 0 none.
        announced: time of that announcement, s.
        mirror: direction of the swing, +1 the law's own, -1 mirrored, 0 before the first known
            angle.
        start_roll, start_pitch: roll and pitch of the tail when the state was entered, rad.
        roll_angle, pitch_angle: last known angles of the tail, rad.
        fallen_state, fallen_since, fallen_start: `state`, `since` and `start_roll` of the thesis'
            law while it finishes a swing that was given up.
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
    fallen_state: float = SwingState.SWING
    fallen_since: float = 0.0
    fallen_start: float = 0.0


Tick = tuple[SwingMemory, FloatArray, FloatArray]
"""New memory, and commands to the pitch and the roll motor, each (5): rad, rad/s, N m/rad,
N m s/rad, N m."""


class Wait(NamedTuple):
    """Wait of a tail: its roll and pitch, rad; gains, N m/rad and N m s/rad; delay from the release
    to the swing, s.
    """

    roll: float
    pitch: float
    kp: float
    kd: float
    delay: float


class SwingMachine:
    """The state machine of the picture above, for every law that swings (a `TailLaw`).

    The wait, the release, the end of the swing and the commands are those of the thesis' law unless
    another law overrides them.
    """

    settings: SwingSettings
    direction = 1.0
    """+1 if the law is written for turns to the left, -1 to the right."""

    @property
    def rate(self) -> float:
        """Returns the controller rate, Hz."""
        return self.settings.rate

    @property
    def memory_size(self) -> int:
        """Returns the number of floats that `step` carries from tick to tick."""
        return len(fields(SwingMemory))

    def start(self) -> FloatArray:
        """Returns the memory (memory_size,) before the first tick."""
        return _as_array(SwingMemory())

    def step(self, memory: FloatArray, observation: Observation) -> LawStep:
        """Returns new memory (memory_size,), pitch and roll command (5), number of the state after
        one tick.
        """
        after, pitch_command, roll_command = self.tick(SwingMemory(*memory.tolist()), observation)
        return _as_array(after), pitch_command, roll_command, int(after.state)

    def tick(self, memory: SwingMemory, observation: Observation) -> Tick:
        """Ticks the law once.

        An unknown time, roll angle or plan changes no state; a swinging tail is then held where it
        was last seen. Before the tail's angle is known once, and without a tail, all gains are
        zero.
        """
        known = math.isfinite(observation.time + observation.roll_angle + observation.planned_turn)
        if known and self.settings.mode != "none":
            pitch = self._pitch_angle(memory, observation)
            updated = replace(memory, roll_angle=observation.roll_angle, pitch_angle=pitch)
            memory = self._advance(updated, observation)
        if memory.state == SwingState.OFF:
            return memory, NO_COMMAND, NO_COMMAND
        if not known and memory.state == SwingState.SWING:
            return memory, self._held(memory.pitch_angle), self._held(memory.roll_angle)
        time = observation.time if math.isfinite(observation.time) else memory.since
        return self._commands(memory, observation, time)

    def _advance(self, memory: SwingMemory, observation: Observation) -> SwingMemory:
        """Returns the next state for a known time, roll angle and plan."""
        plan = sign(observation.planned_turn)
        time = observation.time
        if memory.state == SwingState.OFF or (plan != memory.turn and not self._swinging(memory)):
            return self._plan(memory, plan, time)
        elapsed = time - memory.since + EPSILON
        if memory.state == SwingState.RECOCK and elapsed >= self._recock_time(memory):
            return enter(SwingState.HOLD, memory, time)
        waits = memory.state == SwingState.HOLD and memory.turn != 0.0
        phase = SwingPhase(memory.state, memory.since, memory.start_roll)
        state = next_phase(
            phase,
            time,
            memory.roll_angle,
            waits and self._released(memory, observation),
            self._wait.delay,
            memory.state == SwingState.SWING and self._is_over(memory, elapsed),
        ).state
        if state == memory.state:
            return memory
        return enter(SwingState(state), memory, time)

    def _plan(self, memory: SwingMemory, plan: float, time: float) -> SwingMemory:
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
        side = sign(memory.roll_angle * self._wait.roll) or 1.0
        if plan != 0.0:
            side = plan * self.direction
        memory = replace(memory, mirror=side)
        ready = (
            self._away(memory, memory.roll_angle, memory.pitch_angle) <= self.settings.ready_angle
        )
        return enter(SwingState.HOLD if ready else SwingState.RECOCK, memory, time)

    def _away(self, memory: SwingMemory, roll: float, pitch: float) -> float:
        """Returns the largest distance of a joint from where it waits, rad."""
        return max(abs(roll - memory.mirror * self._wait.roll), abs(pitch - self._wait.pitch))

    def _recock_time(self, memory: SwingMemory) -> float:
        return (
            self._away(memory, memory.start_roll, memory.start_pitch) / self.settings.recock_speed
        )

    def _held(self, angle: float) -> FloatArray:
        """Returns the command (5) that holds a joint."""
        return np.array([angle, 0.0, self._wait.kp, self._wait.kd, 0.0])

    def _swinging(self, memory: SwingMemory) -> bool:
        """Returns whether a new announcement must wait until the swing is over."""
        return memory.state == SwingState.SWING

    @property
    def _wait(self) -> Wait:
        """Returns where and how the tail waits for a turn in the law's own direction."""
        settings = self.settings
        return Wait(
            -settings.hold_angle,
            settings.pitch_angle,
            settings.hold_kp,
            settings.hold_kd,
            settings.delay,
        )

    def _pitch_angle(self, memory: SwingMemory, observation: Observation) -> float:
        """Returns the pitch angle of the tail that the law uses, rad."""
        return self.settings.pitch_angle

    def _released(self, memory: SwingMemory, observation: Observation) -> bool:
        """Returns whether a fresh signal shows that the announced turn has begun; False for NaN
        and for the wrong sign.
        """
        if self.settings.mode != "swing":
            return False
        trigger = self.settings.trigger
        if trigger == "steering":
            signal = observation.steering_angle
        elif not observation.imu_valid:
            return False
        elif trigger == "yaw_rate":
            signal = observation.yaw_rate
        else:
            signal = observation.imu[ACCELERATION_Y]
        return bool(is_released(memory.turn, signal, self.settings.threshold))

    def _is_over(self, memory: SwingMemory, elapsed: float) -> bool:
        """Returns whether a swing is at its end, `elapsed` s after its release."""
        travelled = memory.turn * (memory.roll_angle - memory.start_roll)
        return bool(is_over(self.settings, travelled, elapsed))

    def _commands(self, memory: SwingMemory, observation: Observation, time: float) -> Tick:
        """Returns memory and commands in any state but OFF."""
        settings = self.settings
        command = roll_command(settings, memory.state, memory.mirror)
        if memory.state == SwingState.RECOCK:
            inside = -memory.mirror * settings.hold_angle
            speed = math.copysign(settings.recock_speed, inside - memory.start_roll)
            position = memory.start_roll + speed * (time - memory.since)
            if time - memory.since + EPSILON >= self._recock_time(memory):
                position = inside
                speed = 0.0
            command = JointCommand(position, speed, settings.settle_kp, settings.settle_kd)
        return memory, self._held(settings.pitch_angle), np.array([*command, 0.0])


def _as_array(memory: SwingMemory) -> FloatArray:
    # `vars` keeps the order of the fields; `astuple` would copy deeply.
    return np.array(list(vars(memory).values()))


def enter(state: SwingState, memory: SwingMemory, time: float) -> SwingMemory:
    """Returns the memory with a state that begins at a time, s."""
    return replace(
        memory,
        state=float(state),
        since=time,
        start_roll=memory.roll_angle,
        start_pitch=memory.pitch_angle,
    )


@dataclass(frozen=True)
class SwingLaw(SwingMachine):
    """The thesis' law, Table 6.4, with slow gains for the re-cock.

    The pitch joint is held and not looked at.
    """

    settings: SwingSettings
