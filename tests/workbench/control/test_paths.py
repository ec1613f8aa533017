import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.paths import Corner, LaneChange, off_path, path_of
from aerodima.workbench.core.errors import ScenarioError, UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

WIDTH, WHEELBASE = 0.18, 0.26
"""A passenger car of 1.8 m at 1:10."""


def lane_change(begin=0.0, side=1.0):
    return LaneChange(WIDTH, begin, side)


def off(path, x, y, heading, half_width=0.5 * WIDTH):
    return off_path(path, np.array([x]), np.array([y]), np.array([heading]), half_width, WHEELBASE)[
        0
    ]


def test_lengths_of_the_lane_change_are_those_of_iso_3888_2_at_a_tenth():
    """12, 13.5, 11, 12.5 and 12 m, 61 m altogether (ISO 3888-2:2011, 4.1)."""
    lanes = lane_change(begin=0.5).lanes
    ends = [place for lane in lanes for place in (lane.start, lane.end)]
    assert np.diff(ends) == pytest.approx([1.2, 1.35, 1.1, 1.25, 1.2])
    assert (ends[0], ends[-1]) == pytest.approx((0.5, 0.5 + 6.1))


def test_widths_and_offset_of_the_lane_change_are_those_of_iso_3888_2_at_a_tenth():
    """1.1 b + 0.25 m, b + 1 m, 1.3 b + 0.25 m but at least 3 m, and 1 m between the lanes: here b
    is 1.8 m.
    """
    first, middle, last = lane_change().lanes
    widths = [lane.left - lane.right for lane in (first, middle, last)]
    assert widths == pytest.approx([0.1 * (1.1 * 1.8 + 0.25), 0.1 * 2.8, 0.3])
    assert middle.right - first.left == pytest.approx(0.1)
    assert middle.right - last.left == pytest.approx(0.1)
    wide = LaneChange(0.294, 0.0, 1.0).lanes[2]
    assert wide.left - wide.right == pytest.approx(1.3 * 0.294 + 0.025), (
        "more than 3 m at full size"
    )


def test_centre_line_runs_through_the_middle_of_the_lanes_without_a_kink():
    path = lane_change()
    x = np.linspace(0.0, 7.0, 7001)
    places, y = path.centre(x)
    assert_array_equal(places, x)
    for lane in path.lanes:
        assert_allclose(y[(x >= lane.start) & (x <= lane.end)], lane.centre, atol=1e-12)
    slope = np.diff(y) / np.diff(x)
    assert np.max(np.abs(np.diff(slope))) < 0.005, (
        "in 1 mm: curvature below 5 per m, where a kink would jump by 0.4"
    )


@pytest.mark.parametrize("path", [lane_change(0.4), Corner(1.2, 0.4, 0.4, 1.0)])
def test_station_of_the_centre_line_is_the_one_it_was_made_from(path):
    stations = np.linspace(-0.5, path.end + 1.0, 200)
    assert_allclose(path.station(*path.centre(stations)), stations, atol=1e-12)


def test_a_corner_is_a_quarter_of_a_circle_between_two_straights():
    path = Corner(radius=1.2, width=0.4, begin=0.6, side=1.0)
    assert path.bend == pytest.approx(1.8)
    assert path.centre(path.bend) == pytest.approx((1.8, 0.0))
    after = path.bend + 0.5 * math.pi * 1.2
    assert path.centre(after) == pytest.approx((3.0, 1.2))
    assert path.centre(after + 0.7) == pytest.approx((3.0, 1.9))
    places = np.array(path.centre(np.linspace(0.0, 6.0, 6001)))
    assert_allclose(np.hypot(*np.diff(places)), 1e-3, rtol=1e-6)


def test_edges_of_a_corner_are_half_its_width_from_the_centre_line():
    path = Corner(radius=1.2, width=0.4, begin=0.0, side=1.0)
    for radius, beyond in ((1.0, 0.0), (1.4, 0.0), (1.2, -0.2), (1.5, 0.1), (0.9, 0.1)):
        x = 1.2 + radius * math.sin(0.7)
        y = 1.2 - radius * math.cos(0.7)
        assert path.outside(x, y) == pytest.approx(beyond)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_car_in_the_middle_of_a_lane_is_inside_by_half_the_room(side):
    path = lane_change(side=side)
    first, middle, _ = path.lanes
    assert off(path, 0.5, 0.0, 0.0) == pytest.approx(-0.5 * (first.left - first.right - WIDTH))
    centre = side * middle.centre
    assert off(path, middle.start + 0.3, centre, 0.0) == pytest.approx(-0.5 * (0.28 - WIDTH))
    assert off(path, middle.start + 0.3, centre + 0.08, 0.0) == pytest.approx(0.08 - 0.05)


def test_between_the_lanes_there_are_no_cones():
    assert off(lane_change(), 1.6, 3.0, 0.5) == -math.inf


def test_a_corner_of_the_car_that_heads_out_of_the_lane_counts():
    """The front outer corner is ahead by the wheelbase and beside by half the width, turned by the
    heading.
    """
    path = lane_change()
    heading = 0.2
    corner = WHEELBASE * math.sin(heading) + 0.5 * WIDTH * math.cos(heading)
    assert off(path, 0.5, 0.0, heading) == pytest.approx(corner - path.lanes[0].left)


def test_a_car_meets_the_last_cone_with_its_side():
    """Both axles are clear of the lane's end, front ahead and rear inside of the edge; the side is
    over the cone.
    """
    path = lane_change()
    heading = 0.5
    lane = path.lanes[0]
    rear = lane.end - 0.5 * WHEELBASE * math.cos(heading), -0.03
    side = rear[1] + 0.5 * WHEELBASE * math.sin(heading) + 0.5 * WIDTH / math.cos(heading)
    # On the left side y = y_rear + tan(heading) (x - x_rear) + half width / cos(heading); points
    # are 7 mm apart.
    assert off(path, *rear, heading) == pytest.approx(
        side - lane.left, abs=0.007 * math.sin(heading)
    )


def test_mirrored_paths_judge_mirrored_cars_alike():
    rng = np.random.default_rng(3)
    x = rng.uniform(0.0, 6.0, 200)
    y = rng.uniform(-0.6, 0.6, 200)
    heading = rng.uniform(-0.6, 0.6, 200)
    for make in (lane_change, lambda side: Corner(1.2, 0.4, 0.0, side)):
        left = off_path(make(side=1.0), x, y, heading, 0.09, WHEELBASE)
        right = off_path(make(side=-1.0), x, -y, -heading, 0.09, WHEELBASE)
        assert_allclose(left, right, atol=1e-12)


def test_a_car_along_the_centre_line_keeps_the_path_to_its_end_and_a_wide_one_does_not():
    path = Corner(1.2, 0.4, 0.0, 1.0)
    stations = np.linspace(0.0, path.end, 300)
    x, y = path.centre(stations)
    heading = np.clip((stations - path.bend) / 1.2, 0.0, 0.5 * math.pi)
    assert path.station(x[-1], y[-1]) == pytest.approx(path.end)
    assert (
        np.max(off_path(path, x, y, heading, 0.05, 0.1))
        < 0.0
        < np.max(off_path(path, x, y, heading, 0.3, 0.1))
    )


def test_the_announced_side_is_that_of_the_next_shift():
    path = lane_change(side=-1.0)
    _, middle, last = path.lanes
    sides = [
        path.next_side(station)
        for station in (-math.inf, 0.0, middle.start - 0.01, middle.start, last.end + 1.0)
    ]
    assert sides == [-1.0, -1.0, -1.0, 1.0, 1.0]
    assert Corner(1.2, 0.4, 0.0, -1.0).next_side(2.0) == -1.0


@pytest.mark.parametrize(("rolling", "begin"), [(True, 2.0), (False, 1.4)])
def test_first_cones_stand_where_the_car_is_at_turn_start(rolling, begin):
    """2 m/s for 1 s; with a ramp of 0.6 s it has come 0.6 m less far."""
    manoeuvre = SimpleNamespace(
        direction="left",
        path="lane_change",
        rolling_start=rolling,
        speed_ramp=0.6,
        speed=2.0,
        turn_start=1.0,
    )
    path = path_of(
        SimpleNamespace(manoeuvre=manoeuvre, car=SimpleNamespace(track=0.13, tyre_width=0.05))
    )
    assert path.lanes[0].start == pytest.approx(begin)
    assert path.vehicle_width == pytest.approx(WIDTH)


@pytest.mark.parametrize(
    ("work", "error", "named"),
    [
        (
            lambda: load_scenario("entry_corner", ["manoeuvre.corner_radius=0.2"]),
            ScenarioError,
            ("manoeuvre.corner_radius", "corner_width", "0.2"),
        ),
        (lambda: off(lane_change(), 0.0, math.nan, 0.0), UserError, ("off_path", "y")),
    ],
    ids=["scenario", "place"],
)
def test_wrong_input_is_refused_by_name(work, error, named):
    assert_refused(work, error, *named)
