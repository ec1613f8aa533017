import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.driver_law import (
    DriverView,
    FishhookDriver,
    PathDriver,
    ScheduledDriver,
    make_driver,
    refuse_simulated_only,
)
from aerodima.workbench.control.manoeuvre import SpeedRamp, ThrottleLine, make_schedule
from aerodima.workbench.control.paths import off_path
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

RAMP = SpeedRamp(4.0, 0.0, ThrottleLine(10.0, 0.0))
STEER, RATE = math.radians(30.0), math.radians(30.0) / 0.14
FISHHOOK = FishhookDriver(RAMP, 1.0, STEER, 0.3, 0.95, 0.0828, RATE)


def driven(law, roll_rate, side=1.0, length=3.0):
    """Steering and announced turn at ticks of 10 ms, for a roll rate that is a function of time."""
    memory = law.start()
    inputs = []
    for tick in range(round(100 * length)):
        before = memory.copy()
        seen = DriverView(0.01 * tick, roll_rate=side * roll_rate(0.01 * tick))
        after, given = law.step(memory, seen)
        assert_array_equal(memory, before, err_msg="a law must not change its arguments")
        memory = after
        inputs.append((given.steering_angle, given.planned_turn))
    return np.array(inputs).T


def steered(law, *seen):
    """Angle at each of some ticks."""
    memory = law.start()
    angles = []
    for one in seen:
        memory, given = law.step(memory, one)
        angles.append(given.steering_angle)
    return angles


def roll_until(end):
    """Rolls outwards by 1 rad/s until then, back afterwards."""
    return lambda time: 1.0 if time < end - 1e-9 else -0.5


@pytest.mark.parametrize("end", [0.5, 0.8])
def test_fishhook_counter_steers_when_the_car_stops_rolling_outwards(end):
    steering, _ = driven(FISHHOOK, roll_until(end))
    times = 0.01 * np.arange(steering.size)
    assert times[np.argmax(steering > 0.0)] == pytest.approx(0.3)
    assert times[np.argmax(steering < 0.0)] == pytest.approx(end)
    assert set(steering) == {0.0, STEER, -STEER}


def test_fishhook_holds_the_wheels_at_the_second_angle_for_its_time_and_announces_its_sides():
    """The servo takes 0.28 s from one side to the other (0.14 s for 30 degrees), then 0.95 s, in
    ticks of 10 ms.
    """
    steering, side = driven(FISHHOOK, roll_until(0.6))
    assert np.count_nonzero(steering < 0.0) == pytest.approx(28 + 95, abs=1)
    assert steering[-1] == 0.0
    counter = np.argmax(steering < 0.0)
    assert set(side[:counter]) == {1.0}
    assert set(side[counter:]) == {-1.0}


def test_fishhook_waits_for_the_wheels():
    """The car has stopped rolling before its wheels arrive, 0.14 s after the command."""
    steering, _ = driven(FISHHOOK, roll_until(0.35))
    assert 0.01 * np.argmax(steering < 0.0) == pytest.approx(0.44, abs=0.0101)


def test_fishhook_waits_until_the_car_has_rolled():
    """Its wheels arrive at 0.44 s, and it rolls from 0.5 to 0.7 s."""
    steering, _ = driven(FISHHOOK, lambda time: 1.0 if 0.5 <= time < 0.7 - 1e-9 else 0.0)
    assert 0.01 * np.argmax(steering < 0.0) == pytest.approx(0.7)
    still, _ = driven(FISHHOOK, lambda time: 0.0)
    assert set(still[30:]) == {STEER}


def test_fishhook_waits_while_the_roll_rate_is_not_known():
    steering, _ = driven(FISHHOOK, lambda time: math.nan)
    assert set(steering[30:]) == {STEER}


def test_fishhook_to_the_right_is_the_mirror_image():
    left = driven(FISHHOOK, roll_until(0.6))
    right = driven(replace(FISHHOOK, side=-1.0), roll_until(0.6), side=-1.0)
    assert_array_equal(left, -right)


def test_a_schedule_is_a_driver_that_looks_at_nothing():
    scenario = load_scenario("entry_twice")
    law = make_driver(scenario)
    schedule = make_schedule(scenario)
    assert isinstance(law, ScheduledDriver)
    assert law.sources == ()
    for time in (0.0, 0.35, 1.0, 1.9, 4.0):
        memory, given = law.step(law.start(), DriverView(time))
        assert memory.size == 0
        assert given == schedule.at(time)


@pytest.mark.parametrize(
    ("name", "sources"),
    [("entry_fishhook", ("imu",)), ("entry_corner", ("imu", "pose")), ("entry_rising_steer", ())],
)
def test_a_driver_names_what_it_looks_at_and_starts_without_seeing_it(name, sources):
    law = make_driver(load_scenario(name))
    assert law.sources == sources
    memory, given = law.step(law.start(), DriverView(0.0))
    assert given.steering_angle == 0.0
    assert given.planned_turn == 1.0
    assert memory.shape == law.start().shape


def bicycle(scenario, law):
    """Place, heading, steering command and announced side of a kinematic bicycle behind the
    scenario's servo.
    """
    x = y = heading = angle = yaw_rate = 0.0
    speed = scenario.manoeuvre.speed
    step = 0.002
    memory = law.start()
    for tick in range(round(scenario.manoeuvre.duration / step)):
        if tick % 5 == 0:
            seen = DriverView(tick * step, (x, y), heading, heading, speed, yaw_rate)
            memory, given = law.step(memory, seen)
        most = scenario.servo.rate * step
        angle += min(max(given.steering_angle - angle, -most), most)
        yield x, y, heading, given.steering_angle, given.planned_turn
        yaw_rate = speed * math.tan(angle) / scenario.car.wheelbase
        x = x + speed * step * math.cos(heading)
        y = y + speed * step * math.sin(heading)
        heading += yaw_rate * step


def follow(name, *settings):
    scenario = load_scenario(name, ["manoeuvre.speed=1", "manoeuvre.duration=8", *settings])
    law = make_driver(scenario)
    assert isinstance(law, PathDriver)
    return scenario, law, np.array(list(bicycle(scenario, law))).T


@pytest.mark.parametrize("name", ["entry_lane_change", "entry_corner"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_path_driver_keeps_a_slow_kinematic_car_in_its_lane(name, side):
    """At 1 m/s the tyres need a tenth of their grip in the corner, so that the kinematic car is a
    fair one.
    """
    scenario, law, (x, y, heading, *_) = follow(name, f"manoeuvre.direction={side}")
    half_width = 0.5 * (scenario.car.track + scenario.car.tyre_width)
    assert np.max(off_path(law.path, x, y, heading, half_width, scenario.car.wheelbase)) < 0.0
    assert law.path.station(x[-1], y[-1]) >= law.path.end
    assert abs(heading[-1]) == pytest.approx(
        0.0 if name == "entry_lane_change" else 0.5 * math.pi, abs=0.02
    )


@pytest.mark.parametrize("name", ["entry_lane_change", "entry_corner"])
def test_a_mirrored_path_is_steered_as_its_mirror_image(name):
    """Up to rounding, which a stable driver does not blow up."""
    left, right = (follow(name, f"manoeuvre.direction={side}")[2] for side in ("left", "right"))
    assert_allclose(left[1:], -right[1:], atol=1e-9)
    assert_allclose(left[0], right[0], atol=1e-9)


def test_path_driver_reacts_late_and_turns_the_wheel_no_faster_than_hands_do():
    """Beside its path by 0.3 m it wants to steer at once: the first movement comes after 6 ticks of
    delay.
    """
    law = make_driver(load_scenario("entry_corner", ["manoeuvre.driver_rate=2"]))
    beside = DriverView(0.0, (0.0, 0.3), 0.0, 0.0, 2.0, 0.0)
    angles = steered(law, *(beside._replace(time=0.01 * tick) for tick in range(40)))
    assert angles[:6] == [0.0] * 6
    assert angles[6] < 0.0, "to the right, back to the path"
    assert np.max(np.abs(np.diff(angles))) <= 2.0 / 100.0 + 1e-12


def test_path_driver_steers_no_further_than_the_angle_of_the_manoeuvre():
    law = make_driver(load_scenario("entry_corner", ["manoeuvre.steer_angle=0.2"]))
    beside = DriverView(0.0, (0.0, 0.3), 0.5, 0.5, 2.0, 0.0)
    angles = steered(law, *(beside._replace(time=0.01 * tick) for tick in range(50)))
    assert min(angles) == angles[-1] == -0.2


def test_path_driver_without_yaw_rate_takes_it_for_none():
    law = make_driver(load_scenario("entry_corner", ["manoeuvre.driver_delay=0"]))
    seen = DriverView(0.0, (1.0, 0.05), 0.1, 0.1, 2.0, 0.0)
    assert steered(law, seen._replace(yaw_rate=math.nan)) == steered(law, seen)


def test_path_driver_steers_more_when_the_car_lacks_curvature():
    """Soft tyres: the same place and course at half the yaw rate of the kinematic car."""
    law = make_driver(
        load_scenario("entry_corner", ["manoeuvre.driver_delay=0", "manoeuvre.driver_rate=100"])
    )
    x, y = law.path.centre(law.path.bend + 0.8)
    heading = 0.8 / law.path.radius
    seen = DriverView(0.0, (float(x), float(y)), heading, heading, 2.0, 0.0)
    # The angle of the kinematic car on this circle; and after ten time constants.
    for share, expected in ((1.0, 1.0), (0.5, 1.0 + 0.5 * law.correction)):
        now = seen._replace(yaw_rate=share * 2.0 / law.path.radius)
        last = steered(law, *(now._replace(time=0.01 * tick) for tick in range(100)))[-1]
        assert math.tan(last) * law.path.radius / 0.27 == pytest.approx(expected, abs=1e-3)


def test_a_car_on_rigid_tyres_is_not_steered_from_side_to_side():
    """The kinematic car goes round the corner with one movement of the wheel there and one back."""
    _, _, (_, _, _, steering, _) = follow("entry_corner", "manoeuvre.speed=2")
    there_and_back = 2.0 * np.max(steering)
    assert np.sum(np.abs(np.diff(steering))) < 1.2 * there_and_back


@pytest.mark.parametrize("ahead", [0.0, 0.3, 1.2])
@pytest.mark.parametrize("side", ["left", "right"])
def test_path_driver_wants_the_curvature_of_where_the_car_is_after_his_delay(ahead, side):
    """The car goes on round its circle while the driver reacts: a driver without delay, who sees it
    there, wants the same. An arc of 0.2 m is its chord to (0.2 / 1.2)^2 / 24 = 0.1 %.
    """
    law = make_driver(load_scenario("entry_corner", [f"manoeuvre.direction={side}"]))
    delayed = replace(law, delay=0.1)
    prompt = replace(law, delay=0.0)
    speed = 2.0
    bent = (1.0 if side == "left" else -1.0) / law.path.radius

    def seen(along):
        """On a circle from 0.05 m beside the path in front of the corner, where it has come."""
        turned = bent * along
        x = law.path.bend + math.sin(turned) / bent
        y = 0.05 + (1.0 - math.cos(turned)) / bent
        return DriverView(0.0, (x, y), turned, turned, speed, bent * speed)

    there = prompt.wanted_curvature(seen(ahead + speed * delayed.delay), bent)
    found = delayed.wanted_curvature(seen(ahead), bent)
    assert found == pytest.approx(there, rel=2e-3)
    assert abs(found - prompt.wanted_curvature(seen(ahead), bent)) > 0.02


@pytest.mark.parametrize("name", ["entry_turn", "entry_fishhook", "entry_lane_change"])
def test_a_speed_out_of_reach_is_refused_for_every_kind(name):
    scenario = load_scenario(name, ["manoeuvre.speed=25"])
    assert_refused(lambda: make_driver(scenario), UserError, "manoeuvre.speed", "25", "14.4")


AT_REST = ("manoeuvre.rolling_start=false", "manoeuvre.turn_start=3")


@pytest.mark.parametrize("name", ["entry_turn", "entry_fishhook", "slalom"])
def test_a_real_car_drives_by_time_and_imu_and_starts_at_rest(name):
    refuse_simulated_only(load_scenario(name, AT_REST))
    rolling = load_scenario(name, ["manoeuvre.rolling_start=true"])
    assert_refused(
        lambda: refuse_simulated_only(rolling), UserError, "manoeuvre.rolling_start", "true"
    )


def test_a_real_car_follows_a_path_only_by_a_driver_of_ones_own():
    lane_change = load_scenario("entry_lane_change", AT_REST)
    assert_refused(lambda: refuse_simulated_only(lane_change), UserError, "manoeuvre.kind", "path")
    refuse_simulated_only(lane_change, user_driver=True)
