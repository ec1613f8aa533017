"""Turns of many reduced cars at once, each with its own floor, steering and swing, and the results
that a search needs.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.compiled.steps import run
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import (
    STEP,
    Rollout,
    heights,
    tick_flags,
)
from aerodima.workbench.car.reduced.states import RATES, STATES, TAIL_RATE, V, W, up_in_body
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.verdict import (
    has_flipped,
    has_settled,
    is_busy,
    is_calm,
    is_loaded,
)
from aerodima.workbench.control.manoeuvre import (
    TICK_TOLERANCE,
    pulse_angle,
    ramp_speed,
    turn_length,
    wheel_angle,
)
from aerodima.workbench.control.swing_law import (
    SwingPhase,
    SwingState,
    is_over,
    is_released,
    next_phase,
    roll_command,
)
from aerodima.workbench.control.tail_law import EPSILON
from aerodima.workbench.core.array_types import BoolArray, FloatArray

WITHIN = (np.arange(8.0)[:, None] + 0.5) / 8.0
"""Instants of a step, as shares of its length: the wheels' angle in a step is the mean over them,
so that it changes smoothly with the times of the steering."""
HISTORY = ("history", "loads")
"""Fields of `Turns` that `TurnRollout` returns for every step."""
LEFT = 1.0
"""Side of all turns."""


@dataclass(frozen=True)
class Turns:
    """Results of n turns.

    Attributes:
        survived: whether the car survived, as in the outcome of a full run (n).
        clean: whether it survived, and tail and board stayed off the ground (n).
        heading: change of heading from the start of the turn until the car has settled, else to
            the end (n), rad.
        last: states at the end (24, n).
        history: every state (steps, 24, n), when asked for.
        loads: loads of the wheels in these steps (steps, 4, n), N, when asked for.
    """

    survived: BoolArray
    clean: BoolArray
    heading: FloatArray
    last: FloatArray
    history: FloatArray | None = None
    loads: FloatArray | None = None


class TurnRollout(Rollout):
    """Cars in a turn to the left; times are s since the start of the steering.

    Args:
        cars, plans: parameters and plans of the n cars.
        state: states at the beginning (24, n).
        length: length of a step, s.
    """

    def __init__(
        self, cars: VehicleParams, plans: TurnPlans, state: FloatArray, length: float
    ) -> None:
        super().__init__(cars, state, int(np.max(plans.imu_delay)), length)
        n = cars.count
        self._plans = plans
        self._phase = np.full(n, float(SwingState.HOLD))
        self._since, self._start_roll = np.zeros((2, n))
        pulse = plans.pulse
        levels = (pulse.steer_angle, pulse.hold, pulse.first_angle, pulse.first_hold)
        self._straight = turn_length(plans.servo_rate, *levels)
        self.begin_turn()

    def begin_turn(self) -> None:
        """Begins a new record of the turn from the present state."""
        self._first_yaw = self.state[3]
        self._restless = self._straight
        self._settled_yaw = np.full_like(self._straight, np.nan)
        self._clearance = np.full_like(self._straight, np.inf)

    def tick(self, time: Any) -> None:
        """Asks the law of the tail once."""
        plans = self._plans
        law = plans.law
        roll = self.state[7]
        _, _, yaw_rate = self._measure()
        # A controller sees the driver's command of the tick before.
        steering = pulse_angle(plans.pulse, time - 1.0 / law.rate + TICK_TOLERANCE)
        signal = np.where(law.by_steering > 0.0, steering, yaw_rate)
        over = is_over(law, roll - self._start_roll, time - self._since + EPSILON)
        phase = next_phase(
            SwingPhase(self._phase, self._since, self._start_roll),
            time,
            roll,
            is_released(LEFT, signal, law.threshold),
            law.delay,
            over,
        )
        self._phase, self._since, self._start_roll = phase
        still = np.zeros_like(law.hold_kp)
        pitch = np.stack([law.pitch_angle, still, law.hold_kp, law.hold_kd])
        self._command(pitch, np.stack(roll_command(law, phase.state, LEFT)))

    def step(self, time: Any) -> tuple[FloatArray, ...]:
        """Drives one step and returns the fields that `HISTORY` names."""
        cars = self._cars
        plans = self._plans
        ramp = plans.ramp
        angles = wheel_angle(plans.pulse, plans.servo_rate, time + self._length * WITHIN)
        speed = ramp_speed(cars.speed, ramp.duration, ramp.time_constant, time + plans.pulse.start)
        self._drive(np.sum(angles, axis=0) / len(WITHIN), speed / cars.rolling_radius)
        self._record(time + self._length)
        return self.state, self.loads

    def _record(self, time: Any) -> None:
        """Records clearance and rest at a time, s."""
        state = self.state
        rates = state[RATES]
        for height in heights(state, self._cars):
            self._clearance = np.minimum(self._clearance, height)
        w_x, w_y, w_z = rates[W]
        pitch_rate, roll_rate = rates[TAIL_RATE]
        motion = {
            "gyro_x_truth_rad_per_s": w_x,
            "gyro_y_truth_rad_per_s": w_y,
            "gyro_z_truth_rad_per_s": w_z,
            "velocity_y_truth_m_per_s": rates[V][1],
            "tail_pitch_rate_rad_per_s": pitch_rate,
            "tail_roll_rate_rad_per_s": roll_rate,
        }
        calm = is_calm(motion, up_in_body(state)[2], self.loads, is_busy(self._phase))
        self._restless = np.where(calm, self._restless, np.maximum(self._restless, time))
        settles = np.isnan(self._settled_yaw) & has_settled(time, self._restless)
        self._settled_yaw = np.where(settles, state[3], self._settled_yaw)

    def results(self) -> dict[str, Any]:
        """Returns the fields of `Turns` but for the histories."""
        state = self.state
        tilt = np.arccos(np.clip(up_in_body(state)[2], -1.0, 1.0))
        survived = ~has_flipped(self.gone, tilt, ~is_loaded(self.loads).all(axis=0))
        yaw = np.where(np.isnan(self._settled_yaw), state[3], self._settled_yaw)
        return {
            "survived": survived,
            "clean": survived & (self._clearance > 0.0),
            "heading": yaw - self._first_yaw,
            "last": state,
        }


def drive_turns(
    cars: VehicleParams,
    plans: TurnPlans,
    *,
    duration: float = 2.0,
    length: float = STEP,
    history: bool = False,
    begun: FloatArray | None = None,
) -> Turns:
    """Drives the turns of n cars, from standstill on: a held sail already drags the car round on a
    slippery straight.

    Args:
        cars, plans: parameters and plans of the n cars.
        duration: time from the start of the steering, s; 0 ends with the straight, and its `last`
            can begin other turns.
        length: length of a step, s.
        history: whether to keep every state and the loads.
        begun: states (24, n) at the start of the steering of cars whose tail still waits; the
            straight is then not driven.
    """
    law = plans.law
    if begun is None:
        state = np.zeros((len(STATES), cars.count))
        state[6] = law.pitch_angle
        state[7] = -law.hold_angle
    else:
        state = begun
    begin = round(float(plans.pulse.start[0]) / length)
    first = 0 if begun is None else begin
    end = begin + round(duration / length)
    rollout = TurnRollout(cars, plans, state, length)
    kept = []
    for part in (np.arange(first, begin), np.arange(begin, end)):
        if part.size:
            rollout.begin_turn()
            ticked = tick_flags(part, float(law.rate[0]), length) | (part == first)
            kept.append(run(rollout, ticked, (part - begin) * length, keep=history))
    histories = map(np.concatenate, zip(*kept, strict=True))
    return Turns(**rollout.results(), **dict(zip(HISTORY, histories, strict=False)))
