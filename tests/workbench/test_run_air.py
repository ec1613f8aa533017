"""Runs in moving air: what the log says about it, and that it replays."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_plant import own_instances
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import CAR_TRUTH
from aerodima.workbench.view.logged_run import add_logged_run
from tests.certain_cars import HIGH_CAR
from tests.workbench.made_up_runs import signals_equal

SHORT = ["manoeuvre.duration=0.3"]
STANDING = ["manoeuvre.speed=0.0", "manoeuvre.duration=0.2"]
UPRIGHT = ["controller.hold_angle=0.01", "controller.travel=0.01"]
LARGE = ["tail.sail_length=0.6", "tail.sail_width=0.2", "tail.sail_bearing_damping=5e-4"]
WIND = [column.name for column in CAR_TRUTH["wind_truth"]]


@pytest.fixture
def run(tmp_path):
    def make(*settings, scenario="turn_swing", name="run"):
        return simulate(load_scenario(scenario, list(settings)), tmp_path / f"{name}.parquet")

    return make


def test_wind_has_columns_in_a_run_with_wind_only(run, standard_runs):
    log = run("wind.mean_y=2.0", "wind.turbulence=0.4", *SHORT)
    assert [f"wind_{axis}_truth_m_per_s" for axis in "xyz"] == WIND
    assert list(log.table.columns)[-3:] == WIND
    # The noise is kept for 10 ms, five rows, and wanders about the mean; a change at 10 ms is in
    # the row of 10 ms.
    assert np.all(np.flatnonzero(np.diff(log.signal(WIND[0]))) % 5 == 4)
    assert 0.0 < log.signal(WIND[0]).std() < 1.2
    assert not set(WIND) & set(standard_runs["swing"].table.columns)


def test_run_in_wind_repeats_bit_for_bit_and_another_seed_is_other_weather(run):
    settings = ["wind.turbulence=0.4", *SHORT]
    one = run(*settings, name="a")
    again = run(*settings, name="b")
    other = run(*settings, "seed=2", name="c")
    assert signals_equal(one, again)
    assert not np.any(one.signal(WIND[1]) == other.signal(WIND[1]))
    assert (
        np.abs(one.signal("tail_force_z_truth_n") - other.signal("tail_force_z_truth_n")).max()
        > 1e-3
    )


@pytest.mark.parametrize(
    "settings",
    [["tail.sail=locked"], ["tail.sail=free"], ["tail.added_mass=0.05"], ["tail.added_mass=-0.01"]],
)
def test_replay_rebuilds_the_car_with_its_sail_and_its_added_mass(run, settings):
    log = run(*settings, *SHORT)
    logged = add_logged_run(DiagramBuilder(), log)
    plant = logged.plant
    assert logged.positions.shape == (len(log.table), plant.num_positions())
    context = plant.CreateDefaultContext()
    logged.move(context, -1)
    com = plant.CalcCenterOfMassPositionInWorld(context, own_instances(plant))
    assert_allclose(com, log.vector("com", "truth_m")[-1], atol=1e-9)
    tip = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("tail_rod")) @ np.array(
        [0.0, 0.0, log.scenario["tail"]["length"]]
    )
    assert_allclose(tip, log.vector("tail_tip", "truth_m")[-1], atol=1e-9)


def test_replay_turns_a_sail_that_faces_the_wind_as_its_encoder_saw_it(run):
    log = run(*HIGH_CAR, *SHORT)
    logged = add_logged_run(DiagramBuilder(), log)
    context = logged.plant.CreateDefaultContext()
    logged.move(context, -1)
    angle = logged.plant.GetJointByName("tail_sail_turn").get_angle(context)
    assert angle == log.signal("sail_angle_rad")[-1]
    # The tail is held on the left and the car drives off: the hollow, +y of the sail, looks ahead
    # at -90 degrees.
    assert np.remainder(angle, 2 * np.pi) == pytest.approx(1.5 * np.pi, abs=0.1)


def test_added_mass_counts_in_no_mass_of_the_log(run):
    log = run("tail.added_mass=0.1", *SHORT)
    arm = (
        log.scenario["tail"]["mass"] + log.scenario["tail"]["hub_mass"] + 0.001
    )  # and the anchor of the SDF
    assert log.extra["tail_mass_kg"] == pytest.approx(arm, abs=1e-9)
    assert log.extra["total_mass_kg"] == pytest.approx(log.scenario["car"]["mass"] + arm, rel=1e-8)


def test_log_says_how_long_the_coefficients_were_outside_their_range(run):
    # Standing in a cross wind the sail meets the wind itself; the line of the robot tail is
    # measured from 3 to 15 m/s.
    table = ["tail.coefficients=robot_tail_line", *LARGE, *UPRIGHT, *STANDING]
    for wind, outside in ((0.0, 1.0), (5.0, 0.0), (18.0, 1.0)):
        log = run(*table, f"wind.mean_y={wind}", name=f"wind_{wind}")
        assert log.extra["sections_outside_measured_range"] == outside
        assert log.extra["sections_above_quasi_steady_limit"] == 0.0  # not shown twice
        # rho v w / mu; the tail sways a little in the wind.
        assert log.extra["largest_reynolds_number"] == pytest.approx(
            1.225 * wind * 0.2 / 1.849e-5, rel=0.15, abs=4000
        )
    fast = run("wind.mean_y=18.0", *LARGE, *UPRIGHT, *STANDING, name="constant")
    assert fast.extra["sections_outside_measured_range"] == 0.0  # a number has no range
    assert fast.extra["sections_above_quasi_steady_limit"] == 1.0
    assert read_run_log(fast.source).extra == fast.extra
