"""Manoeuvres of many reduced cars that begin rolling, with the feedback law, steered open loop or
by their driver.

The law sees the IMU late, as on the full car, but without noise and bias, and the speed without
delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.compiled import run
from aerodima.workbench.car.reduced.dynamics import (
    RATES,
    SPIN,
    STATES,
    TINY,
    TRAVEL,
    V,
    W,
    advance,
    dot,
    up_in_body,
)
from aerodima.workbench.car.reduced.turns import heights, over_ground
from aerodima.workbench.car.reduced.vehicle_parameters import Vehicles
from aerodima.workbench.car.tail_impulses import FLIP_TILT
from aerodima.workbench.car.tip_up import LAST, TWO_WHEELS
from aerodima.workbench.car.turn_signals import EXIT_YAW_RATE
from aerodima.workbench.control.driver_law import PathDriver, ScheduledDriver, make_driver
from aerodima.workbench.control.driver_law import Seen as SeenByDriver
from aerodima.workbench.control.feedback_law import Seen, respond
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.control.paths import beyond_lane
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.scenario import Scenario

STEP = 0.002
"""s."""
STRAIGHT = 0.01
"""rad; below it a command steers to no side."""
TURN = 2.0 * np.pi
"""A full turn, rad."""
LEAD = 0.1
"""s; of the straight before the steering so much is driven."""
OUTLINE = 9
"""Points along each edge of a car on a path."""


@dataclass(frozen=True)
class Entries:
    """What came of n runs.

    Attributes:
        upright: no two wheels of a side in the air, no tail on the ground, no board while the car
            is steered, not flipped; and straight again at the end, or on its path to the end, as
            `optimisation.entry.entry_speed` asks.
        figure: mean lateral acceleration of the course to the side that is steered to, m/s2.
        driven: share of a path that lay behind the car at its first failure.
    """

    upright: np.ndarray
    figure: FloatArray
    driven: FloatArray


@dataclass(frozen=True)
class PathMotion:
    """What n runs on a path know beforehand.

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


def enter(
    cars: Vehicles,
    scenario: Scenario,
    gains: Any,
    steers_tail: FloatArray,
    motion: PathMotion | None = None,
) -> Entries:
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
    rate = scenario.controller.rate
    entering = Entering(cars, scenario, gains, steers_tail, motion)
    start = plan.turn_start - LEAD
    follows = plan.kind == "path"
    if follows:
        length = float(1.2 * np.max(entering.to_go / cars.speed))
    else:
        length = run_time(scenario) - start
    steps = round(length / STEP)
    last = round(LAST / STEP)
    ticks = round(1.0 / (STEP * rate))
    index = np.arange(steps)
    ticked = index % ticks == 0
    time = start + index * STEP
    planned = np.zeros(steps)
    driver = make_driver(scenario)
    if isinstance(driver, ScheduledDriver):
        planned[ticked] = [driver.schedule.at(one).steering_angle for one in time[ticked]]
    counts = 1.0 * (time >= plan.turn_start)
    share = (index >= steps - last) / last
    run(entering, ticked, time, planned, counts, share)
    if follows:
        ends = entering.to_go <= 0.0
    else:
        ending = entering.ending
        steered_to_the_end = np.isnan(ending)
        ends = steered_to_the_end | (np.abs(ending) <= EXIT_YAW_RATE)
    figure = entering.total / np.maximum(entering.steered, 1.0)
    driven = 1.0 - entering.left / entering.whole
    return Entries(entering.upright & ends, figure, driven)


class Entering:
    """Cars on the way, a batch of `compiled.run`.

    A step is given its time (s), the steering command (rad) that is planned where a tick begins it,
    1 where the course counts, and its share in the end of the run.

    Attributes:
        state: (24, n).
        upright, total, steered, ending, to_go, left, whole: what `Entries` is made of (n).

    Args: as of `enter`.
    """

    def __init__(
        self,
        cars: Vehicles,
        scenario: Scenario,
        gains: Any,
        steers_tail: FloatArray,
        motion: PathMotion | None = None,
    ) -> None:
        plan = scenario.manoeuvre
        controller = scenario.controller
        n = cars.count
        self._cars = cars
        self._gains = gains
        self._steers_tail = steers_tail
        ones = np.ones(n)
        self._wheelbase = scenario.car.wheelbase * ones
        self._servo_rate = scenario.servo.rate * ones
        kp = controller.hold_kp * ones
        kd = controller.hold_kd * ones
        self._rate = controller.rate
        self._half_width = cars.wheel[1, 0] + cars.edge + cars.tyre_half_width
        driver: Any = make_driver(scenario)
        self.to_go = np.ones(n)
        self._roll = np.zeros((0, n))
        self._pitch_played = np.zeros((0, n))
        self._driver = None if isinstance(driver, ScheduledDriver) else driver
        self._memory = np.repeat(driver.start()[:, None], n, axis=1)
        if plan.kind == "path":
            fields = {"begin": cars.speed * LEAD, "vehicle_width": 2.0 * self._half_width}
            own = {name: fields[name] for name in fields if hasattr(driver.path, name)}
            chosen = {
                name: np.full(n, getattr(driver, name)) for name in ("preview", "correction", "lag")
            }
            if motion is not None:
                chosen = {name: getattr(motion, name) for name in chosen}
                self._roll = motion.roll
                self._pitch_played = motion.pitch
            self._driver = replace(driver, path=replace(driver.path, **own), **chosen)
            self.to_go = self._driver.path.end + 0.0 * cars.speed
        self.whole = self.to_go
        self.left = self.to_go
        self._pitch = np.stack([gains.pitch_angle, np.zeros(n), kp, kd])
        self.state = np.zeros((len(STATES), n))
        self._tail = np.zeros((2, 4, n))
        rates = self.state[RATES]
        rates[V][0] = cars.speed
        rates[SPIN] = cars.speed / cars.rolling_radius
        self.state[6] = gains.pitch_angle
        late = round(np.ceil(scenario.imu.delay * controller.rate - 1e-9))
        self._seen = np.zeros((1 + late, 3, n))
        self._steering, self._command, self._reference, self._course = np.zeros((4, n))
        self._gone = np.zeros(n, bool)
        self.upright = np.ones(n, bool)
        (self.total, self.steered, self.ending) = np.zeros((3, n))

    def tick(self, time: Any, planned: Any, *_: Any) -> None:
        """Asks the law and the driver."""
        state = self.state
        rates = state[RATES]
        measured = np.stack([state[5], *rates[W][::2]])
        self._seen = np.concatenate([self._seen[1:], measured[None]])
        roll, roll_rate, yaw_rate = self._seen[0]
        seen = Seen(roll, roll_rate, yaw_rate, rates[V][0], self._command, True)
        found = respond(self._gains, self._wheelbase, self._rate, self._reference, seen)
        self._reference = self._steers_tail * found.reference
        swung = np.stack([self._reference, 0.0 * self._reference, self._gains.kp, self._gains.kd])
        pitch = self._pitch
        if len(self._roll):
            share = np.clip(1.0 - self.to_go / self.whole, 0.0, 1.0)
            pitch = np.stack([between(share, self._pitch_played), *pitch[1:]])
            swung = np.stack([between(share, self._roll), *swung[1:]])
        self._tail = np.stack([pitch, swung]) * self._cars.has_tail
        if self._driver is None:
            self._command = planned + 0.0 * self._command
        else:
            x, y, _, yaw = state[:4]
            looks: Any = (time, (x, y), yaw, *over_ground(state, 0.0 * x), yaw_rate, roll_rate)
            self._memory, self._command = self._driver.steer(self._memory, SeenByDriver(*looks))

    def step(self, time: Any, planned: Any, counts: Any, share: Any) -> None:
        """Drives one step and judges it."""
        cars = self._cars
        most = self._servo_rate * STEP
        missing = self._command - self._steering
        steering = self._steering + np.clip(missing, -most, most)
        self._steering = steering
        both = np.stack([steering, steering])
        shaft_speed = cars.speed / cars.rolling_radius
        new, _ = advance(STEP, cars, self.state, both, shaft_speed, self._tail)
        state = np.where(self._gone, self.state, new)
        self.state = state
        front_left, front_right, rear_left, rear_right = wheel_lifts(state, cars, steering)
        (sail, board) = heights(state, cars)
        left = np.minimum(front_left, rear_left)
        right = np.minimum(front_right, rear_right)
        side = np.maximum(left, right)
        self._gone = self._gone | (up_in_body(state)[2] < np.cos(FLIP_TILT))
        steers = np.abs(self._command) > STRAIGHT
        fine = (side <= TWO_WHEELS) & (sail > 0.0) & ((board > 0.0) | ~steers) & ~self._gone
        if isinstance(self._driver, PathDriver):
            path = self._driver.path
            x, y, _, yaw = state[:4]
            self.to_go = np.minimum(self.to_go, path.end - path.station(x, y))
            wheelbase = self._driver.wheelbase
            off_lane = beyond_lane(path, x, y, yaw, self._half_width, wheelbase, OUTLINE)
            fine = fine & (off_lane <= 0.0)
        self.upright = self.upright & (fine | (counts == 0.0))
        self.left = np.where(self.upright, self.to_go, self.left)
        self.ending = self.ending + np.where(steers & (share > 0.0), np.nan, state[14] * share)
        now, speed = over_ground(state, cars.com_x)
        turned = now - self._course
        turned = (turned - TURN * np.rint(turned / TURN)) / STEP
        to_side = np.where(self._command > 0.0, turned, -turned) * speed
        self._course = np.where(counts > 0.0, now, 0.0)
        self.total = self.total + counts * np.where(steers, to_side, 0.0)
        self.steered = self.steered + counts * np.where(steers, 1.0, 0.0)


def between(share: FloatArray, places: FloatArray) -> FloatArray:
    """Values (n) at shares (n) of the way between places (k, n) that are spread evenly over it."""
    at = share * (len(places) - 1)
    hats = [np.maximum(1.0 - np.abs(at - k), 0.0) * value for k, value in enumerate(places)]
    found: FloatArray = np.sum(np.stack(hats), axis=0)
    return found


def wheel_lifts(state: FloatArray, cars: Vehicles, steering: FloatArray) -> FloatArray:
    """Height of the lowest point of each tyre over the ground (4, n), m; negative where it presses
    into it.

    Args:
        state: (24, n).
        cars: n of them.
        steering: angle of the front wheels (n), rad.
    """
    n = up_in_body(state)[:, None]
    steer = np.concatenate([np.stack([steering, steering]), np.zeros((2, cars.count))])
    axle = np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer])
    tilt = dot(axle, n)
    R2 = cars.tyre_radius**2
    h2 = cars.tyre_half_width**2
    reach = np.sqrt(R2 * (1.0 - tilt * tilt + TINY) + h2 * tilt * tilt)
    x, y, z = cars.wheel
    centre = np.stack([x, y, z + state[TRAVEL]])
    found: FloatArray = state[2] + dot(n, centre) - cars.edge * np.abs(tilt) - reach
    return found


def at_speeds(cars: Vehicles, speeds: FloatArray) -> Vehicles:
    """The n cars at speeds (n), m/s: the slip speed of a tyre is that of its slip angle."""
    return replace(cars, speed=speeds, slip_speed=cars.slip_speed * speeds / cars.speed)
