"""Manoeuvres of many reduced cars that begin rolling, with the feedback law, steered open loop or
by their driver.

The law sees the IMU late, as on the full car, but without noise and bias, and the speed without
delay.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.workbench.car.laws import servo_step
from aerodima.workbench.car.reduced.compiled.steps import run
from aerodima.workbench.car.reduced.ground_terms import wheel_lifts
from aerodima.workbench.car.reduced.parameters import VehicleParams, regularised_slip
from aerodima.workbench.car.reduced.rollout import (
    STEP,
    Rollout,
    delay_ticks,
    heights,
    over_ground,
    tick_flags,
)
from aerodima.workbench.car.reduced.states import RATES, SPIN, STATES, V
from aerodima.workbench.car.verdict import (
    LAST,
    goes_straight,
    keeps_path,
    side_lift,
    stays_upright,
    touches_ground,
)
from aerodima.workbench.control.driver_law import (
    DriverView,
    PathDriver,
    ScheduledDriver,
    make_driver,
)
from aerodima.workbench.control.feedback_law import FeedbackSignals, respond
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.control.paths import beyond_lane
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.scenario.scenario import Scenario

STRAIGHT = 0.01
"""rad; below it a command steers to no side."""
FULL_TURN = 2.0 * np.pi
"""rad."""
LEAD = 0.1
"""s; of the straight before the steering so much is driven."""
OUTLINE = 9
"""Points along each edge of a car on a path."""
PATH_MARGIN = 1.2
"""Time for a path, over that of its length at the first speed."""


@dataclass(frozen=True)
class EntryResult:
    """Results of n runs.

    Attributes:
        completed: upright (`verdict.stays_upright`) all the time; and straight again at the end, or
            on its path to the end, as `optimisation.judge.entry_speed` asks.
        lateral_acceleration: mean of the course to the side that is steered to, m/s2.
        progress: share of a path that lay behind the car at its first failure.
    """

    completed: BoolArray
    lateral_acceleration: FloatArray
    progress: FloatArray


@dataclass(frozen=True)
class PathMotion:
    """Numbers that n runs on a path know beforehand.

    Attributes:
        preview, correction, lag: of `PathDriver` (n).
        roll, pitch: of the tail at places spread evenly over the path (k, n), rad; without any the
            law moves it.
    """

    preview: FloatArray
    correction: FloatArray
    lag: FloatArray
    roll: FloatArray
    pitch: FloatArray


def simulate_entries(
    cars: VehicleParams,
    scenario: Scenario,
    gains: Any,
    steers_tail: FloatArray,
    motion: PathMotion | None = None,
) -> EntryResult:
    """Drives n cars that begin rolling at their speeds through the manoeuvre of a scenario, to the
    left.

    Args:
        cars: n of them.
        scenario: of manoeuvre, servo, controller and IMU; wheelbase of all.
        gains: fields of `FeedbackParameters` as arrays (n).
        steers_tail: 1 where the law rolls the tail, 0 where its roll is held in the middle (n).
        motion: on a path; without it the driver is that of the scenario.
    """
    plan = scenario.manoeuvre
    rollout = EntryRollout(cars, scenario, gains, steers_tail, motion)
    start = plan.turn_start - LEAD
    length = run_time(scenario) - start
    if plan.kind == "path":
        length = float(PATH_MARGIN * np.max(rollout.to_go / cars.speed))
    index = np.arange(round(length / STEP))
    last = round(LAST / STEP)
    ticked = tick_flags(index, scenario.controller.rate, STEP)
    time = start + index * STEP
    planned = np.zeros(len(index))
    driver = make_driver(scenario)
    if isinstance(driver, ScheduledDriver):
        planned[ticked] = [driver.schedule.at(one).steering_angle for one in time[ticked]]
    counts = 1.0 * (time >= plan.turn_start)
    share = (index >= len(index) - last) / last
    run(rollout, ticked, time, planned, counts, share)
    return rollout.result()


class EntryRollout(Rollout):
    """Cars that begin rolling.

    A step is given its time (s), the steering command (rad) that is planned where a tick begins it,
    1 where the course counts, and its share in the end of the run.

    Attributes:
        upright: whether no step failed so far (n).
        total, steered: sum of the lateral accelerations (n), m/s2, and number of the steps that
            count.
        ending: mean yaw rate of the end (n), rad/s; NaN for a car that is steered then.
        to_go, left: way to the end of the path (n), m: now, and when the car failed.
        whole: length of the path (n), m.

    Args: as of `simulate_entries`.
    """

    def __init__(
        self,
        cars: VehicleParams,
        scenario: Scenario,
        gains: Any,
        steers_tail: FloatArray,
        motion: PathMotion | None = None,
    ) -> None:
        controller = scenario.controller
        n = cars.count
        state = np.zeros((len(STATES), n))
        state[6] = gains.pitch_angle
        rates = state[RATES]
        rates[V][0] = cars.speed
        rates[SPIN] = cars.speed / cars.rolling_radius
        super().__init__(cars, state, delay_ticks(scenario), STEP)
        ones = np.ones(n)
        self._gains = gains
        self._steers_tail = steers_tail
        self._wheelbase = scenario.car.wheelbase * ones
        self._servo_rate = scenario.servo.rate * ones
        self._rate = controller.rate
        self._pitch = np.stack(
            [gains.pitch_angle, 0.0 * ones, controller.hold_kp * ones, controller.hold_kd * ones]
        )
        self._half_width = cars.wheel[1, 0] + cars.edge + cars.tyre_half_width
        self._set_driver(scenario, motion)
        self._steering, self._steering_command, self._reference, self._course = np.zeros((4, n))
        self.upright = np.ones(n, bool)
        self.total, self.steered, self.ending = np.zeros((3, n))

    def _set_driver(self, scenario: Scenario, motion: PathMotion | None) -> None:
        """Sets the driver with its memory, and the way of its path."""
        cars = self._cars
        n = cars.count
        driver: Any = make_driver(scenario)
        self._memory = np.repeat(driver.start()[:, None], n, axis=1)
        self._roll_motion, self._pitch_motion = np.zeros((2, 0, n))
        self.to_go = np.ones(n)
        if scenario.manoeuvre.kind == "path":
            fields = {"begin": cars.speed * LEAD, "vehicle_width": 2.0 * self._half_width}
            own = {name: fields[name] for name in fields if hasattr(driver.path, name)}
            chosen = {
                name: np.full(n, getattr(driver, name)) for name in ("preview", "correction", "lag")
            }
            if motion is not None:
                chosen = {name: getattr(motion, name) for name in chosen}
                self._roll_motion = motion.roll
                self._pitch_motion = motion.pitch
            driver = replace(driver, path=replace(driver.path, **own), **chosen)
            self.to_go = driver.path.end + 0.0 * cars.speed
        self._driver = None if isinstance(driver, ScheduledDriver) else driver
        self.whole = self.to_go
        self.left = self.to_go

    def tick(self, time: Any, planned: Any, *_: Any) -> None:
        """Asks the law of the tail and the driver once."""
        state = self.state
        gains = self._gains
        roll, roll_rate, yaw_rate = self._measure()
        speed = state[RATES][V][0]
        signals = FeedbackSignals(roll, roll_rate, yaw_rate, speed, self._steering_command, True)
        response = respond(gains, self._wheelbase, self._rate, self._reference, signals)
        self._reference = self._steers_tail * response.reference
        swung = np.stack([self._reference, 0.0 * self._reference, gains.kp, gains.kd])
        pitch = self._pitch
        if len(self._roll_motion):
            share = np.clip(1.0 - self.to_go / self.whole, 0.0, 1.0)
            pitch = np.stack([interpolate_knots(share, self._pitch_motion), *pitch[1:]])
            swung = np.stack([interpolate_knots(share, self._roll_motion), *swung[1:]])
        self._command(pitch, swung)
        if self._driver is None:
            self._steering_command = planned + 0.0 * self._steering_command
        else:
            x, y, _, yaw = state[:4]
            course, speed = over_ground(state, 0.0 * x)
            view: Any = (time, (x, y), yaw, course, speed, yaw_rate, roll_rate)
            self._memory, self._steering_command = self._driver.steer(
                self._memory, DriverView(*view)
            )

    def step(self, time: Any, planned: Any, counts: Any, share: Any) -> None:
        """Drives one step and judges it."""
        cars = self._cars
        self._steering = servo_step(self._steering, self._steering_command, self._servo_rate * STEP)
        self._drive(self._steering, cars.speed / cars.rolling_radius)
        state = self.state
        steers = np.abs(self._steering_command) > STRAIGHT
        self.upright = self.upright & (self._is_fine(steers) | (counts == 0.0))
        self.left = np.where(self.upright, self.to_go, self.left)
        self.ending = self.ending + np.where(steers & (share > 0.0), np.nan, state[14] * share)
        course, speed = over_ground(state, cars.com_x)
        turned = course - self._course
        turned = (turned - FULL_TURN * np.rint(turned / FULL_TURN)) / STEP
        to_side = np.where(self._steering_command > 0.0, turned, -turned) * speed
        self._course = np.where(counts > 0.0, course, 0.0)
        self.total = self.total + counts * np.where(steers, to_side, 0.0)
        self.steered = self.steered + counts * np.where(steers, 1.0, 0.0)

    def _is_fine(self, steers: Any) -> Any:
        """Returns who is upright, and in its lane, after a step; `steers` who is steered."""
        state = self.state
        cars = self._cars
        sail, board = heights(state, cars)
        lift = side_lift(wheel_lifts(state, cars, self._steering))
        touched = touches_ground(sail <= 0.0, board <= 0.0, steers)
        fine = stays_upright(lift, touched, self.gone)
        if isinstance(self._driver, PathDriver):
            path = self._driver.path
            wheelbase = self._driver.wheelbase
            x, y, _, yaw = state[:4]
            self.to_go = np.minimum(self.to_go, path.end - path.station(x, y))
            off_lane = beyond_lane(path, x, y, yaw, self._half_width, wheelbase, OUTLINE)
            fine = fine & keeps_path(off_lane)
        return fine

    def result(self) -> EntryResult:
        """Returns what came of the runs."""
        if isinstance(self._driver, PathDriver):
            ends = self.to_go <= 0.0
        else:
            ends = goes_straight(np.isnan(self.ending), self.ending)
        return EntryResult(
            self.upright & ends,
            self.total / np.maximum(self.steered, 1.0),
            1.0 - self.left / self.whole,
        )


def interpolate_knots(share: FloatArray, knots: FloatArray) -> FloatArray:
    """Returns values (n) at shares (n) of the way between knots (k, n) that are spread evenly over
    it.
    """
    position = share * (len(knots) - 1)
    hats = [np.maximum(1.0 - np.abs(position - k), 0.0) * value for k, value in enumerate(knots)]
    values: FloatArray = np.sum(np.stack(hats), axis=0)
    return values


def at_speeds(cars: VehicleParams, speeds: FloatArray) -> VehicleParams:
    """Returns the n cars at speeds (n), m/s, with the slip speed of their tyres there."""
    return replace(cars, speed=speeds, slip_speed=regularised_slip(cars.slip_angle_scale, speeds))
