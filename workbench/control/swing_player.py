"""Player of a swing file, in plain Python: hold, release, follow the knots, settle; the thesis' law
when that fails.

No Drake: the same law runs on a computer for which Drake has no wheel. `TailController` wraps it as
a system. The states are those of `swing_law`: the tail waits at the first knot, and beyond its last
one it settles. A tail that is blocked or free is handed over:

```
  SWING ---- a radian from its knots ----> FALLBACK ---- another turn announced ----> RECOCK or HOLD
```

A swing for the other turn direction is the exact mirror image: angles about x, yaw rate and plan
are turned before the law, roll commands after it.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from aerodima.workbench.control.swing_law import (
    JointCommand,
    SwingSettings,
    SwingState,
    is_released,
)
from aerodima.workbench.control.swing_machine import (
    SwingLaw,
    SwingMachine,
    SwingMemory,
    Tick,
    Wait,
    enter,
)
from aerodima.workbench.control.tail_law import EPSILON, Observation
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, Pair
from aerodima.workbench.core.elementwise import clip
from aerodima.workbench.scenario.swing_file import JointGains, SwingFile, cubic, gains_at, swing_at

LARGEST_ERROR = 1.0
"""Largest distance of a joint from its knots, rad; beyond it the swing is given up."""


@dataclass(frozen=True)
class RollTrajectory:
    """Knots of the roll of n tails in a turn to the left; the last axis of every field is the car.

    Attributes:
        time: times of the knots since the release (knots, n), s, strictly increasing, the first 0;
            before and after them the tail rests.
        roll, rate: roll of the tail at the knots and its rate (knots, n), rad and rad/s.
        kp, kd: gains of the roll motor, N m/rad, N m s/rad.
        pitch_kp, pitch_kd: gains of the pitch motor, N m/rad, N m s/rad.
    """

    time: FloatArray
    roll: FloatArray
    rate: FloatArray
    kp: FloatArray
    kd: FloatArray
    pitch_kp: FloatArray
    pitch_kd: FloatArray

    def command(self, elapsed: Any, rate: Any) -> JointCommand:
        """Returns the command to the roll motors in a tick; arguments as for `middle_of_tick`."""
        time = middle_of_tick(elapsed, rate)
        ends = [
            values[side]
            for values in (self.time, self.roll, self.rate)
            for side in (slice(-1), slice(1, None))
        ]
        pieces = np.stack(ends, axis=1)  # (knots - 1, 6, n)
        piece = pieces[0]
        for number in range(1, len(pieces)):
            piece = np.where(self.time[number] <= time, pieces[number], piece)
        begin, end, roll, next_roll, roll_rate, next_rate = piece
        length = end - begin
        share = np.clip((time - begin) / length, 0.0, 1.0)
        value, slope = cubic(share, length, (roll, next_roll), (roll_rate, next_rate))
        rests = (time < 0.0) | (time > self.time[-1])
        return JointCommand(value, np.where(rests, 0.0, slope), self.kp, self.kd)


def middle_of_tick(elapsed: Any, rate: Any) -> Any:
    """Returns the time since the release (s) whose knots are commanded at a tick.

    A command is held until the next tick, so position and rate are those of the middle between the
    two.

    Args:
        elapsed: time since the release, s.
        rate: rate of the controller, Hz.
    """
    return elapsed + 0.5 / rate


@dataclass(frozen=True)
class SwingPlayer(SwingMachine):
    """The law (a `TailLaw`) that plays a swing file.

    Args:
        swing: swing file to play.
        settings: settings of the thesis' law, which finishes a swing that is given up; its mode is
            taken as "swing". Its delay is added to the file's.
    """

    swing: SwingFile
    settings: SwingSettings

    @classmethod
    def from_scenario(cls, swing: SwingFile, scenario: Any) -> Self:
        """Makes the player with rate and fallback of `scenario.controller` (any object with these
        attributes).
        """
        return cls(swing, SwingSettings.from_scenario(scenario))

    @property
    def direction(self) -> float:  # type: ignore[override]  # a field of the file
        """Returns +1 for a swing file of a left turn, -1 of a right one."""
        return 1.0 if self.swing.direction == "left" else -1.0

    @property
    def _wait(self) -> Wait:
        knots = self.swing.knots
        hold = self.swing.gains.hold
        trigger = self.swing.trigger
        delay = 0.0 if trigger.kind == "time" else trigger.delay_s
        roll = knots.roll_position_rad[0]
        pitch = knots.pitch_position_rad[0]
        return Wait(roll, pitch, hold.kp, hold.kd, delay + self.settings.delay)

    def _swinging(self, memory: SwingMemory) -> bool:
        state = memory.fallen_state if memory.state == SwingState.FALLBACK else memory.state
        return state == SwingState.SWING

    def _pitch_angle(self, memory: SwingMemory, observation: Observation) -> float:
        pitch = observation.pitch_angle
        return pitch if math.isfinite(pitch) else memory.pitch_angle

    def _released(self, memory: SwingMemory, observation: Observation) -> bool:
        trigger = self.swing.trigger
        if trigger.kind == "time":
            return observation.time - memory.announced + EPSILON >= trigger.delay_s
        signal = observation.yaw_rate
        threshold = trigger.threshold_rad_per_s
        if trigger.kind == "steering":
            signal = observation.steering_angle
            threshold = trigger.threshold_rad
        elif not observation.imu_valid:
            return False
        return bool(is_released(memory.turn, signal, threshold))

    def _is_over(self, memory: SwingMemory, elapsed: float) -> bool:
        return elapsed >= self.swing.knots.time_s[-1]

    def _advance(self, memory: SwingMemory, observation: Observation) -> SwingMemory:
        """See `SwingMachine`; gives up a swing whose tail is too far from its knots."""
        after = super()._advance(memory, observation)
        if not memory.state == after.state == SwingState.SWING:
            return after
        time = observation.time
        point = swing_at(self.swing, time - memory.since)
        behind = (
            memory.mirror * observation.roll_angle - float(point.roll_position),
            observation.pitch_angle - float(point.pitch_position),
        )
        # A joint of unknown angle counts as being where it should be.
        if not any(abs(error) > LARGEST_ERROR for error in behind):
            return memory
        inside = -memory.mirror * self.direction * self.settings.hold_angle
        memory = replace(
            memory, fallen_state=float(SwingState.SWING), fallen_since=time, fallen_start=inside
        )
        return enter(SwingState.FALLBACK, memory, time)

    def _commands(self, memory: SwingMemory, observation: Observation, time: float) -> Tick:
        if memory.state == SwingState.FALLBACK:
            return self._fall_back(memory, observation)
        elapsed = time - memory.since
        wait = self._wait
        pitch = self._held(wait.pitch)
        roll = self._held(wait.roll)
        if memory.state == SwingState.SWING:
            roll, pitch = self._along_the_knots(memory, observation, elapsed)
        elif memory.state == SwingState.SETTLE:
            last = self.swing.gains.phases[-1]
            knots = self.swing.knots
            pitch = np.array([knots.pitch_position_rad[-1], 0.0, last.pitch.kp, last.pitch.kd, 0.0])
            roll = np.array([knots.roll_position_rad[-1], 0.0, last.roll.kp, last.roll.kd, 0.0])
        elif memory.state == SwingState.RECOCK:
            share = min(1.0, elapsed / max(self._recock_time(memory), EPSILON))
            from_roll = memory.mirror * memory.start_roll
            kp = self.settings.settle_kp
            kd = self.settings.settle_kd
            roll = np.array([from_roll + share * (wait.roll - from_roll), 0.0, kp, kd, 0.0])
            pitch = self._held(memory.start_pitch + share * (wait.pitch - memory.start_pitch))
        roll[[0, 1, 4]] *= memory.mirror
        return memory, pitch, roll

    def _along_the_knots(
        self, memory: SwingMemory, observation: Observation, elapsed: float
    ) -> ArrayPair:
        """Returns commands (5) to roll and pitch, in the direction of the file."""
        point = swing_at(self.swing, middle_of_tick(elapsed, self.rate))
        roll_gains, pitch_gains = gains_at(self.swing, elapsed)
        roll = self._command(
            (point.roll_position, point.roll_velocity, point.roll_torque),
            roll_gains,
            (memory.mirror * observation.roll_angle, memory.mirror * observation.roll_rate),
        )
        pitch = self._command(
            (point.pitch_position, point.pitch_velocity, point.pitch_torque),
            pitch_gains,
            (observation.pitch_angle, observation.pitch_rate),
        )
        return roll, pitch

    def _command(self, wanted: tuple[Any, Any, Any], gains: JointGains, state: Pair) -> FloatArray:
        """Returns the position, rate, gains and torque for a joint at a state (rad, rad/s).

        The torque is changed so that the motor, in its present state, gives no more than the
        file's limit.
        """
        position, velocity, torque = map(float, wanted)
        of_gains = gains.kp * (position - state[0]) + gains.kd * (velocity - state[1])
        if not math.isfinite(of_gains):
            of_gains = 0.0
        limit = self.swing.limits.torque_n_m
        torque = clip(of_gains + torque, -limit, limit) - of_gains
        return np.array([position, velocity, gains.kp, gains.kd, torque])

    def _fall_back(self, memory: SwingMemory, observation: Observation) -> Tick:
        """Ticks the thesis' law from where the tail is: on over the top, then settle outside."""
        turn = memory.mirror * self.direction  # also once its announcement is withdrawn
        fallen = SwingMemory(
            state=memory.fallen_state, since=memory.fallen_since, turn=turn, mirror=turn,
            start_roll=memory.fallen_start, roll_angle=memory.roll_angle,
        )  # fmt: skip
        same_turn = Observation(
            observation.time, 0.0, observation.roll_angle, memory.pitch_angle, turn, imu_valid=False
        )
        after, pitch, roll = SwingLaw(self.settings).tick(fallen, same_turn)
        memory = replace(
            memory,
            fallen_state=after.state,
            fallen_since=after.since,
            fallen_start=after.start_roll,
        )
        return memory, pitch, roll
