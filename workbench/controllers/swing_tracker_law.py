"""Plays a swing file with feedback, as plain Python: hold, release, track, settle; the thesis' law when it goes wrong.

No Drake: the same law runs on a computer for which Drake has no wheel. `TailController` wraps it as a system. The
states are those of `swing_law`: the tail waits at the first knot, and beyond its last one it settles. Where it leaves
its funnel:

```
  SWING ---- left the funnel ----> FALLBACK ---- another turn announced ----> RECOCK or HOLD
```

Car roll and rate are estimated from the IMU by `roll_filter`, inside the law, so that the delay of sensor and filter
is in the loop. A swing for the other turn direction is the exact mirror image: angles about x, yaw rate and plan are
turned before the law, roll commands after it.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_law import (
    SwingLaw,
    SwingMachine,
    SwingMemory,
    SwingSettings,
    SwingState,
    Tick,
    Wait,
    enter,
)
from aerodima.workbench.controllers.swing_reference import SwingReference
from aerodima.workbench.controllers.tail_law import EPSILON, Observation
from aerodima.workbench.errors import UserError
from aerodima.workbench.sensors.roll_filter import RollEstimate, RollFilterSettings, estimate_roll


@dataclass(frozen=True)
class TrackerMemory(SwingMemory):
    """What the law remembers beside its state.

    Args:
        fallen_state, fallen_since, fallen_start: of the thesis' law while it finishes the swing.
        car_roll, car_pitch, car_roll_rate, filter_started: of `roll_filter`.
    """

    fallen_state: float = SwingState.SWING
    fallen_since: float = 0.0
    fallen_start: float = 0.0
    car_roll: float = 0.0
    car_pitch: float = 0.0
    car_roll_rate: float = 0.0
    filter_started: float = 0.0


@dataclass(frozen=True)
class SwingTracker(SwingMachine[TrackerMemory]):
    """The law (a `TailLaw`).

    Args:
        reference: the swing and how it is tracked.
        settings: of the thesis' law, which finishes a swing that left its funnel; its mode is taken as "swing". Its
            delay is waited on top of the file's.
        filter_settings: of the roll estimate; their rate must be the law's.

    Raises:
        UserError: the swing starts too far out, or rates that do not fit together.
    """

    reference: SwingReference
    settings: SwingSettings = field(default_factory=SwingSettings.published)
    filter_settings: RollFilterSettings = field(default_factory=RollFilterSettings)
    memory_type = TrackerMemory

    def __post_init__(self) -> None:
        if self.filter_settings.rate != self.settings.rate:
            raise UserError(
                f"roll_estimator.rate: {self.filter_settings.rate:g} Hz; allowed: the controller's "
                f"{self.settings.rate:g} Hz"
            )

    @classmethod
    def from_scenario(cls, swing: SwingFile, scenario: Any) -> Self:
        """With tracking, rate and fallback of `scenario.controller` (any object with these attributes)."""
        settings = SwingSettings.from_scenario(scenario)
        return cls(
            SwingReference(swing, scenario.controller.tracking, settings.rate),
            settings,
            RollFilterSettings(rate=settings.rate, gravity=scenario.environment.gravity or 9.81),
        )

    @property
    def direction(self) -> float:  # type: ignore[override]  # a field of the file
        """+1 for a swing file of a left turn, -1 of a right one."""
        return 1.0 if self.reference.swing.direction == "left" else -1.0

    @property
    def _wait(self) -> Wait:
        swing, (roll, pitch) = self.reference.swing, self.reference.start
        delay = 0.0 if swing.trigger.kind == "time" else swing.trigger.delay_s
        return Wait(roll, pitch, swing.gains.hold.kp, swing.gains.hold.kd, delay + self.settings.delay)

    @property
    def waiting(self) -> tuple[Any, ...]:
        """What decides all memory and commands until a release: trackers with the same do the same until then."""
        return self.direction, self._wait[:4], self.settings, self.filter_settings

    def waits_at(self, yaw_rate: float) -> bool:
        """Whether nothing releases the swing while the car goes straight and yaws by no more than this, rad/s."""
        trigger = self.reference.swing.trigger
        threshold = trigger.threshold_rad_per_s
        return trigger.kind == "steering" or (threshold is not None and threshold > yaw_rate)

    def tick(self, memory: TrackerMemory, observation: Observation) -> Tick[TrackerMemory]:
        """One tick: the filter of the car's roll first."""
        before = RollEstimate(memory.car_roll, memory.car_pitch, memory.car_roll_rate, memory.filter_started)
        car = estimate_roll(before, np.array(observation.imu), observation.speed, self.filter_settings)
        memory = replace(
            memory, car_roll=car.roll, car_pitch=car.pitch, car_roll_rate=car.roll_rate, filter_started=car.started
        )
        return super().tick(memory, observation)

    def _swinging(self, memory: TrackerMemory) -> bool:
        state = memory.fallen_state if memory.state == SwingState.FALLBACK else memory.state
        return state == SwingState.SWING

    def _pitch_angle(self, memory: TrackerMemory, observation: Observation) -> float:
        return observation.pitch_angle if math.isfinite(observation.pitch_angle) else memory.pitch_angle

    def _released(self, memory: TrackerMemory, observation: Observation) -> bool:
        trigger = self.reference.swing.trigger
        if trigger.kind == "time":
            return observation.time - memory.announced + EPSILON >= trigger.delay_s
        if trigger.kind == "steering":
            assert trigger.threshold_rad is not None
            return memory.turn * observation.steering_angle > trigger.threshold_rad
        assert trigger.threshold_rad_per_s is not None
        return observation.imu_valid and memory.turn * observation.yaw_rate > trigger.threshold_rad_per_s

    def _swing(self, memory: TrackerMemory, observation: Observation, elapsed: float) -> TrackerMemory:
        time = observation.time
        if elapsed >= self.reference.length:
            return enter(SwingState.SETTLE, memory, time)
        if self.reference.outside_funnel(time - memory.since, self._states(memory, observation)) is None:
            return memory
        inside = -memory.turn * self.settings.hold_angle
        memory = replace(memory, fallen_state=float(SwingState.SWING), fallen_since=time, fallen_start=inside)
        return enter(SwingState.FALLBACK, memory, time)

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

    def _commands(self, memory: TrackerMemory, observation: Observation, time: float) -> Tick[TrackerMemory]:
        if memory.state == SwingState.FALLBACK:
            return self._fall_back(memory, observation)
        swing, elapsed = self.reference.swing, time - memory.since
        roll_target, pitch_target = self.reference.start
        pitch, roll = self._held(pitch_target), self._held(roll_target)
        if memory.state == SwingState.SWING:
            commands = self.reference.commands(elapsed, self._states(memory, observation))
            roll, pitch = (np.array(command) for command in commands)
        elif memory.state == SwingState.SETTLE:
            last, knots = swing.gains.phases[-1], swing.knots
            pitch = np.array([knots.pitch_position_rad[-1], 0.0, last.pitch.kp, last.pitch.kd, 0.0])
            roll = np.array([knots.roll_position_rad[-1], 0.0, last.roll.kp, last.roll.kd, 0.0])
        elif memory.state == SwingState.RECOCK:
            share = min(1.0, elapsed / max(self._recock_time(memory), EPSILON))
            from_roll = memory.mirror * memory.start_roll
            kp, kd = self.settings.settle_kp, self.settings.settle_kd
            roll = np.array([from_roll + share * (roll_target - from_roll), 0.0, kp, kd, 0.0])
            pitch = self._held(memory.start_pitch + share * (pitch_target - memory.start_pitch))
        roll[[0, 1, 4]] *= memory.mirror
        return memory, pitch, roll

    def _fall_back(self, memory: TrackerMemory, observation: Observation) -> Tick[TrackerMemory]:
        """The thesis' law from where the tail is: on over the top, then settle outside."""
        turn = memory.turn
        fallen = SwingMemory(
            state=memory.fallen_state, since=memory.fallen_since, turn=turn, mirror=turn,
            start_roll=memory.fallen_start, roll_angle=memory.roll_angle,
        )  # fmt: skip
        same_turn = Observation(
            observation.time, 0.0, observation.roll_angle, memory.pitch_angle, turn, imu_valid=False
        )
        after, pitch, roll = SwingLaw(self.settings).tick(fallen, same_turn)
        memory = replace(memory, fallen_state=after.state, fallen_since=after.since, fallen_start=after.start_roll)
        return memory, pitch, roll
