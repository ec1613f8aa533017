import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.car.laws import steady_speed
from aerodima.workbench.control.manoeuvre import (
    RisingSchedule,
    SlalomSchedule,
    SpeedRamp,
    ThrottleLine,
    level_angle,
    make_schedule,
    run_time,
    slewed_angle,
    turn_length,
    wheel_angle,
)
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused

STEER = math.radians(30.0)


def scenario(governor=True, **changes):
    manoeuvre = {
        "kind": "turn",
        "speed": 4.0,
        "direction": "left",
        "steer_angle": STEER,
        "turn_start": 2.0,
        "turn_hold": 0.5,
        "first_angle": 0.0,
        "first_hold": 0.0,
        "rolling_start": False,
        "turns": 1,
        "turn_gap": 1.0,
        "steer_rate": 0.05,
        "duration": 4.0,
        "speed_ramp": 1.2,
        "slalom_period": 2.0,
        "straight_time": 15.0,
        "wait_after_turn": 1.0,
        "log_end": 20.0,
    } | changes
    drive = SimpleNamespace(
        throttle_gain=10.0,
        throttle_offset=-1.0,
        time_constant=0.5,
        governor=governor,
        breakaway_throttle=0.25,
    )
    return SimpleNamespace(manoeuvre=SimpleNamespace(**manoeuvre), drive=drive)


def steering(schedule, times):
    return np.array([schedule.at(time).steering_angle for time in times])


def test_turn_steers_30_degrees_to_the_left_from_2_to_2_5_s():
    """Published instants (thesis 7.1.1), sampled at the controller's ticks of 10 ms."""
    schedule = make_schedule(scenario())
    ticks = 0.01 * np.arange(400)
    angles = steering(schedule, ticks)
    assert set(angles) == {0.0, STEER}
    turning = np.flatnonzero(angles)
    assert (turning[0], turning[-1]) == (200, 249)
    assert schedule.at(0.0).planned_turn == 1.0
    assert schedule.at(3.9).planned_turn == 1.0


def test_a_turn_of_two_levels_has_each_for_its_time():
    """At 2.2 s after 0.2 s; a first level without time is none."""
    schedule = make_schedule(scenario(first_angle=0.1, first_hold=0.2))
    angles = steering(schedule, 0.01 * np.arange(400))
    assert set(angles[200:220]) == {0.1}
    assert set(angles[220:250]) == {STEER}
    assert not angles[:200].any()
    assert not angles[250:].any()
    assert set(steering(make_schedule(scenario(first_angle=0.1)), 0.01 * np.arange(200, 250))) == {
        STEER
    }


LEVELS = {
    "level_1": 0.3,
    "level_2": -0.2,
    "level_3": 0.1,
    "level_1_end": 0.2,
    "level_2_end": 0.5,
    "trim_angle": 0.0,
}


def test_levels_follow_one_another_and_end_straight():
    schedule = make_schedule(scenario(kind="levels", turn_hold=0.8, direction="right", **LEVELS))
    angles = steering(schedule, 0.01 * np.arange(400))
    for first, end, angle in ((0, 200, 0.0), (200, 220, 0.3), (220, 250, -0.2), (250, 280, 0.1)):
        assert set(angles[first:end]) == {-angle}
    assert not angles[280:].any()
    trimmed = LEVELS | {"trim_angle": -0.05}
    schedule = make_schedule(scenario(kind="levels", turn_hold=0.8, direction="right", **trimmed))
    assert set(steering(schedule, 0.01 * np.arange(200))) == {0.05}
    assert (steering(schedule, 0.01 * np.arange(200, 400)) == angles[200:]).all()
    wrong = LEVELS | {"level_1_end": 0.6}
    assert_refused(
        lambda: make_schedule(scenario(kind="levels", turn_hold=0.8, **wrong)),
        UserError,
        "level_1_end",
        "0.6",
    )


def test_the_wheels_follow_levels_at_the_rate_of_the_servo():
    """The angle at any instant is that of a servo in small steps."""
    levels = (0.3, -0.2, 0.1)
    ends = (0.1, 0.25, 0.5)
    step = 1e-4
    angle = 0.0
    for index in range(8000):
        assert slewed_angle(levels, ends, 3.0, index * step) == pytest.approx(angle, abs=1e-3)
        command = level_angle(levels, ends, index * step)
        angle += min(max(command - angle, -3.0 * step), 3.0 * step)
    pulse = make_schedule(scenario(first_angle=0.4, first_hold=0.2))
    times = np.linspace(-0.1, 0.9, 21)
    expected = slewed_angle((0.4, STEER), (0.2, 0.5), 2.0, times)
    assert_array_equal(wheel_angle(pulse, 2.0, times), expected)


def test_ticks_reach_the_instants_whatever_their_rounding():
    schedule = make_schedule(scenario(turn_start=0.3, speed_ramp=0.1))
    assert schedule.at(0.1 + 0.2 - 1e-16).steering_angle == STEER
    assert schedule.at(np.nextafter(0.3, 0.0)).steering_angle == STEER
    assert schedule.at(np.nextafter(0.8, 0.0)).steering_angle == 0.0


def test_throttle_inverts_the_line_along_the_ramp():
    """speed = 10 throttle - 1: standstill at 0.1, 2 m/s half way up the ramp at 0.3, 4 m/s at
    0.5.
    """
    schedule = make_schedule(scenario())
    assert schedule.at(0.0).throttle == pytest.approx(0.1)
    assert schedule.at(0.6).throttle == pytest.approx(0.3)
    assert schedule.at(1.2).throttle == pytest.approx(0.5)
    assert schedule.at(3.9).throttle == pytest.approx(0.5)


def test_throttle_of_a_speed_is_that_of_the_car_forwards_and_in_reverse():
    """Also with a line that begins above 0, below whose speed the car cannot go."""
    for offset, speeds in ((-1.0, (-4.0, 0.5, 4.0)), (1.0, (-4.0, 4.0))):
        line = ThrottleLine(10.0, offset)
        drive = SimpleNamespace(governor=True, throttle_gain=10.0, throttle_offset=offset)
        for speed in speeds:
            assert steady_speed(line.throttle(speed), drive) == pytest.approx(speed)
    assert line.throttle(0.5) == 0.0
    for slow in (0.5, 1.0):
        work = partial(line.check_speed, slow)
        assert_refused(work, UserError, f"manoeuvre.speed: {slow:g} m/s", "above 1 m/s")


def test_frozen_throttle_reaches_the_speed_and_is_constant_through_the_turn():
    """A first-order car (0.5 s) driven by the schedule follows the ramp and holds the speed, tick
    by tick exactly.
    """
    schedule = make_schedule(scenario(governor=False))
    speed = 0.0
    decay = math.exp(-0.01 / 0.5)
    for tick in range(400):
        throttle = schedule.at(0.01 * tick).throttle
        steady = 10.0 * throttle - 1.0
        speed = steady + (speed - steady) * decay
        if tick == 59:
            # The throttle is held for 10 ms while the ramp goes on: half a tick of it, 0.017 m/s.
            assert speed == pytest.approx(4.0 / 1.2 * 0.6, abs=0.02)
        if tick >= 120:
            assert throttle == pytest.approx(0.5)
    assert speed == pytest.approx(4.0, abs=0.001)


def test_auto_sequence_of_an_open_loop_car_is_one_throttle_from_the_first_tick():
    schedule = make_schedule(scenario(governor=False, kind="auto_turn"))
    assert [schedule.at(time).throttle for time in (0.0, 0.5, 5.0, 15.2, 16.4)] == pytest.approx(
        [0.5] * 5
    )
    assert schedule.at(16.5).throttle == 0.0


def test_feed_forward_is_clipped_to_full_throttle():
    line = ThrottleLine(10.0, 0.0, time_constant=5.0)
    assert line.throttle(2.0, acceleration=4.0) == 1.0
    assert line.throttle(2.0, acceleration=-4.0) == -1.0


def test_auto_sequence_of_the_car():
    """Thesis 7.2.1: 15 s straight, 30 degrees for 0.5 s, 1 s straight, throttle 0, log to 20 s."""
    manoeuvre = scenario(kind="auto_turn")
    schedule = make_schedule(manoeuvre)
    assert schedule.at(14.99).steering_angle == 0.0
    assert schedule.at(15.0).steering_angle == STEER
    assert schedule.at(15.49).steering_angle == STEER
    assert schedule.at(15.5).steering_angle == 0.0
    assert schedule.at(16.49).throttle == pytest.approx(0.5)
    assert schedule.at(16.5).throttle == 0.0
    assert schedule.at(0.0).planned_turn == 1.0
    assert run_time(manoeuvre) == 20.0
    assert run_time(scenario()) == 4.0


def test_straight_line_announces_no_turn():
    schedule = make_schedule(scenario(kind="straight"))
    assert {schedule.at(time)[::2] for time in np.linspace(0.0, 4.0, 41)} == {(0.0, 0.0)}
    assert schedule.at(3.0).throttle == pytest.approx(0.5)


def test_slalom_is_a_sine_of_30_degrees_that_starts_to_the_left():
    schedule = make_schedule(scenario(kind="slalom"))
    assert_allclose(
        steering(schedule, [1.0, 2.0, 2.25, 2.5, 3.0, 3.5, 4.0, 4.5]),
        STEER * np.array([0.0, 0.0, math.sqrt(0.5), 1.0, 0.0, -1.0, 0.0, 1.0]),
        atol=1e-15,
    )


def test_slalom_announces_each_half_wave_with_the_side_it_steers_to():
    schedule = make_schedule(scenario(kind="slalom", direction="right", slalom_period=0.7))
    assert schedule.at(0.0).planned_turn == -1.0
    for time in np.linspace(2.01, 8.0, 200):
        driver = schedule.at(time)
        assert driver.steering_angle * driver.planned_turn >= -1e-9


def test_slalom_may_steer_while_it_gathers_speed():
    schedule = SlalomSchedule(SpeedRamp(4.0, 2.0, ThrottleLine(10.0, 0.0)), 1.0, STEER, 0.0, 2.0)
    assert steering(schedule, [0.5]) == pytest.approx([STEER])
    assert [schedule.at(time).throttle for time in (0.5, 1.0, 2.0)] == pytest.approx(
        [0.1, 0.2, 0.4]
    )


def test_wheels_are_straightened_from_what_is_left_of_a_larger_first_level():
    """At 2 rad/s, from 0.5 rad: none is left after 0.2 s; 0.3 rad after 0.1 s; all of it without a
    second level.
    """
    assert turn_length(2.0, 0.1, 0.5) == 0.55
    ends = [turn_length(2.0, 0.1, 0.5, 0.5, first_hold) for first_hold in (0.2, 0.4, 0.5)]
    assert ends == pytest.approx([0.55, 0.65, 0.75])
    assert turn_length(2.0, 0.1, 0.5, 0.5, 0.0) == 0.55, "no time at the first level"


def test_two_turns_are_the_same_pulse_twice_with_straight_wheels_in_between():
    """0.5 s of 30 degrees from 2.0 s and again 1 s after its end, from 3.5 s; sampled at ticks of
    10 ms.
    """
    twice = make_schedule(scenario(turns=2, turn_gap=1.0))
    ticks = 0.01 * np.arange(500)
    angles = steering(twice, ticks)
    assert_array_equal(ticks[angles > 0.0], np.concatenate([ticks[200:250], ticks[350:400]]))
    once = steering(make_schedule(scenario()), ticks)
    assert_array_equal(angles[150:300], once[150:300])
    assert_array_equal(angles[300:450], once[150:300])
    assert turn_length(2.0, 0.1, 0.5, repeats=2, gap=1.0) == 2.05
    withdrawn = [float(tick) for tick in ticks if twice.at(tick).planned_turn == 0.0]
    assert withdrawn == pytest.approx(0.01 * np.arange(280, 290))
    single = make_schedule(scenario())
    assert {single.at(time).planned_turn for time in ticks} == {1.0}


def test_both_turns_have_two_levels_if_one_has():
    schedule = make_schedule(scenario(turns=2, turn_gap=0.5, first_angle=0.1, first_hold=0.2))
    assert steering(schedule, [2.1, 2.3, 2.6, 3.1, 3.3, 3.6]) == pytest.approx(
        [0.1, STEER, 0.0, 0.1, STEER, 0.0]
    )


@pytest.mark.parametrize("changes", [{}, {"turns": 2}, {"kind": "rising"}, {"kind": "slalom"}])
def test_right_is_the_mirror_image_of_left(changes):
    left, right = (make_schedule(scenario(direction=side, **changes)) for side in ("left", "right"))
    for time in 0.05 * np.arange(100):
        one = left.at(time)
        other = right.at(time)
        assert (one.steering_angle, one.throttle, one.planned_turn) == (
            -other.steering_angle,
            other.throttle,
            -other.planned_turn,
        )


def test_rising_steering_grows_in_proportion_to_time_up_to_its_angle():
    schedule = make_schedule(scenario(kind="rising"))
    assert isinstance(schedule, RisingSchedule)
    assert steering(schedule, [0.0, 2.0, 3.0, 6.0, 12.0, 60.0]) == pytest.approx(
        [0.0, 0.0, 0.05, 0.2, 0.5, STEER]
    )


@pytest.mark.parametrize("governor", [True, False])
def test_a_rolling_start_has_the_throttle_of_its_speed_from_time_0(governor):
    schedule = make_schedule(scenario(governor, rolling_start=True, turn_start=0.3))
    assert {schedule.at(time).throttle for time in (0.0, 0.1, 0.3, 2.0)} == {0.5}, (
        "(4 + 1) / 10 of the throttle line"
    )


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"speed": 9.01}, ("manoeuvre.speed", "9.01", "9")),
        ({"governor": False, "speed": 1.4}, ("manoeuvre.speed", "1.4", "1.5")),
        ({"speed_ramp": 2.1}, ("manoeuvre.speed_ramp", "2.1", "2")),
        ({"kind": "auto_turn", "log_end": 16.0}, ("manoeuvre.log_end", "16", "16.5")),
        ({"kind": "levels", **LEVELS, "turn_hold": 0.4}, ("manoeuvre.level_2_end", "0.5", "0.4")),
        ({"kind": "fishhook"}, ("manoeuvre.kind", "fishhook")),
        ({"kind": "path"}, ("manoeuvre.kind", "path")),
    ],
    ids=str,
)
def test_what_no_car_can_drive_as_a_function_of_time_is_refused(changes, named):
    assert_refused(lambda: make_schedule(scenario(**changes)), UserError, *named)


def test_governor_holds_a_speed_below_that_at_which_an_open_loop_car_breaks_away():
    assert make_schedule(scenario(speed=1.4)).at(3.0).throttle == pytest.approx(0.24)
