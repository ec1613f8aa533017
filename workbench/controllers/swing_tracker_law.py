"""Plays a swing file with feedback, as plain Python: hold, release, track, settle; the thesis' law when it goes wrong.

No Drake: the same law runs on a computer for which Drake has no wheel. `TailController` wraps it as a system.

```
           first knot reached         trigger            delay over            last knot
  RECOCK ------------------> HOLD -------------> DELAY ------------> SWING -------------> SETTLE
     ^                         ^                   |                   |                    |
     |                         +-- turn cancelled -+                   +-- left the funnel -+--> FALLBACK
     +-------- another turn announced ------------------------------------------------------+        |
     +-----------------------------------------------------------------------------------------------+
```

Car roll and rate are estimated from the IMU by `roll_filter`, inside the law, so that the delay of sensor and filter
is in the loop. A swing for the other turn direction is the exact mirror image: angles about x, yaw rate and plan are
turned before the law, roll commands after it.
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_law import SwingMemory, SwingSettings, SwingState, step
from aerodima.workbench.controllers.swing_reference import SwingReference
from aerodima.workbench.controllers.tail_law import EPSILON, NO_COMMAND, Observation, sign
from aerodima.workbench.errors import UserError
from aerodima.workbench.sensors.roll_filter import RollEstimate, RollFilterSettings, estimate_roll


class TrackerMemory(NamedTuple):
    """What the law remembers between ticks. Angles as the car reports them, not mirrored.

    Args:
        state: a `SwingState`.
        since: time at which the state was entered, s.
        turn: the announcement acted upon last, +1 left, -1 right, 0 none.
        announced: when that was, s.
        mirror: +1 plays the file as it is, -1 mirrored, 0 before the first known angle.
        start_roll, start_pitch: of the tail when the state was entered, rad.
        roll_angle, pitch_angle: last known, rad.
        fallen_state, fallen_since, fallen_start: of the thesis' law while it finishes the swing.
        car_roll, car_pitch, car_roll_rate, filter_started: of `roll_filter`.
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
    car_roll: float = 0.0
    car_pitch: float = 0.0
    car_roll_rate: float = 0.0
    filter_started: float = 0.0


@dataclass(frozen=True)
class SwingTracker:
    """The law (a `TailLaw`).

    Args:
        reference: the swing and how it is tracked.
        settings: of the thesis' law, which finishes a swing that left its funnel; its mode is taken as "swing".
        filter_settings: of the roll estimate; their rate must be the law's.

    Raises:
        UserError: the swing starts too far out, or rates that do not fit together.
    """

    reference: SwingReference
    settings: SwingSettings = field(default_factory=SwingSettings.published)
    filter_settings: RollFilterSettings = field(default_factory=RollFilterSettings)

    def __post_init__(self) -> None:
        if self.filter_settings.rate != self.settings.rate:
            raise UserError(
                f"roll_estimator.rate: {self.filter_settings.rate:g} Hz; allowed: the controller's "
                f"{self.settings.rate:g} Hz"
            )

    @classmethod
    def from_scenario(cls, swing: SwingFile, scenario: Any) -> "SwingTracker":
        """With tracking, rate and fallback of `scenario.controller` (any object with these attributes)."""
        settings = SwingSettings.from_scenario(scenario)
        return cls(
            SwingReference(swing, scenario.controller.tracking, settings.rate),
            settings,
            RollFilterSettings(rate=settings.rate, gravity=scenario.environment.gravity or 9.81),
        )

    @property
    def rate(self) -> float:
        """Controller rate, Hz."""
        return self.settings.rate

    @property
    def memory_size(self) -> int:
        """Number of floats that `step` carries from tick to tick."""
        return len(TrackerMemory())

    def start(self) -> np.ndarray:
        """Memory (memory_size,) before the first tick."""
        return np.array(TrackerMemory())

    def step(self, memory: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick: new memory (memory_size,), pitch command (5), roll command (5), number of the state."""
        after, pitch_command, roll_command = self._tick(TrackerMemory(*memory.tolist()), observation)
        return np.array(after), pitch_command, roll_command, int(after.state)

    def _tick(self, memory: TrackerMemory, observation: Observation) -> tuple[TrackerMemory, np.ndarray, np.ndarray]:
        memory = self._estimate(memory, observation)
        known = math.isfinite(observation.time + observation.roll_angle + observation.planned_turn)
        if known:
            pitch = observation.pitch_angle if math.isfinite(observation.pitch_angle) else memory.pitch_angle
            memory = memory._replace(roll_angle=observation.roll_angle, pitch_angle=pitch)
            memory = self._advance(memory, observation)
        if memory.state == SwingState.OFF:
            return memory, NO_COMMAND, NO_COMMAND
        if memory.state == SwingState.FALLBACK:
            return self._fall_back(memory, observation)
        if not known and memory.state == SwingState.SWING:  # hold it where it was last seen
            return memory, self._hold(memory.pitch_angle), self._hold(memory.roll_angle)
        time = observation.time if math.isfinite(observation.time) else memory.since
        pitch_command, roll_command = self._commands(memory, observation, time)
        roll_command[[0, 1, 4]] *= memory.mirror
        return memory, pitch_command, roll_command

    def _estimate(self, memory: TrackerMemory, observation: Observation) -> TrackerMemory:
        before = RollEstimate(memory.car_roll, memory.car_pitch, memory.car_roll_rate, memory.filter_started)
        after = estimate_roll(before, np.array(observation.imu), observation.speed, self.filter_settings)
        return memory._replace(
            car_roll=after.roll, car_pitch=after.pitch, car_roll_rate=after.roll_rate, filter_started=after.started
        )

    def _advance(self, memory: TrackerMemory, observation: Observation) -> TrackerMemory:
        """The state machine for a known time, roll angle and plan."""
        plan, time = sign(observation.planned_turn), observation.time
        swinging = memory.state == SwingState.SWING or (
            memory.state == SwingState.FALLBACK and memory.fallen_state == SwingState.SWING
        )
        if memory.state == SwingState.OFF or (plan != memory.turn and not swinging):
            return self._plan(memory, plan, time)
        elapsed = time - memory.since + EPSILON
        if memory.state == SwingState.RECOCK and elapsed >= self._recock_time(memory):
            return _enter(SwingState.HOLD, memory, time)
        if memory.state == SwingState.HOLD and self._triggered(memory, observation):
            memory = _enter(SwingState.DELAY, memory, time)
            elapsed = EPSILON
        trigger = self.reference.swing.trigger
        if memory.state == SwingState.DELAY and (trigger.kind == "time" or elapsed >= trigger.delay_s):
            return _enter(SwingState.SWING, memory, time)
        if memory.state != SwingState.SWING:
            return memory
        if elapsed >= self.reference.length:
            return _enter(SwingState.SETTLE, memory, time)
        if self.reference.outside_funnel(time - memory.since, self._states(memory, observation)) is not None:
            inside = -memory.turn * self.settings.hold_angle
            memory = memory._replace(fallen_state=float(SwingState.SWING), fallen_since=time, fallen_start=inside)
            return _enter(SwingState.FALLBACK, memory, time)
        return memory

    def _plan(self, memory: TrackerMemory, plan: float, time: float) -> TrackerMemory:
        """Acts on a new announcement, also on the first: leads the tail to the first knot for that turn.

        A withdrawn announcement (0) only cancels the delay. Without any announcement at the start the tail is held on
        the side where it is found.
        """
        memory = memory._replace(turn=plan, announced=time)
        if plan == 0.0 and memory.state != SwingState.OFF:
            return _enter(SwingState.HOLD, memory, time) if memory.state == SwingState.DELAY else memory
        if plan != 0.0:
            mirror = plan if self.reference.swing.direction == "left" else -plan
        else:
            mirror = sign(memory.roll_angle * self.reference.start[0]) or 1.0
        memory = memory._replace(mirror=mirror)
        roll, pitch = self._first_knot(memory)
        away = max(abs(memory.roll_angle - roll), abs(memory.pitch_angle - pitch))
        ready = away <= self.settings.ready_angle
        return _enter(SwingState.HOLD if ready else SwingState.RECOCK, memory, time)

    def _triggered(self, memory: TrackerMemory, observation: Observation) -> bool:
        trigger = self.reference.swing.trigger
        if memory.turn == 0.0:
            return False
        if trigger.kind == "time":
            return observation.time - memory.announced + EPSILON >= trigger.delay_s
        if trigger.kind == "steering":
            assert trigger.threshold_rad is not None
            return memory.turn * observation.steering_angle > trigger.threshold_rad
        assert trigger.threshold_rad_per_s is not None
        return observation.imu_valid and memory.turn * observation.yaw_rate > trigger.threshold_rad_per_s

    def _first_knot(self, memory: TrackerMemory) -> tuple[float, float]:
        """Roll and pitch, rad, as the car reports them."""
        roll, pitch = self.reference.start
        return memory.mirror * roll, pitch

    def _recock_time(self, memory: TrackerMemory) -> float:
        roll, pitch = self._first_knot(memory)
        return max(abs(roll - memory.start_roll), abs(pitch - memory.start_pitch)) / self.settings.recock_speed

    def _states(self, memory: TrackerMemory, observation: Observation) -> dict[str, float]:
        """Values of `FEEDBACK_STATES` in the direction of the file; NaN for what is not known."""
        seen = observation.imu_valid and memory.filter_started != 0.0
        return {
            "car_roll": memory.mirror * memory.car_roll if seen else math.nan,
            "car_roll_rate": memory.mirror * memory.car_roll_rate if seen else math.nan,
            "tail_roll": memory.mirror * observation.roll_angle,
            "tail_roll_rate": memory.mirror * observation.roll_rate,
            "tail_pitch": observation.pitch_angle,
            "tail_pitch_rate": observation.pitch_rate,
        }

    def _commands(self, memory: TrackerMemory, observation: Observation, time: float) -> tuple[np.ndarray, np.ndarray]:
        """Pitch and roll command (5) in the direction of the file."""
        swing, elapsed = self.reference.swing, time - memory.since
        if memory.state == SwingState.SWING:
            roll, pitch = self.reference.commands(elapsed, self._states(memory, observation))
            return np.array(pitch), np.array(roll)
        if memory.state == SwingState.SETTLE:
            last, knots = swing.gains.phases[-1], swing.knots
            pitch_command = [knots.pitch_position_rad[-1], 0.0, last.pitch.kp, last.pitch.kd, 0.0]
            return np.array(pitch_command), np.array(
                [knots.roll_position_rad[-1], 0.0, last.roll.kp, last.roll.kd, 0.0]
            )
        hold = swing.gains.hold
        roll_target, pitch_target = self.reference.start
        if memory.state == SwingState.RECOCK:
            share = min(1.0, elapsed / max(self._recock_time(memory), EPSILON))
            from_roll = memory.mirror * memory.start_roll
            kp, kd = self.settings.settle_kp, self.settings.settle_kd
            roll_command = [from_roll + share * (roll_target - from_roll), 0.0, kp, kd, 0.0]
            pitch_ramp = memory.start_pitch + share * (pitch_target - memory.start_pitch)
            return np.array([pitch_ramp, 0.0, hold.kp, hold.kd, 0.0]), np.array(roll_command)
        return (
            np.array([pitch_target, 0.0, hold.kp, hold.kd, 0.0]),
            np.array([roll_target, 0.0, hold.kp, hold.kd, 0.0]),
        )

    def _fall_back(
        self, memory: TrackerMemory, observation: Observation
    ) -> tuple[TrackerMemory, np.ndarray, np.ndarray]:
        """The thesis' law from where the tail is: on over the top, then settle outside."""
        thesis = SwingMemory(
            memory.fallen_state, memory.fallen_since, memory.turn, memory.turn, memory.fallen_start, memory.roll_angle
        )
        same_turn = Observation(
            observation.time, 0.0, observation.roll_angle, memory.pitch_angle, memory.turn, imu_valid=False
        )
        after, pitch_command, roll_command = step(thesis, same_turn, self.settings)
        memory = memory._replace(fallen_state=after.state, fallen_since=after.since, fallen_start=after.start_angle)
        return memory, pitch_command, roll_command

    def _hold(self, angle: float) -> np.ndarray:
        hold = self.reference.swing.gains.hold
        return np.array([angle, 0.0, hold.kp, hold.kd, 0.0])


def _enter(state: SwingState, memory: TrackerMemory, time: float) -> TrackerMemory:
    return memory._replace(state=float(state), since=time, start_roll=memory.roll_angle, start_pitch=memory.pitch_angle)
