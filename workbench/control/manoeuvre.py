"""Manoeuvres of the driver: steering, throttle and announced turn as functions of time.

Design section 10. No Drake here; `TurnDriver` plays a schedule into a station, and so does the
no-Drake mode on the car. Steering angles in rad, positive to the left; throttle -1 to 1; planned
turn +1 left, -1 right, 0 none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol, runtime_checkable

from aerodima.workbench.core.elementwise import clip, maximum, minimum, where
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.ranges import check_range

TICK_TOLERANCE = 1e-9
"""Time within which a tick counts as having reached an instant of the schedule, s."""
WITHDRAWN = (0.3, 0.4)
"""Interval in which the announcement of a steering step is withdrawn, s after the end of the step;
a law that swings late has swung by then."""
CLOSED_LOOP = ("fishhook", "path")
"""Kinds of manoeuvre in which the driver looks at the car: no function of time."""


class DriverInput(NamedTuple):
    """Commands of the driver at one instant."""

    steering_angle: float
    throttle: float
    planned_turn: float


@runtime_checkable
class Schedule(Protocol):
    """A manoeuvre: driver inputs as a function of time."""

    def at(self, time: float) -> DriverInput:
        """Returns inputs at `time` s since the start."""


@dataclass(frozen=True)
class ThrottleLine:
    """Steady speed of the drive as a line of throttle, and its inverse with feed-forward.

    Args:
        gain: speed per unit of throttle, m/s.
        offset: speed of the line at throttle 0, m/s.
        time_constant: time constant of the speed's response to the throttle, s; 0 where a governor
            holds the commanded speed.
        breakaway: throttle below which the car stands; 0 where a governor holds the commanded
            speed.
    """

    gain: float
    offset: float
    time_constant: float = 0.0
    breakaway: float = 0.0

    def throttle(self, speed: float, acceleration: float = 0.0) -> float:
        """Returns the throttle for a speed (m/s) that changes by `acceleration` (m/s2), clipped to
        -1..1; the line is mirrored for reverse.
        """
        asked = speed + self.time_constant * acceleration
        size = (abs(asked) - self.offset) / self.gain
        return math.copysign(min(1.0, max(0.0, size)), asked)

    def check_speed(self, speed: float) -> None:
        """Raises UserError if the car cannot hold this speed (m/s, from 0 on)."""
        top = self.gain + self.offset
        if speed > top + 1e-12:
            raise UserError(
                f"manoeuvre.speed: {speed:g} m/s; allowed: 0 to {top:g} m/s, the steady speed at "
                "full throttle"
            )
        slowest = self.gain * self.breakaway + self.offset
        if 0.0 < speed < slowest - 1e-12 or (speed > 0.0 and self.throttle(speed) == 0.0):
            raise UserError(
                f"manoeuvre.speed: {speed:g} m/s; allowed: 0, or above {slowest:g} m/s, the steady "
                f"speed of the line at a throttle of {self.breakaway:g}"
            )


@dataclass(frozen=True)
class SpeedRamp:
    """Constant acceleration from standstill to `speed` (m/s) within `duration` (s; 0 is a throttle
    step), then steady.

    A drive without governor gets the throttle of speed plus time constant times acceleration, so
    that the car follows the ramp instead of lagging behind it; from the end of the ramp its
    throttle is frozen.
    """

    speed: float
    duration: float
    line: ThrottleLine

    def __post_init__(self) -> None:
        self.line.check_speed(self.speed)

    def throttle(self, time: float) -> float:
        """Returns the throttle at `time` s since the start."""
        if self.duration <= 0.0:
            return self.line.throttle(self.speed)
        return self.line.throttle(
            ramp_speed(self.speed, self.duration, self.line.time_constant, time)
        )


def ramp_speed(speed: Any, duration: Any, time_constant: Any, time: Any) -> Any:
    """Returns the steady speed (m/s) that a drive is asked for on a ramp, numbers or arrays.

    Args:
        speed: speed at the end of the ramp, m/s.
        duration: duration of the ramp, above 0 s.
        time_constant: time by which the request runs ahead of the ramp, s.
        time: time since the start, s.
    """
    acceleration = speed / duration
    gathered = acceleration * time + time_constant * acceleration
    return where(time + TICK_TOLERANCE < duration, gathered, speed)


def pulse_angle(pulse: Any, since: Any) -> Any:
    """Returns the steering angle (rad) that a turn commands, to its side.

    Args:
        pulse: any object with the fields `steer_angle`, `hold`, `first_angle` and `first_hold` of
            `TurnSchedule`, numbers or arrays of cars.
        since: time since the step of the steering began, s.
    """
    levels = (pulse.first_angle, pulse.steer_angle)
    return level_angle(levels, (pulse.first_hold, pulse.hold), since)


def level_angle(levels: Sequence[Any], ends: Sequence[Any], since: Any) -> Any:
    """Returns the steering angle (rad) that levels command one after the other, then straight.

    Args:
        levels: steering angles, rad, numbers or arrays of cars.
        ends: ends of the levels, s since the start of the first one, in order.
        since: time since that start, s.
    """
    angle: Any = 0.0
    for level, end in zip(reversed(levels), reversed(ends), strict=True):
        angle = where(since < end, level, angle)
    return where(since >= 0.0, angle, 0.0)


def slewed_angle(levels: Sequence[Any], ends: Sequence[Any], rate: Any, since: Any) -> Any:
    """Returns the angle (rad) to which a servo of `rate` (rad/s) has turned the wheels from 0 by
    that time, also on the way back after the last level; other arguments as for `level_angle`.
    """
    angle: Any = 0.0 * since
    begun: Any = 0.0
    for level, end in zip((*levels, 0.0), (*ends, since), strict=True):
        moved = rate * maximum(0.0, minimum(since, end) - begun)
        angle = angle + clip(level - angle, -moved, moved)
        begun = end
    return angle


def wheel_angle(pulse: Any, rate: Any, since: Any) -> Any:
    """Returns the angle (rad) to which a servo of `rate` (rad/s) has turned the wheels by that
    time; other arguments as for `pulse_angle`.
    """
    levels = (pulse.first_angle, pulse.steer_angle)
    return slewed_angle(levels, (pulse.first_hold, pulse.hold), rate, since)


def turn_length(
    rate: Any,
    steer_angle: Any,
    hold: Any,
    first_angle: Any = 0.0,
    first_hold: Any = 0.0,
    repeats: int = 1,
    gap: float = 0.0,
) -> Any:
    """Returns the time from the first step of the steering until the wheels are straight again, s.

    The servo brings them back from the last level, or from what it has not yet taken back of a
    larger first one.

    Args:
        rate: rate of the servo, rad/s.
        steer_angle, hold, first_angle, first_hold: as for `TurnSchedule`, numbers or arrays.
        repeats, gap: as for `TurnSchedule`.
    """
    left = maximum(steer_angle, first_angle - rate * (hold - first_hold))
    return repeats * hold + (repeats - 1) * gap + where(first_hold > 0.0, left, steer_angle) / rate


def turn_start(scenario: Any) -> float:
    """Returns the time (s) of the first steering command of a turn."""
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind == "auto_turn":
        return float(manoeuvre.straight_time)
    return float(manoeuvre.turn_start)


@dataclass(frozen=True)
class TurnSchedule:
    """Straight, then a steering step of `steer_angle` for `hold`, then straight again; the step may
    have two levels.

    The step may come several times to the same side, straight in between. The announcement is then
    withdrawn for a moment after each step but the last, so that a law which waits for a new
    announcement learns of the next turn.

    It is the simulated turn of the thesis (7.1.1: 30 degrees from 2.0 to 2.5 s; the servo adds its
    0.14 s), and with `throttle_off` the AUTO sequence of the car (7.2.1). The turn is announced
    from the first tick to the end.

    Args:
        ramp: speed ramp that reaches the speed before the turn.
        side: side of the turn, +1 left, -1 right.
        steer_angle: steering angle, rad, at least 0.
        start: start of the steering step, s.
        hold: length of the steering step, s.
        throttle_off: time from which the throttle is 0, s; never by default.
        first_angle: another angle at the beginning of the step, rad, at least 0.
        first_hold: length of that beginning, s.
        repeats: number of steps, at least 1.
        gap: time from the end of one step to the start of the next, driven straight, s.

    Raises:
        UserError: the ramp ends after the start.
    """

    ramp: SpeedRamp
    side: float
    steer_angle: float
    start: float
    hold: float
    throttle_off: float = math.inf
    first_angle: float = 0.0
    first_hold: float = 0.0
    repeats: int = 1
    gap: float = 0.0

    def __post_init__(self) -> None:
        check_range("manoeuvre.speed_ramp", self.ramp.duration, 0.0, self.start, "s")

    def at(self, time: float) -> DriverInput:
        """Returns inputs at `time` s since the start."""
        tick = time + TICK_TOLERANCE
        starts = [self.start + step * (self.hold + self.gap) for step in range(self.repeats)]
        start = max((begin for begin in starts if begin <= tick), default=self.start)
        steering_angle = pulse_angle(self, tick - start)
        if steering_angle:
            steering_angle *= self.side
        throttle = 0.0
        if tick < self.throttle_off:
            throttle = self.ramp.throttle(time)
        since = tick - (start + self.hold)
        announced = self.side
        if start < starts[-1] and WITHDRAWN[0] <= since < WITHDRAWN[1]:
            announced = 0.0
        return DriverInput(steering_angle, throttle, announced)


@dataclass(frozen=True)
class LevelSchedule:
    """Straight, then angles that are held one after the other, then straight again.

    Args:
        ramp: ramp of the speed.
        side: side of the turn, +1 left, -1 right, announced from the first tick; 0 for no turn.
        start: start of the first level, s.
        levels: steering angles to that side, rad; none for straight driving.
        ends: ends of the levels, s after the start.
        trim: steering angle to that side before the start, rad.

    Raises:
        UserError: a level that ends before the one before it.
    """

    ramp: SpeedRamp
    side: float
    start: float
    levels: tuple[float, ...]
    ends: tuple[float, ...]
    trim: float = 0.0

    def __post_init__(self) -> None:
        for number, (end, later) in enumerate(pairwise(self.ends), 1):
            check_range(f"manoeuvre.level_{number}_end", end, 0.0, later, "s")

    def at(self, time: float) -> DriverInput:
        """Returns inputs at `time` s since the start."""
        since = time + TICK_TOLERANCE - self.start
        angle = self.trim if since < 0.0 else level_angle(self.levels, self.ends, since)
        return DriverInput(self.side * angle, self.ramp.throttle(time), self.side)


@dataclass(frozen=True)
class RisingSchedule:
    """Steering that grows by `rate` from `start` on up to `steer_angle`, and stays there.

    This is slowly increasing steer, as NHTSA drives it before a fishhook and SAE J266 for the
    understeer gradient.

    Args:
        ramp: ramp of the speed.
        side: side of the turn, +1 left, -1 right, announced from the first tick.
        steer_angle: largest steering angle, rad.
        start: start of the steering, s.
        rate: rate of the steering, rad/s.
    """

    ramp: SpeedRamp
    side: float
    steer_angle: float
    start: float
    rate: float

    def at(self, time: float) -> DriverInput:
        """Returns inputs at `time` s since the start."""
        angle = min(self.steer_angle, self.rate * max(0.0, time - self.start))
        return DriverInput(self.side * angle, self.ramp.throttle(time), self.side)


@dataclass(frozen=True)
class SlalomSchedule:
    """Sinusoidal steering from `start` on (thesis 6.1.3); each half wave is announced as a turn
    when it begins.

    Args:
        ramp: ramp of the speed; it may go on while the car steers, as in the thesis.
        side: side of the first half wave, +1 left, -1 right, announced from the first tick.
        steer_angle: amplitude of the steering, rad.
        start: start of the steering, s.
        period: period of the full wave, s.
    """

    ramp: SpeedRamp
    side: float
    steer_angle: float
    start: float
    period: float

    def at(self, time: float) -> DriverInput:
        """Returns inputs at `time` s since the start."""
        phase = max(0.0, (time - self.start) / self.period)
        half_waves_done = math.floor(2.0 * (phase + TICK_TOLERANCE / self.period))
        steering_angle = self.side * self.steer_angle * math.sin(2.0 * math.pi * phase)
        return DriverInput(
            steering_angle,
            self.ramp.throttle(time),
            self.side if half_waves_done % 2 == 0 else -self.side,
        )


def make_schedule(scenario: Any) -> Schedule:
    """Returns the schedule of `scenario.manoeuvre` with the throttle line of `scenario.drive` (any
    object with these attributes).

    Raises:
        UserError: speed out of reach, times that do not fit together, a manoeuvre that is no
            function of time.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind in CLOSED_LOOP:
        raise UserError(
            f"manoeuvre.kind: {manoeuvre.kind}, whose driver looks at the car; allowed as a "
            "function of time: turn, auto_turn, levels, straight, slalom, rising"
        )
    side = side_of(manoeuvre)
    ramp = speed_ramp(scenario)
    angle = manoeuvre.steer_angle
    if manoeuvre.kind == "turn":
        return TurnSchedule(
            ramp,
            side,
            angle,
            manoeuvre.turn_start,
            manoeuvre.turn_hold,
            first_angle=manoeuvre.first_angle,
            first_hold=manoeuvre.first_hold,
            repeats=manoeuvre.turns,
            gap=manoeuvre.turn_gap,
        )
    if manoeuvre.kind == "auto_turn":
        start = turn_start(scenario)
        throttle_off = start + manoeuvre.turn_hold + manoeuvre.wait_after_turn
        check_range("manoeuvre.log_end", manoeuvre.log_end, throttle_off, math.inf, "s")
        # The car's sequence sets its throttle and waits (thesis 7.2.1).
        if not scenario.drive.governor:
            ramp = SpeedRamp(manoeuvre.speed, 0.0, ramp.line)
        return TurnSchedule(ramp, side, angle, start, manoeuvre.turn_hold, throttle_off)
    if manoeuvre.kind == "levels":
        levels = (manoeuvre.level_1, manoeuvre.level_2, manoeuvre.level_3)
        ends = (manoeuvre.level_1_end, manoeuvre.level_2_end, manoeuvre.turn_hold)
        trim = manoeuvre.trim_angle
        return LevelSchedule(ramp, side, manoeuvre.turn_start, levels, ends, trim)
    if manoeuvre.kind == "straight":  # for the throttle tests (thesis 6.2)
        return LevelSchedule(ramp, 0.0, 0.0, (), ())
    if manoeuvre.kind == "rising":
        return RisingSchedule(ramp, side, angle, manoeuvre.turn_start, manoeuvre.steer_rate)
    return SlalomSchedule(ramp, side, angle, manoeuvre.turn_start, manoeuvre.slalom_period)


def side_of(manoeuvre: Any) -> float:
    """Returns the side of the (first) turn of a manoeuvre: +1 left, -1 right."""
    return 1.0 if manoeuvre.direction == "left" else -1.0


def speed_ramp(scenario: Any) -> SpeedRamp:
    """Returns the ramp to the speed of `scenario`; a rolling start has the throttle of that speed
    from time 0.

    Raises:
        UserError: speed out of reach.
    """
    manoeuvre = scenario.manoeuvre
    duration = 0.0 if manoeuvre.rolling_start else manoeuvre.speed_ramp
    return SpeedRamp(manoeuvre.speed, duration, throttle_line(scenario))


def throttle_line(scenario: Any) -> ThrottleLine:
    """Returns the throttle line of `scenario.drive`."""
    drive = scenario.drive
    lag = 0.0
    breakaway = 0.0
    if not drive.governor:
        lag = drive.time_constant
        breakaway = drive.breakaway_throttle
    return ThrottleLine(drive.throttle_gain, drive.throttle_offset, lag, breakaway)


def run_time(scenario: Any) -> float:
    """Returns the length of the run of `scenario.manoeuvre`, s: `log_end` of AUTO sequences, or
    `duration`.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind == "auto_turn":
        return float(manoeuvre.log_end)
    return float(manoeuvre.duration)
