"""Laws of the driver, with their inputs and outputs: schedules of time, and drivers that look at
the car.

No Drake.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from aerodima.workbench.control.manoeuvre import (
    TICK_TOLERANCE,
    DriverInput,
    Schedule,
    SpeedRamp,
    make_schedule,
    side_of,
    speed_ramp,
)
from aerodima.workbench.control.paths import Path, path_of
from aerodima.workbench.control.rollover_control import RolloverMemory, limit_by_roll, max_angle
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.law_parameters import RolloverControlParameters

Source = Literal["imu", "pose"]
"""Signals that a driver may look at: the station's IMU, and pose and speed of a simulated car."""
SLOW = 0.5
"""Speed (m/s) below which yaw rate over speed is noise of the gyro."""


class DriverView(NamedTuple):
    """Signals that a driver sees at one tick; NaN where they are not known, as all are before the
    first tick.

    Attributes:
        time: time of the tick, s.
        position: point on the ground under the rear axle in W, m.
        heading: heading, rad, positive to the left.
        course: direction in which that point moves, rad, positive to the left; the heading of a car
            that stands.
        speed: speed over ground, m/s.
        yaw_rate: yaw rate, rad/s, positive to the left.
        roll, roll_rate: roll and roll rate of the car, rad and rad/s, positive to the right.
    """

    time: float
    position: Pair = (math.nan, math.nan)
    heading: float = math.nan
    course: float = math.nan
    speed: float = math.nan
    yaw_rate: float = math.nan
    roll: float = math.nan
    roll_rate: float = math.nan


class DriverLaw(Protocol):
    """A law for steering, throttle and announced turn."""

    @property
    def sources(self) -> tuple[Source, ...]:
        """Returns the sources that the law looks at beside the time; all other signals are NaN.

        Each source costs time at every tick.
        """

    def start(self) -> FloatArray:
        """Returns the memory (n,) before the first tick."""

    def step(self, memory: FloatArray, view: DriverView) -> tuple[FloatArray, DriverInput]:
        """Returns new memory and the driver's commands at one tick; must not change its
        arguments.
        """


@dataclass(frozen=True)
class ScheduledDriver:
    """Plays a schedule, a function of time; looks at nothing."""

    schedule: Schedule
    sources: tuple[Source, ...] = ()

    def start(self) -> FloatArray:
        """See `DriverLaw`; a schedule has no memory."""
        return np.zeros(0)

    def step(self, memory: FloatArray, view: DriverView) -> tuple[FloatArray, DriverInput]:
        """See `DriverLaw`."""
        return memory, self.schedule.at(view.time)


@dataclass(frozen=True)
class FishhookDriver:
    """Fishhook with roll-rate feedback of NHTSA (49 CFR 575, Federal Register 68, 14 October 2003,
    p. 59250).

    The driver steers to one side, waits until the car has rolled outwards and no longer does,
    steers to the other side, holds that, and goes straight. While the roll rate is not known the
    driver waits. A full-size car rolls before the handwheel has arrived; the wheels of a small one
    arrive before it rolls.

    Args:
        ramp: speed ramp that reaches the speed before `start_time`.
        side: side of the first steering, +1 left, -1 right.
        steer_angle: steering angle to either side, rad.
        start_time: time of the first steering, s.
        hold: time for which the wheels stay at the second angle, s.
        roll_rate: roll rate outwards below which the counter-steer begins, rad/s.
        servo_rate: rate of the wheels, rad/s; the driver waits for them.
    """

    ramp: SpeedRamp
    side: float
    steer_angle: float
    start_time: float
    hold: float
    roll_rate: float
    servo_rate: float
    sources: tuple[Source, ...] = ("imu",)

    def start(self) -> FloatArray:
        """See `DriverLaw`: the memory is the time of the counter-steer, inf before, and 1 once the
        car has rolled outwards.
        """
        return np.array([math.inf, 0.0])

    def step(self, memory: FloatArray, view: DriverView) -> tuple[FloatArray, DriverInput]:
        """See `DriverLaw`."""
        now = view.time + TICK_TOLERANCE
        reach = self.steer_angle / self.servo_rate
        counter, rolled = memory.tolist()
        outwards = self.side * view.roll_rate
        if now >= self.start_time and outwards >= self.roll_rate:
            rolled = 1.0
        if now >= self.start_time + reach and rolled and outwards < self.roll_rate:
            counter = min(counter, view.time)
        angle = 0.0
        if now < counter + 2.0 * reach + self.hold and now >= self.start_time:
            angle = self.steer_angle if view.time < counter else -self.steer_angle
        side = self.side if math.isinf(counter) else -self.side
        given = DriverInput(self.side * angle, self.ramp.throttle(view.time), side)
        return np.array([counter, rolled]), given


@dataclass(frozen=True)
class PathDriver:
    """Follows a path by pure pursuit (Coulter, CMU-RI-TR-92-01) with preview, reaction delay and
    slow hands.

    The driver knows its delay: it takes the place and course that the car will have when the
    steering acts, at the present speed and yaw rate, and wants the circle from there to the point
    of the centre line that is `preview` ahead. It steers the kinematic bicycle onto that circle,
    and more by `correction` of the curvature that is missing, since tyres that slip go along a
    wider circle; past the grip of the front tyres more steering does not help. Without a pose the
    wheels stay straight.

    Args:
        path: path to follow.
        ramp: ramp of the speed.
        wheelbase: wheelbase of the car, m.
        limit: largest steering angle, rad.
        preview: time by which the driver looks ahead, s.
        correction: share of the missing curvature by which the driver steers more.
        lag: time constant with which the missing curvature is noticed, s. Without it the steering
            of a car on rigid tyres swings from side to side.
        delay: reaction delay, s, rounded to ticks.
        steering_rate: rate of the hands, as an angle of the wheels, rad/s.
        rate: rate of the ticks, Hz.
    """

    path: Path
    ramp: SpeedRamp
    wheelbase: float
    limit: float
    preview: float
    correction: float
    lag: float
    delay: float
    steering_rate: float
    rate: float
    sources: tuple[Source, ...] = ("imu", "pose")

    def start(self) -> FloatArray:
        """See `DriverLaw`: the memory is the missing curvature, 1/m, the angle given last, and the
        angles to come in their order, rad.
        """
        return np.zeros(2 + round(self.delay * self.rate))

    def step(self, memory: FloatArray, view: DriverView) -> tuple[FloatArray, DriverInput]:
        """See `DriverLaw`."""
        missing = memory[0]
        wanted = 0.0
        station = -math.inf
        if math.isfinite(view.position[0]):
            missing, wanted = self._aim(missing, view)
            station = float(self.path.station(*view.position))
        now, *later = [*memory[2:], wanted]
        max_change = self.steering_rate / self.rate
        angle = np.clip(now, memory[1] - max_change, memory[1] + max_change)
        throttle = self.ramp.throttle(view.time)
        given = DriverInput(float(angle), throttle, self.path.next_side(station))
        return np.array([missing, angle, *later]), given

    def _aim(self, missing: float, view: DriverView) -> Pair:
        """Returns the missing curvature, 1/m, and the wanted angle, rad, of a car with a pose."""
        bent = 0.0
        if view.speed > SLOW and not math.isnan(view.yaw_rate):
            bent = view.yaw_rate / view.speed
        curvature = self.wanted_curvature(view, bent)
        missing = missing + (curvature - bent - missing) / (1.0 + self.lag * self.rate)
        wanted = np.arctan(self.wheelbase * (curvature + self.correction * missing))
        return missing, np.clip(wanted, -self.limit, self.limit)

    def wanted_curvature(self, view: DriverView, bent: float) -> float:
        """Returns the curvature (1/m) of the circle to the preview point, for a car with a pose
        that drives along a curvature `bent`, 1/m.
        """
        speed = view.speed
        way = speed * self.delay
        course = view.course + 0.5 * bent * way
        x = view.position[0] + way * np.cos(course)
        y = view.position[1] + way * np.sin(course)
        course = view.course + bent * way
        x_ahead, y_ahead = self.path.centre(self.path.station(x, y) + speed * self.preview)
        dx = x_ahead - x
        dy = y_ahead - y
        return (
            2.0 * (np.cos(course) * dy - np.sin(course) * dx) / np.maximum(dx * dx + dy * dy, 1e-12)
        )


@dataclass(frozen=True)
class LimitedDriver:
    """A driver whose steering the rollover control of the car limits (`rollover_control`).

    While the roll is not known the wheels keep their share.

    Args:
        driver: driver whose steering is limited.
        control: parameters of the control.
        max_angle: angle to which the control limits the steering by speed, rad.
        rate: rate of the ticks, Hz.
    """

    driver: DriverLaw
    control: RolloverControlParameters
    max_angle: float
    rate: float

    @property
    def sources(self) -> tuple[Source, ...]:
        """See `DriverLaw`: those of the driver, and the IMU."""
        return tuple(dict.fromkeys((*self.driver.sources, "imu")))

    def start(self) -> FloatArray:
        """See `DriverLaw`: the memory is a `RolloverMemory`, its zero NaN until a roll is known,
        then the memory of the driver.
        """
        return np.array([1.0, math.nan, *self.driver.start()])

    def step(self, memory: FloatArray, view: DriverView) -> tuple[FloatArray, DriverInput]:
        """See `DriverLaw`."""
        drivers, given = self.driver.step(memory[2:], view)
        known = RolloverMemory(*memory[:2].tolist())
        if math.isnan(known.zero):
            known = known._replace(zero=view.roll)
        asked = float(np.clip(given.steering_angle, -self.max_angle, self.max_angle))
        if math.isfinite(view.roll) and math.isfinite(view.roll_rate):
            known = limit_by_roll(self.control, self.rate, known, asked, view.roll, view.roll_rate)
        limited = given._replace(steering_angle=float(known.share) * asked)
        return np.array([*known, *drivers]), limited


def make_driver(scenario: Any) -> DriverLaw:
    """Returns the driver of a scenario, with the rollover control if that is on.

    Raises:
        UserError: speed out of reach, times that do not fit together.
    """
    return limited_driver(driver_of_manoeuvre(scenario), scenario)


def limited_driver(driver: DriverLaw, scenario: Any) -> DriverLaw:
    """Returns a driver with the rollover control of a scenario, or as it is if that is off."""
    control = scenario.rollover_control
    if control.gain == 0.0:
        return driver
    speed = scenario.manoeuvre.speed
    angle = float(max_angle(scenario.car.wheelbase, control.acceleration, speed))
    return LimitedDriver(driver, control, angle, scenario.controller.rate)


def driver_of_manoeuvre(scenario: Any) -> DriverLaw:
    """Returns the driver of `scenario.manoeuvre`: a schedule where the manoeuvre is a function of
    time, else a law of its own.

    Raises:
        UserError: speed out of reach, times that do not fit together.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind == "fishhook":
        times = (
            manoeuvre.turn_start,
            manoeuvre.turn_hold,
            manoeuvre.counter_roll_rate,
            scenario.servo.rate,
        )
        return FishhookDriver(
            speed_ramp(scenario), side_of(manoeuvre), manoeuvre.steer_angle, *times
        )
    if manoeuvre.kind == "path":
        eyes = (manoeuvre.driver_preview, manoeuvre.driver_correction, manoeuvre.driver_lag)
        hands = (manoeuvre.driver_delay, manoeuvre.driver_rate, scenario.controller.rate)
        wheelbase = scenario.car.wheelbase
        return PathDriver(
            path_of(scenario), speed_ramp(scenario), wheelbase, manoeuvre.steer_angle, *eyes, *hands
        )
    return ScheduledDriver(make_schedule(scenario))


def refuse_simulated_only(scenario: Any, user_driver: bool = False) -> None:
    """Raises UserError for a manoeuvre that a real car cannot begin, or whose driver looks at
    signals that a real car does not have.

    With `user_driver` the driver is not that of the manoeuvre.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.rolling_start:
        raise UserError(
            "manoeuvre.rolling_start: true; allowed on a car: false, since it begins at rest"
        )
    if not user_driver and "pose" in make_driver(scenario).sources:
        raise UserError(
            f"manoeuvre.kind: {manoeuvre.kind}, whose driver looks at the place of the car; "
            "allowed on a car: "
            "turn, auto_turn, straight, slalom, rising, fishhook, or a diagram with a driver"
        )
