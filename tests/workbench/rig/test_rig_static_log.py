"""Static logs: schema, truth, and the model of the sensor's errors (design section 11)."""

import math
from functools import partial

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.logs.schema import read_run_log, write_run_log
from aerodima.workbench.rig.rig_log import RIG_COLUMN_NAMES
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import signals_equal

STATIC = load_rig_scenario("static")
ACCURACIES = np.array([8.0067, 7.9933, 14.46, 0.4283, 0.445, 0.38])  # Table 4.8
OFFSETS = np.array([-0.064, -0.019, 15.695, -0.011, -0.538, 0.013])  # Table 4.4, tail 1


def readings(log):
    return np.column_stack((log.vector("force", "n"), log.vector("torque", "n_m")))


def test_columns_are_those_of_the_contract_and_hold_angle_and_current(tmp_path):
    log = simulate_static_log(STATIC.varied(experiment={"angle": math.radians(15.0)}))
    path = write_run_log(log, tmp_path / "hold.parquet")
    back = read_run_log(path)
    assert tuple(back.table.columns) == RIG_COLUMN_NAMES
    assert len(back.table) == 20001
    assert back.time[-1] == 20.0
    assert back.signal("angle_rad")[0] == pytest.approx(
        math.radians(15.0), abs=0.6e-4
    )  # half a count
    assert np.mean(back.signal("current_a")) == pytest.approx(
        back.extra["truth"]["current"], abs=5e-4
    )


def test_reading_plus_offset_less_bias_is_the_wrench():
    scenario = STATIC.varied(force_sensor={"drift_fraction": 0.0})
    log = simulate_static_log(scenario)
    mean = readings(log).mean(axis=0)
    wrench = mean + OFFSETS - np.array(log.extra["bias"])
    # White noise of 1 % of the accuracy, averaged over 20001 samples: five standard errors.
    assert_allclose(
        wrench, log.extra["true_wrench"], atol=float(np.max(5 * 0.01 * ACCURACIES / 141.0))
    )
    assert_allclose(readings(log).std(axis=0), 0.01 * ACCURACIES, rtol=0.03)


@pytest.mark.slow
def test_bias_has_the_published_accuracy_over_many_logs():
    """200 seeds: a standard deviation is known to 1 / sqrt(400) = 5 %, so 15 % is three of that."""
    short = STATIC.varied(experiment={"duration": 0.01})
    biases = np.array(
        [simulate_static_log(short.varied(seed=seed)).extra["bias"] for seed in range(200)]
    )
    assert_allclose(biases.std(axis=0) / ACCURACIES, 1.0, atol=0.15)
    assert_allclose(biases.mean(axis=0) / ACCURACIES, 0.0, atol=0.22)
    correlation = np.corrcoef(biases.T) - np.eye(6)
    assert np.max(np.abs(correlation)) < 0.25


def test_drift_is_a_line_from_the_start_of_the_log():
    settings = {"noise_fraction": 0.0, "drift_fraction": 1e-3}
    log = simulate_static_log(STATIC.varied(force_sensor=settings))
    values = readings(log)
    assert_allclose(values[0] + OFFSETS - log.extra["bias"], log.extra["true_wrench"], atol=1e-12)
    slopes = (values[-1] - values[0]) / 20.0
    assert_allclose(values[10000] - values[0], 10.0 * slopes, atol=1e-9)
    assert np.all(np.abs(slopes) < 4e-3 * ACCURACIES)
    assert np.all(slopes != 0.0)


def test_equal_seeds_give_equal_logs_and_other_seeds_other_errors():
    first, again, other = (simulate_static_log(STATIC.varied(seed=seed)) for seed in (5, 5, 6))
    assert signals_equal(first, again)
    assert not np.allclose(readings(first)[0], readings(other)[0])


def test_a_slower_sensor_holds_its_samples():
    log = simulate_static_log(
        STATIC.varied(force_sensor={"rate": 250.0}, experiment={"duration": 0.1})
    )
    force = log.signal("force_x_n")
    assert np.all(force[0:4] == force[0])
    assert force[4] != force[3]


def test_a_rest_without_wind_comes_first_and_has_the_same_bias_and_drift():
    errors = {"noise_fraction": 0.0, "drift_fraction": 1e-3}
    windy = STATIC.varied(force_sensor=errors, experiment={"angle": 0.5, "duration": 3.0})
    log = simulate_static_log(windy.varied(experiment={"wind_off": 1.0}))
    hold = simulate_static_log(windy)
    calm = Rig(windy.varied(experiment={"wind_speed": 0.0}))
    current = calm.holding_current(0.5)
    still = calm.reaction(0.5, 0.0, calm.torque_of(current)).wrench
    resting = log.time <= 1.0
    assert log.extra["rest_s"] == [0.0, 1.0]
    assert "rest_s" not in hold.extra
    assert_array_equal(readings(log)[~resting], readings(hold)[~resting])
    assert_allclose(
        readings(hold)[resting] - readings(log)[resting],
        np.tile(hold.extra["true_wrench"] - still, (1001, 1)),
        atol=1e-12,
    )
    # 1001 samples of 0.01 A each.
    assert np.mean(log.signal("current_a")[resting]) == pytest.approx(current, abs=1.5e-3)
    assert np.mean(log.signal("current_a")[~resting]) == pytest.approx(
        hold.extra["truth"]["current"], abs=1.5e-3
    )


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"wind_off": 3.0, "duration": 3.0}, ["3 s", "duration"]),
        ({"wind_off": 1.0, "kind": "swing"}, ["1 s", "0 s"]),
    ],
)
def test_a_rest_that_leaves_no_hold_or_is_of_a_swing_is_refused(changes, named):
    work = partial(STATIC.varied, experiment=changes)
    assert_refused(work, ScenarioError, "experiment.wind_off", *named)


def test_truth_of_the_published_tables_is_theirs_at_the_held_angle():
    held = {"tail": 1, "angle": math.radians(30.0), "wind_speed": 10.0, "duration": 0.01}
    scenario = STATIC.varied(experiment=held)
    table = pd.read_csv(model_path("published/static_fits.csv"), dtype={"tail": str})
    rows = table.query(
        "tail == '1' and axis == 'major' and angle_of_attack_deg == 30 and wind_speed_m_per_s == 10"
    )
    truth = simulate_static_log(scenario).extra["truth"]
    assert rows.cd.min() - 1e-3 <= truth["cd"] <= rows.cd.max() + 1e-3
    assert rows.cl.min() - 1e-3 <= truth["cl"] <= rows.cl.max() + 1e-3
    assert list(truth) == ["cd", "cl", "psi3", "current"]


def test_exposure_is_told():
    assert simulate_static_log(STATIC).extra["exposed"]
    high = STATIC.varied(experiment={"angle": math.radians(75.0)})
    assert not simulate_static_log(high).extra["exposed"]
