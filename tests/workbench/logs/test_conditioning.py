"""Drift, gaps and filters, and what is said about them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.logs.signals import (
    RIG_FILTER,
    LowPass,
    conditioning_notes,
    fill_gaps,
    low_pass_columns,
    remove_drift,
)
from tests.workbench.logs.foreign_logs import DRIFT, NOISE, WRENCH, swing_readings, swing_truth

TIMES = np.arange(5001) / 500.0


def rig_log(
    signals: Mapping[str, Any] | None = None,
    time: np.ndarray = TIMES,
    kind: str = "swing",
    **extra: Any,
) -> RunLog:
    table = pd.DataFrame({"time_s": time, "angle_rad": np.zeros(time.size), **(signals or {})})
    return run_log_from_metadata(
        table, run_metadata({}, 0, kind=kind, extra=extra), source="rig.parquet"
    )


def test_drift_between_two_rests_is_removed_and_the_swing_is_kept() -> None:
    readings = swing_readings()
    run_log = rig_log({name: readings[name] for name in WRENCH}, readings["time_s"].to_numpy())
    done = remove_drift(run_log, WRENCH, [(0.0, 2.9), (20.0, 26.0)])
    truth = swing_truth(run_log.time)
    for name, noise, slope in zip(WRENCH, NOISE, DRIFT, strict=True):
        error = done.signal(name) - truth[name].to_numpy()
        # The line's error at either rest is noise / sqrt(1450 samples), and what is left of the
        # swing at 20 s.
        assert np.sqrt(np.mean(error**2)) < 1.02 * noise, name
        assert abs(np.mean(error)) < 0.05 * noise, name
        stated = float(
            conditioning_notes(done)[WRENCH.index(name)].split(": ")[1].split(" per s")[0]
        )
        assert stated == pytest.approx(slope, rel=0.02)


def test_drift_is_the_line_through_the_resting_part_only() -> None:
    pulse = np.where((TIMES > 5.0) & (TIMES < 6.0), 2.0, 0.0)
    run_log = rig_log({"force_y_n": pulse + 0.3 - 0.05 * TIMES})
    done = remove_drift(run_log, ["force_y_n"], [(0.0, 4.0)])
    np.testing.assert_allclose(done.signal("force_y_n"), pulse, atol=1e-12)
    with pytest.raises(LogError, match=r"no resting part .* force_y_n"):
        remove_drift(run_log, ["force_y_n"], [(20.0, 21.0)])
    lost = rig_log({"force_y_n": np.where(TIMES[42] == TIMES, np.nan, 0.0)})
    with pytest.raises(LogError, match=r"'force_y_n': 1 sample\(s\) not finite"):
        remove_drift(lost, ["force_y_n"], [(0.0, 4.0)])


def test_drift_with_the_wind_on_keeps_the_level() -> None:
    run_log = rig_log({"force_y_n": -2.5 + 0.1 * TIMES})
    kept = remove_drift(run_log, ["force_y_n"], [(0.0, 3.0)], level="keep")
    assert np.allclose(kept.signal("force_y_n"), -2.5, atol=1e-12)
    assert np.allclose(
        remove_drift(run_log, ["force_y_n"], [(0.0, 3.0)]).signal("force_y_n"), 0.0, atol=1e-12
    )


def holed() -> RunLog:
    """A straight line with a gap of 0.02 s after 2 s and NaN from 4 to 4.01 s; a state that changes
    in the gap.
    """
    lost = (TIMES > 2.0) & (TIMES < 2.02 - 1e-9)
    table = {"force_y_n": 3.0 * TIMES, "planned_turn": (TIMES > 2.01).astype(float)}
    table["force_y_n"] = np.where((TIMES >= 4.0) & (TIMES <= 4.01), np.nan, table["force_y_n"])
    return rig_log({name: values[~lost] for name, values in table.items()}, TIMES[~lost])


def test_fill_draws_straight_lines_and_holds_states() -> None:
    done = fill_gaps(holed(), 0.05)
    assert np.allclose(done.time, TIMES)
    assert np.allclose(done.signal("force_y_n"), 3.0 * TIMES)
    assert done.signal("planned_turn")[(TIMES > 2.0) & (TIMES < 2.019)].tolist() == [0.0] * 9
    assert conditioning_notes(done) == [
        "gap of 0.02 s at 2 s filled with 9 rows",
        "6 lost sample(s) of force_y_n filled, the first at 4 s",
    ]
    assert conditioning_notes(fill_gaps(done, 0.05)) == conditioning_notes(done)


def test_fill_refuses_what_is_too_long_or_at_an_end() -> None:
    with pytest.raises(
        LogError, match=r"rig\.parquet: column 'time_s': 1 gap\(s\), the first of 0\.02 s after 2 s"
    ):
        fill_gaps(holed(), 0.015)
    lost = rig_log({"force_y_n": np.where((TIMES > 4) & (TIMES < 5), np.nan, 1.0)})
    with pytest.raises(
        LogError,
        match=r"column 'force_y_n': no numbers for 1 s after 4 s; at most 0\.5 s is filled",
    ):
        fill_gaps(lost, 0.5)
    with pytest.raises(
        LogError, match=r"column 'force_y_n': not a number at 0 s, with no sample on both sides"
    ):
        fill_gaps(rig_log({"force_y_n": np.where(TIMES < 1, np.nan, 1.0)}), 5.0)


def test_a_filter_shifts_nothing_and_takes_the_mains_out() -> None:
    clean = np.sin(2 * np.pi * 0.5 * TIMES)
    done = low_pass_columns(
        rig_log({"force_y_n": clean + 0.3 * np.sin(2 * np.pi * 50 * TIMES)}),
        ["force_y_n"],
        RIG_FILTER,
    )
    middle = (TIMES > 1) & (TIMES < 9)
    assert np.max(np.abs(done.signal("force_y_n") - clean)[middle]) < 1e-4


@pytest.mark.parametrize(
    ("run_log", "message"),
    [
        (
            rig_log({"force_y_n": 0.0}, TIMES[:3]),
            r"rig\.parquet: column 'force_y_n': 3 samples are too few",
        ),
        (
            rig_log({"force_y_n": np.nan}),
            r"column 'force_y_n': 5001 sample\(s\) not finite, first nan at 0 s",
        ),
        (
            rig_log({"force_y_n": 0.0}, TIMES[::-1].copy()),
            r"not increasing in row 1, 9\.998 s after 10 s",
        ),
        (rig_log(), r"force_y_n"),
        (holed(), r"column 'time_s': 1 gap\(s\), the first of 0\.02 s after 2 s"),
    ],
)
def test_a_filter_that_cannot_work_names_column_and_time(run_log: RunLog, message: str) -> None:
    with pytest.raises(LogError, match=message):
        low_pass_columns(run_log, ["force_y_n"], RIG_FILTER)


def test_a_constant_signal_is_filtered_to_itself() -> None:
    done = low_pass_columns(rig_log({"force_y_n": 2.0}), ["force_y_n"], LowPass(2, 5.0))
    assert np.allclose(done.signal("force_y_n"), 2.0, atol=1e-12)
    assert conditioning_notes(done) == ["low pass (order 2, 5 Hz, forwards and back): force_y_n"]
