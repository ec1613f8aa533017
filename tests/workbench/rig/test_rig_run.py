"""Swings on the rigs: logs that agree with the equations of motion and with what the sensors can
resolve.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import signals_equal

COUNT = 2 * math.pi / (512 * 4 * 26)
ACCURACIES = np.array([8.0067, 7.9933, 14.46, 0.4283, 0.445, 0.38])  # Table 4.8


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """One log of each kind of swing, rest and run shortened."""
    folder = tmp_path_factory.mktemp("rig")
    settings = ["experiment.rest=0.2", "experiment.duration=1.0"]
    made = {}
    for name in ("flick", "bar", "robot"):
        scenario = load_rig_scenario(name, settings)
        made[name] = (scenario, simulate(scenario, folder / f"{name}.parquet"))
    return made


def wrench_truth(log):
    return np.column_stack((log.vector("force", "truth_n"), log.vector("torque", "truth_n_m")))


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
def test_it_rests_at_the_start_angle_and_then_swings_upstream(logs, name):
    scenario, log = logs[name]
    angle = log.signal("angle_truth_rad")
    resting = log.time <= 0.2
    assert_allclose(angle[resting], scenario.experiment.angle, atol=3e-4)
    assert angle[-1] < 0.6 * scenario.experiment.angle
    assert np.max(np.abs(log.signal("angular_velocity_truth_rad_per_s")[resting])) < 0.01


def test_free_bar_swing_decays_with_the_published_friction(logs):
    """J angle'' = -m g d sin(angle) - Cf tanh(10 w) - Vf w with Tables 4.5 to 4.7, integrated by
    scipy.
    """
    _, log = logs["bar"]
    inertia = 6.731e-3 + 1.9198e-3 + 0.313 * 0.1**2
    begin = 201  # let go at 0.2 s
    angle = log.signal("angle_truth_rad")
    rate = log.signal("angular_velocity_truth_rad_per_s")

    def motion(_t, x):
        friction = 0.0435 * math.tanh(10.0 * x[1]) + 0.0364 * x[1]
        return [x[1], (-0.313 * 9.81 * 0.1 * math.sin(x[0]) - friction) / inertia]

    span = (log.time[begin], log.time[-1])
    solution = solve_ivp(
        motion, span, [angle[begin], rate[begin]], t_eval=log.time[begin:], rtol=1e-10, atol=1e-12
    )
    assert_allclose(angle[begin:], solution.y[0], atol=1e-7)
    assert_allclose(rate[begin:], solution.y[1], atol=1e-6)
    energy = 0.5 * inertia * rate**2 - 0.313 * 9.81 * 0.1 * np.cos(angle)
    assert np.all(np.diff(energy[begin:]) < 1e-12)


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
def test_logged_wrench_is_the_reaction_at_the_logged_state_and_torque(logs, name):
    scenario, log = logs[name]
    rig = Rig(scenario)
    rows = log.table.iloc[::97]
    for index, row in rows.iterrows():
        reaction = rig.reaction(
            row["angle_truth_rad"],
            row["angular_velocity_truth_rad_per_s"],
            row["motor_torque_truth_n_m"],
        )
        assert_allclose(wrench_truth(log)[index], reaction.wrench, atol=1e-9)


def test_motor_torque_is_minus_the_current(logs):
    """0.346 N m/A on the cheetah rig; the current in the log has noise of 0.01 A, here averaged
    over 200 samples.
    """
    _, log = logs["flick"]
    rest = log.time < 0.2
    torque = np.mean(log.signal("motor_torque_truth_n_m")[rest])
    assert torque == pytest.approx(
        -0.346 * np.mean(log.signal("current_a")[rest]), abs=0.346 * 0.004
    )
    _, log = logs["robot"]
    assert_allclose(
        log.signal("motor_torque_truth_n_m"), -1.23 * log.signal("current_a"), atol=1e-9
    )


def angle_error(log):
    return np.max(np.abs(log.signal("angle_rad") - log.signal("angle_truth_rad")))


def test_encoder_counts(logs):
    """Whole counts, nearest to the angle at that instant; the rate over 2 ms resolves 0.059 rad/s
    and lags 1 ms.
    """
    _, log = logs["flick"]
    counts = log.signal("angle_rad") / COUNT
    assert_allclose(counts, np.round(counts), atol=1e-6)
    assert angle_error(log) <= 0.5 * COUNT * (1 + 1e-9)
    rate = log.signal("angular_velocity_rad_per_s")
    truth = log.signal("angular_velocity_truth_rad_per_s")
    delayed = np.interp(log.time - 0.001, log.time, truth)
    assert np.max(np.abs(rate - delayed)[5:]) < COUNT / 0.002 * 1.1


def test_robot_motor_reports_words_of_the_mit_frame(logs):
    _, log = logs["robot"]
    assert angle_error(log) <= 12.5 / 65535 * (1 + 1e-9)


def test_force_readings_are_wrench_less_offset_plus_bias_and_noise(logs):
    scenario, log = logs["flick"]
    readings = np.column_stack((log.vector("force", "n"), log.vector("torque", "n_m")))
    offsets = np.array(scenario.cheetah_tail.offsets)
    rest = readings - (wrench_truth(log) - offsets + np.array(log.extra["bias"]))
    assert_allclose(rest.std(axis=0), 0.01 * ACCURACIES, rtol=0.08)
    assert np.all(np.abs(rest.mean(axis=0)) < 0.002 * ACCURACIES)


@pytest.mark.slow
def test_robot_tail_comes_to_rest_where_spring_and_wind_balance(tmp_path):
    """Held by kp (0 - angle): the same torque that holds that angle statically.

    Friction 0.161 N m may keep it away.
    """
    scenario = load_rig_scenario("robot", ["experiment.rest=0.2", "experiment.duration=2.5"])
    angle = simulate(scenario, tmp_path / "robot.parquet").signal("angle_truth_rad")[-1]
    rig = Rig(scenario)
    torque = -scenario.experiment.kp * angle
    assert torque == pytest.approx(rig.torque_of(rig.holding_current(angle)), abs=0.17)


def test_unactuated_flick_is_let_go(tmp_path):
    scenario = load_rig_scenario(
        "flick", ["experiment.actuated=false", "experiment.rest=0.02", "experiment.duration=0.2"]
    )
    log = simulate(scenario, tmp_path / "free.parquet")
    assert np.all(log.signal("motor_torque_truth_n_m")[25:] == 0.0)
    assert log.signal("angle_truth_rad")[-1] < 1.5


def test_tail_that_leaves_its_range_is_refused_and_its_rows_are_kept(tmp_path):
    scenario = load_rig_scenario(
        "flick",
        [
            "experiment.wind_speed=30",
            "experiment.angle=1",
            "experiment.rest=0.01",
            "mount.angle_limit=1.1",
        ],
    ).varied(experiment={"target": -1.0, "kp": 60.0, "kd": 0.0, "duration": 2.0})
    assert_refused(lambda: simulate(scenario, tmp_path / "wild.parquet"), UserError, "range")
    assert (tmp_path / "wild.parquet.journal").exists()


@pytest.mark.parametrize("name", ["static", "flick"])
def test_log_in_memory_is_that_of_the_file_bit_for_bit(name, tmp_path):
    scenario = load_rig_scenario(name, ["experiment.rest=0.2", "experiment.duration=0.5"])
    written = simulate(scenario, tmp_path / "run.parquet")
    kept = simulate(scenario)
    assert signals_equal(written, kept)
    assert (written.kind, written.extra, written.scenario) == (kept.kind, kept.extra, kept.scenario)
