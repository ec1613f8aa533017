"""Drift, gaps and filters, and what is said about them."""

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import run_log_from_metadata, run_metadata
from aerodima.workbench.logs.signals import (
    RIG_FILTER,
    LowPass,
    conditioning_notes,
    fill_gaps,
    low_pass_columns,
    remove_drift,
)
from tests.refusals import assert_named, assert_refused

TIMES = np.arange(5001) / 500.0


def rig_log(signals=None, time=TIMES):
    table = pd.DataFrame({"time_s": time, "angle_rad": np.zeros(time.size), **(signals or {})})
    return run_log_from_metadata(table, run_metadata({}, 0, kind="swing"), source="rig.parquet")


def test_drift_is_the_line_through_the_resting_part_only():
    pulse = np.where((TIMES > 5.0) & (TIMES < 6.0), 2.0, 0.0)
    run_log = rig_log({"force_y_n": pulse + 0.3 - 0.05 * TIMES})
    done = remove_drift(run_log, ["force_y_n"], [(0.0, 4.0)])
    np.testing.assert_allclose(done.signal("force_y_n"), pulse, atol=1e-12)


def test_drift_with_the_wind_on_keeps_the_level_of_the_first_resting_time():
    run_log = rig_log({"force_y_n": -2.5 + 0.1 * TIMES})
    kept = remove_drift(run_log, ["force_y_n"], [(1.0, 3.0)], level="keep")
    assert np.allclose(kept.signal("force_y_n"), -2.4, atol=1e-12)
    zeroed = remove_drift(run_log, ["force_y_n"], [(1.0, 3.0)])
    assert np.allclose(zeroed.signal("force_y_n"), 0.0, atol=1e-12)


HELD = ("planned_turn", "speed_m_per_s", "status_armed", "controller_state", "throttle_command")


def holed():
    """A straight line with a gap of 0.02 s after 2 s and NaN from 4 to 4.01 s; states, commands and
    samples of a slow sensor that change in the gap.
    """
    lost = (TIMES > 2.0) & (TIMES < 2.02 - 1e-9)
    table = {"force_y_n": 3.0 * TIMES, **dict.fromkeys(HELD, (TIMES > 2.01).astype(float))}
    table["force_y_n"] = np.where((TIMES >= 4.0) & (TIMES <= 4.01), np.nan, table["force_y_n"])
    return rig_log({name: values[~lost] for name, values in table.items()}, TIMES[~lost])


def test_fill_draws_straight_lines_and_holds_states_and_commands():
    done = fill_gaps(holed(), 0.05)
    assert np.allclose(done.time, TIMES)
    assert np.allclose(done.signal("force_y_n"), 3.0 * TIMES)
    for name in HELD:
        assert done.signal(name)[(TIMES > 2.0) & (TIMES < 2.019)].tolist() == [0.0] * 9, name
    notes = " ".join(conditioning_notes(done))
    for told in ("0.02 s at 2 s", "9 rows", "6 lost", "force_y_n", "at 4 s"):
        assert told in notes
    assert conditioning_notes(fill_gaps(done, 0.05)) == conditioning_notes(done)


def test_a_gap_of_the_longest_length_is_filled_and_a_longer_one_is_not():
    assert fill_gaps(holed(), 0.02).time.size == TIMES.size
    assert_refused(lambda: fill_gaps(holed(), 0.0199), LogError, "rig.parquet", "time_s", "0.02 s")


def without(lost):
    return rig_log({"force_y_n": np.where(lost, np.nan, 1.0)})


def filtered(run_log):
    return low_pass_columns(run_log, ["force_y_n"], RIG_FILTER)


@pytest.mark.parametrize(
    ("work", "named"),
    [
        (lambda: fill_gaps(holed(), 0.015), ["time_s", "1 gap", "0.02 s", "2 s", "0.015"]),
        (
            lambda: fill_gaps(without((TIMES > 4) & (TIMES < 5)), 0.5),
            ["force_y_n", "1 s", "4 s", "0.5 s"],
        ),
        (lambda: fill_gaps(without(TIMES < 1), 5.0), ["force_y_n", "0 s"]),
        (lambda: fill_gaps(without(TIMES > 9), 5.0), ["force_y_n", "9.002 s"]),
        (
            lambda: remove_drift(without(TIMES < 0), ["force_y_n"], [(20.0, 21.0)]),
            ["force_y_n", "10"],
        ),
        (
            lambda: remove_drift(without(TIMES[42] == TIMES), ["force_y_n"], [(0.0, 4.0)]),
            ["force_y_n", "1", "0.084 s"],
        ),
        (lambda: filtered(without(TIMES >= 0)), ["force_y_n", "5001", "nan", "0 s"]),
        (lambda: filtered(rig_log()), ["force_y_n"]),
        (lambda: filtered(holed()), ["time_s", "1 gap", "0.02 s", "2 s"]),
    ],
)
def test_what_cannot_be_conditioned_is_named_with_log_column_and_time(work, named):
    assert_refused(work, LogError, "rig.parquet", *named)


def test_a_constant_signal_is_filtered_to_itself():
    done = low_pass_columns(rig_log({"force_y_n": 2.0}), ["force_y_n"], LowPass(2, 5.0))
    assert np.allclose(done.signal("force_y_n"), 2.0, atol=1e-12)
    (note,) = conditioning_notes(done)
    assert_named(note, ("2", "5 Hz", "force_y_n"))
