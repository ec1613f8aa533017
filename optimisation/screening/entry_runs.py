"""Manoeuvres of many reduced cars that begin rolling, steered open loop or as a fishhook, with the feedback law.

The law sees the IMU late, as on the full car, but without noise and bias, and the speed without delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.screening.compiled import run
from aerodima.optimisation.screening.turns import course, heights
from aerodima.optimisation.screening.vehicle_motion import RATES, SPIN, STATES, TINY, TRAVEL, V, W, advance, dot, up
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.feedback_law import Seen, respond
from aerodima.workbench.controllers.manoeuvre import make_schedule, run_time
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.metrics.tip_up import LAST, TWO_WHEELS
from aerodima.workbench.metrics.turn_course import velocity_over_ground
from aerodima.workbench.metrics.turn_signals import EXIT_YAW_RATE

STEP = 0.002
"""s."""
STRAIGHT = 0.01
"""rad; below it a command steers to no side."""
TURN = 2.0 * np.pi
LEAD = 0.1
"""s; of the straight before the steering so much is driven."""


@dataclass(frozen=True)
class Entries:
    """What came of n runs.

    Attributes:
        upright: no two wheels of a side in the air, no tail on the ground, no board while the car is steered, not
            flipped; and straight again at the end, as `optimisation.entry.entry_speed` asks.
        figure: mean lateral acceleration of the course to the side that is steered to, m/s2.
    """

    upright: np.ndarray
    figure: FloatArray


def enter(cars: Vehicles, scenario: Scenario, gains: Any, steers_tail: FloatArray) -> Entries:
    """Drives n cars that begin rolling at their speeds through the manoeuvre of a scenario, to the left.

    Args:
        cars: n of them.
        scenario: of manoeuvre, servo, controller and IMU; wheelbase of all.
        gains: fields of `FeedbackParameters` as arrays (n).
        steers_tail: 1 where the law rolls the tail, 0 where its roll is held in the middle (n).

    Raises:
        UserError: a manoeuvre that follows a path.
    """
    plan, rate = scenario.manoeuvre, scenario.controller.rate
    if plan.kind == "path":
        raise UserError("manoeuvre.kind: path; the screening model knows: turn, fishhook, slalom, rising")
    entering, start = Entering(cars, scenario, gains, steers_tail), plan.turn_start - LEAD
    steps, last, ticks = round((run_time(scenario) - start) / STEP), round(LAST / STEP), round(1.0 / (STEP * rate))
    index = np.arange(steps)
    ticked, time = index % ticks == 0, start + index * STEP
    planned = np.zeros(steps)
    if plan.kind != "fishhook":
        schedule = make_schedule(scenario)
        planned[ticked] = [schedule.at(one).steering_angle for one in time[ticked]]
    run(entering, ticked, time, planned, 1.0 * (time >= plan.turn_start), (index >= steps - last) / last)
    straight = np.isnan(entering.ending) | (np.abs(entering.ending) <= EXIT_YAW_RATE)  # NaN: it is steered to the end
    return Entries(entering.upright & straight, entering.total / np.maximum(entering.steered, 1.0))


class Entering:
    """Cars on the way, a batch of `compiled.run`.

    A step is given its time (s), the steering command (rad) that is planned where a tick begins it, 1 where the course
    counts, and its share in the end of the run.

    Attributes:
        state: (24, n).
        upright, total, steered, ending: what `Entries` is made of (n).

    Args: as of `enter`.
    """

    def __init__(self, cars: Vehicles, scenario: Scenario, gains: Any, steers_tail: FloatArray) -> None:
        plan, controller, n = scenario.manoeuvre, scenario.controller, cars.count
        self._cars, self._gains, self._steers_tail, self._fishhook = cars, gains, steers_tail, plan.kind == "fishhook"
        numbers = [scenario.car.wheelbase, scenario.servo.rate, controller.hold_kp, controller.hold_kd]
        numbers += [plan.turn_start, plan.steer_angle, plan.turn_hold, plan.counter_roll_rate]
        self._wheelbase, self._servo_rate, kp, kd, *fishhook = np.outer(numbers, np.ones(n))
        self._rate = controller.rate
        self._start, self._angle, self._hold, self._counter_roll_rate = fishhook
        self._pitch = np.stack([gains.pitch_angle, np.zeros(n), kp, kd])
        self.state, self._tail = np.zeros((len(STATES), n)), np.zeros((2, 4, n))
        self.state[RATES][V][0], self.state[RATES][SPIN] = cars.speed, cars.speed / cars.rolling_radius
        self.state[6] = gains.pitch_angle
        self._seen = np.zeros((1 + round(np.ceil(scenario.imu.delay * controller.rate - 1e-9)), 3, n))
        self._steering, self._command, self._reference, self._course = np.zeros((4, n))
        self._counter, self._gone = np.full(n, np.inf), np.zeros(n, bool)
        self.upright, (self.total, self.steered, self.ending) = np.ones(n, bool), np.zeros((3, n))

    def tick(self, time: Any, planned: Any, *_: Any) -> None:
        """Asks the law and the driver."""
        state = self.state
        self._seen = np.concatenate([self._seen[1:], np.stack([state[5], *state[RATES][W][::2]])[None]])
        roll, roll_rate, yaw_rate = self._seen[0]
        seen = Seen(roll, roll_rate, yaw_rate, state[RATES][V][0], self._command, True)
        found = respond(self._gains, self._wheelbase, self._rate, self._reference, seen)
        self._reference = self._steers_tail * found.reference
        swung = np.stack([self._reference, 0.0 * self._reference, self._gains.kp, self._gains.kd])
        self._tail = np.stack([self._pitch, swung]) * self._cars.has_tail
        if not self._fishhook:
            self._command = planned + 0.0 * self._command
        else:
            reach = self._angle / self._servo_rate
            falls = (time >= self._start + reach) & (roll_rate < self._counter_roll_rate) & (self._counter == np.inf)
            self._counter = np.where(falls, time, self._counter)
            first = np.where(time + 1e-9 >= self._start, self._angle, 0.0)
            steered = np.where(time < self._counter, first, -self._angle)
            self._command = np.where(time >= self._counter + 2.0 * reach + self._hold, 0.0, steered)

    def step(self, time: Any, planned: Any, counts: Any, share: Any) -> None:
        """Drives one step and judges it."""
        cars, most = self._cars, self._servo_rate * STEP
        self._steering = self._steering + np.clip(self._command - self._steering, -most, most)
        both = np.stack([self._steering, self._steering])
        new, _ = advance(STEP, cars, self.state, both, cars.speed / cars.rolling_radius, self._tail)
        self.state = state = np.where(self._gone, self.state, new)
        lift, (sail, board) = wheel_lifts(state, cars, self._steering), heights(state, cars)
        side = np.maximum(np.minimum(lift[0], lift[2]), np.minimum(lift[1], lift[3]))
        self._gone = self._gone | (up(state[4], state[5])[2] < np.cos(FLIP_TILT))
        steers = np.abs(self._command) > STRAIGHT
        fine = (side <= TWO_WHEELS) & (sail > 0.0) & ((board > 0.0) | ~steers) & ~self._gone
        self.upright = self.upright & (fine | (counts == 0.0))
        self.ending = self.ending + np.where(steers & (share > 0.0), np.nan, state[14] * share)
        ahead, left = velocity_over_ground(state[RATES][V], state[RATES][W], state[5], state[4], cars.com_x)
        now = course(state, cars)
        turned = now - self._course
        turned = (turned - TURN * np.rint(turned / TURN)) / STEP
        to_side = np.where(self._command > 0.0, turned, -turned) * np.sqrt(ahead * ahead + left * left)
        self._course = np.where(counts > 0.0, now, 0.0)
        self.total = self.total + counts * np.where(steers, to_side, 0.0)
        self.steered = self.steered + counts * np.where(steers, 1.0, 0.0)


def wheel_lifts(state: FloatArray, cars: Vehicles, steering: FloatArray) -> FloatArray:
    """Height of the lowest point of each tyre over the ground (4, n), m; negative where it presses into it.

    Args:
        state: (24, n).
        cars: n of them.
        steering: angle of the front wheels (n), rad.
    """
    n = up(state[4], state[5])[:, None]
    steer = np.concatenate([np.stack([steering, steering]), np.zeros((2, cars.count))])
    tilt = dot(np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer]), n)
    reach = np.sqrt(cars.tyre_radius**2 * (1.0 - tilt * tilt + TINY) + cars.tyre_half_width**2 * tilt * tilt)
    centre = np.stack([cars.wheel[0], cars.wheel[1], cars.wheel[2] + state[TRAVEL]])
    found: FloatArray = state[2] + dot(n, centre) - cars.edge * np.abs(tilt) - reach
    return found


def climb(
    cars: Vehicles, speeds: FloatArray, scenario: Scenario, gains: Any, steers_tail: FloatArray
) -> tuple[np.ndarray, FloatArray]:
    """Whether n cars stay upright at speeds (m, n), m/s, and their figures, (m, n) each; all runs at once."""
    which, speed = np.tile(np.arange(cars.count), len(speeds)), speeds.ravel()
    tried = cars.take(which)
    tried = replace(tried, speed=speed, slip_speed=tried.slip_speed * speed / tried.speed)  # of a slip angle
    own = SimpleNamespace(**{name: values[which] for name, values in vars(gains).items()})
    found = enter(tried, scenario, own, steers_tail[which])
    return found.upright.reshape(speeds.shape), found.figure.reshape(speeds.shape)
