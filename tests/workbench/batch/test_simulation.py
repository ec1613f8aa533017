"""A run in memory comes to the same as a run with a log file, and stops at a flip if asked."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.outcome_record import CONTACT_COLUMNS, SETTLED
from aerodima.workbench.car.termination import STOPPED
from aerodima.workbench.car.tip_up import LIFT_COLUMNS
from aerodima.workbench.car.verdict import FLIP_TILT
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_machine import SwingLaw
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from aerodima.workbench.scenario.scenario import load_scenario
from tests.certain_cars import HIGH_CAR
from tests.refusals import assert_refused
from tests.workbench.car.outcome_study import differences, drawn_cars
from tests.workbench.control.published_law import published

SHORT = ["manoeuvre.speed_ramp=0.8", "manoeuvre.turn_start=1.0", "manoeuvre.duration=2.1"]
"""Turn after 1 s instead of 2 s: the run of a test costs half."""


def turn(mode, speed, *settings):
    return load_scenario(f"turn_{mode}", [*SHORT, f"manoeuvre.speed={speed}", *settings])


def flat(values):
    return {
        key: value for key, value in values.items() if not isinstance(value, dict | tuple | str)
    }


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "direction"), [("none", "left"), ("swing", "right")])
def test_trial_of_a_surviving_car_has_the_outcome_and_metrics_of_its_logged_run(
    tmp_path, mode, direction
):
    scenario = turn(mode, 2.5, f"manoeuvre.direction={direction}")
    logged = simulate(scenario, tmp_path / "run.parquet")
    run = simulate(scenario, record="outcome", stop_when_certain=False)
    expected = summarise(logged, scenario.name)
    found = summarise(run, scenario.name)
    assert not {STOPPED, SETTLED} & set(run.extra)
    assert found.metrics.outcome.result == "survived"
    assert flat(found.metrics.as_row()) == pytest.approx(
        flat(expected.metrics.as_row()), rel=1e-9, abs=1e-9
    )
    assert (found.trigger_time, found.window) == (expected.trigger_time, expected.window)
    for name in run.table.columns:  # rounding alone sets them apart, 1e-9 of the largest value
        if name in (*CONTACT_COLUMNS, *LIFT_COLUMNS):  # from the motion: see test_ground_loads.py
            continue
        scale = max(1.0, float(np.max(np.abs(logged.signal(name)))))
        assert_allclose(run.signal(name), logged.signal(name), atol=1e-9 * scale, err_msg=name)


def test_flipped_run_stops_once_the_turn_is_over_with_the_metrics_of_the_turn():
    scenario = turn("none", 3.4, *HIGH_CAR)
    runs = [simulate(scenario, record="outcome", stop_when_certain=stop) for stop in (None, False)]
    stopped, whole = (summarise(run, scenario.name) for run in runs)
    end = runs[0].extra[STOPPED]
    assert end == runs[0].time[-1] < runs[1].time[-1]
    assert runs[1].time[-1] > 2.09
    assert end >= stopped.window[1]
    assert runs[0].signal("tilt_truth_rad").max() > FLIP_TILT
    assert stopped.metrics.outcome.result == whole.metrics.outcome.result == "flipped"
    assert stopped.metrics.raw == dataclasses.replace(
        whole.metrics.raw, roll_integral_rad=stopped.metrics.raw.roll_integral_rad
    )
    rows = len(runs[0].table)
    assert_array_equal(runs[0].table.to_numpy(), runs[1].table.to_numpy()[:rows])


@pytest.mark.parametrize("mode", ["none", "swing"])
def test_surviving_car_ends_its_trial_once_it_has_settled_and_every_metric_is_that_of_the_whole_run(
    mode,
):
    scenario = turn(mode, 2.5, "manoeuvre.duration=3.0")
    early, whole = (
        simulate(scenario, record="outcome", stop_when_certain=stop) for stop in (None, False)
    )
    rows = len(early.table)
    assert early.extra[SETTLED] == early.time[-1] < 2.8 < 2.99 < whole.time[-1]
    # Wheel loads of a table of another length: rounding.
    assert_allclose(early.table.to_numpy(), whole.table.to_numpy()[:rows], rtol=0.0, atol=1e-8)
    found, expected = (flat(metrics_of(run).as_row()) for run in (early, whole))
    ends = {name for name in found if name.startswith("filtered_") or name == "tail_energy_j"}
    for name in set(found) - ends:
        assert found[name] == pytest.approx(expected[name], rel=1e-9), name
    for name in ends:  # the filters feel the end of the record; a tail that is held works a little
        assert found[name] == pytest.approx(expected[name], rel=2e-3, abs=2e-3), name


def test_car_that_meets_wind_drives_its_trial_to_the_end():
    scenario = turn("swing", 2.5, "wind.mean_y=0.5")
    run = simulate(scenario, record="outcome")
    assert SETTLED not in run.extra
    assert run.time[-1] == pytest.approx(2.1)


@pytest.mark.slow
@pytest.mark.nightly
def test_trials_near_the_limit_say_what_full_runs_say():
    compared = [
        differences(scenario) for car in drawn_cars(seed=3, count=2) for scenario in car.scenarios()
    ]
    assert {run.flipped for run in compared} == {True, False}
    assert [run.wrong for run in compared if run.wrong] == []


def test_another_law_takes_the_place_of_the_scenarios():
    scenario = turn("swing", 3.0)
    held = simulate(scenario, record="outcome", law=SwingLaw(published(mode="held")))
    assert held.extra["tail_law"] == "SwingLaw"
    assert SwingState.SWING not in held.signal("controller_state")
    assert SwingState.SWING in simulate(scenario, record="outcome").signal("controller_state")


def test_what_a_log_file_or_a_rig_cannot_have_is_refused(tmp_path):
    path = tmp_path / "run.parquet"
    assert_refused(lambda: simulate(turn("none", 3.0), path, record="outcome"), UserError)
    assert_refused(lambda: simulate(load_rig_scenario("flick"), record="outcome"), UserError)
    assert not path.exists()
