"""A run in memory comes to the same as a run with its log, and stops at a flip."""

import dataclasses

import numpy as np
import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.swing_law import SwingLaw, SwingSettings, SwingState
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.simulate.car_run import run_scenario
from aerodima.workbench.simulate.trial import STOPPED, run_trial

SHORT = ["manoeuvre.speed_ramp=0.8", "manoeuvre.turn_start=1.0", "manoeuvre.duration=2.1"]
"""Turn after 1 s instead of 2 s: the run of a test costs half."""
TAIL_TRUTH_ONLY = ("over_window", "until_peak_roll")


def turn(mode, speed, *settings):
    return load_scenario(f"turn_{mode}", [*SHORT, f"manoeuvre.speed={speed}", *settings])


def flat(values):
    return {key: value for key, value in values.items() if not isinstance(value, dict | tuple | str)}


@pytest.mark.parametrize(("mode", "direction"), [("none", "left"), ("swing", "right")])
def test_trial_of_a_surviving_car_has_the_outcome_and_metrics_of_its_logged_run(tmp_path, mode, direction):
    scenario = turn(mode, 2.5, f"manoeuvre.direction={direction}")
    logged = run_scenario(scenario, tmp_path / "run.parquet")
    expected, trial = summarise(logged, scenario.name), run_trial(scenario)
    assert STOPPED not in trial.run_log.extra
    for name in ("raw", "filtered", "outcome"):
        theirs, ours = (dataclasses.asdict(getattr(each.metrics, name)) for each in (expected, trial.summary))
        assert flat(ours) == pytest.approx(flat(theirs), rel=1e-9, abs=1e-9)
    assert trial.summary.metrics.outcome.result == "survived"
    assert flat(trial.summary.metrics.as_row()) == pytest.approx(flat(expected.metrics.as_row()), rel=1e-9, abs=1e-9)
    assert (trial.summary.trigger_time, trial.summary.window) == (expected.trigger_time, expected.window)
    for name in trial.run_log.table.columns:  # rounding alone sets them apart, 1e-9 of the largest value
        scale = max(1.0, float(np.max(np.abs(logged.signal(name)))))
        np.testing.assert_allclose(trial.run_log.signal(name), logged.signal(name), atol=1e-9 * scale, err_msg=name)


def test_all_signals_give_the_table_of_the_logged_run_and_the_impulses_of_the_tail(tmp_path):
    scenario = turn("swing", 3.0)
    logged = run_scenario(scenario, tmp_path / "run.parquet")
    trial = run_trial(scenario, signals="all")
    assert list(trial.run_log.table.columns) == list(logged.table.columns)
    np.testing.assert_array_equal(trial.run_log.table.to_numpy(), logged.table.to_numpy())
    assert trial.summary == dataclasses.replace(summarise(logged, scenario.name))
    assert trial.summary.over_window is not None
    assert run_trial(scenario).summary.over_window is None


def test_flipped_run_stops_once_the_turn_is_over_with_the_metrics_of_the_turn():
    scenario = turn("none", 3.4)
    stopped, whole = run_trial(scenario), run_trial(scenario, stop_when_flipped=False)
    end = stopped.run_log.extra[STOPPED]
    assert end == stopped.run_log.time[-1] < whole.run_log.time[-1]
    assert whole.run_log.time[-1] > 2.09
    assert end >= stopped.summary.window[1]
    assert stopped.run_log.signal("tilt_truth_rad").max() > FLIP_TILT
    assert stopped.summary.metrics.outcome.result == whole.summary.metrics.outcome.result == "flipped"
    assert stopped.summary.metrics.raw == dataclasses.replace(
        whole.summary.metrics.raw, roll_integral_rad=stopped.summary.metrics.raw.roll_integral_rad
    )
    rows = len(stopped.run_log.table)
    np.testing.assert_array_equal(stopped.run_log.table.to_numpy(), whole.run_log.table.to_numpy()[:rows])


def test_another_law_takes_the_place_of_the_scenarios():
    scenario = turn("swing", 3.0)
    held = run_trial(scenario, tail_law=SwingLaw(SwingSettings(mode="held")))
    assert held.summary.trigger_time is None
    assert SwingState.SWING in run_trial(scenario).run_log.signal("controller_state")


def test_run_that_is_too_short_for_its_turn_is_refused():
    with pytest.raises(UserError, match="the turn is 1 to"):
        run_trial(turn("none", 3.0, "manoeuvre.duration=1.3"))
