"""Rows of the summary: published figures beside the runs that the thesis made, differences, units."""

import csv
from pathlib import Path

import pytest

from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.run_summary import published_for, summarise, summary_row, tail_mode_of, write_summary
from tests.workbench.made_up_runs import made_up_run, times
from tests.workbench.made_up_summaries import made_up_summary


def test_swing_times_come_from_the_state_of_the_controller() -> None:
    state = 1.0 + 2.0 * ((times() >= 2.2) & (times() < 2.5))  # 3 is SWING, 1 is HOLD
    summary = summarise(made_up_run({"controller_state": state}), "run")
    assert summary.trigger_time == pytest.approx(2.2)
    assert summary.swing_end_time == pytest.approx(2.498)  # the last row in which it still swings
    never = summarise(made_up_run(), "run")
    assert (never.trigger_time, never.swing_end_time) == (None, None)


def test_a_swing_that_the_log_cuts_off_has_no_end() -> None:
    summary = summarise(made_up_run({"controller_state": 3.0 * (times() >= 3.0)}), "run")
    assert summary.trigger_time == pytest.approx(3.0)
    assert summary.swing_end_time is None


@pytest.mark.parametrize(("direction", "sign"), [("left", 1.0), ("right", -1.0)])
def test_peak_of_the_gyro_counts_into_the_turn(direction: str, sign: float) -> None:
    # Into the turn 0.8 rad/s within the window, out of it 2 rad/s, and 5 rad/s after the window.
    gyro = sign * (0.8 * (times() < 2.3) - 2.0 * ((times() >= 2.3) & (times() < 2.6)) + 5.0 * (times() > 2.7))
    summary = summarise(made_up_run({"imu_gyro_z_rad_per_s": gyro}, direction=direction), "run")
    assert summary.peak_gyro == pytest.approx(0.8)


def test_only_the_runs_of_the_thesis_have_published_figures() -> None:
    # Commanded 12 km/h without tail: Tables 7.1 and 7.3; 16 km/h with the swing: Table 7.2.
    sources = {
        (mode, whole): {row.source for row in published_for(made_up_summary(mode, whole / 3.6)).values()}
        for mode in ("none", "held", "swing")
        for whole in range(12, 19)
    }
    assert sources.pop(("none", 12)) == {"Table 7.1", "Table 7.3"}
    assert sources.pop(("swing", 16)) == {"Table 7.2"}
    assert not any(sources.values())
    assert published_for(made_up_summary("none", 3.33))  # as the thesis rounds it
    assert not published_for(made_up_summary("none", 3.40))


def test_a_swing_from_a_file_is_a_mode_of_its_own_and_has_no_published_figures() -> None:
    played = {"swing_file": "thesis_8_rad_per_s"}
    assert tail_mode_of({"tail": {"mode": "swing"}, "controller": played}) == "optimised"
    assert tail_mode_of({"tail": {"mode": "swing", "name": "mine"}}) == "designed"
    assert tail_mode_of({"tail": {"mode": "held"}, "controller": played}) == "held"
    assert tail_mode_of({"tail": {"mode": "swing"}, "controller": {"swing_file": "none"}}) == "swing"
    assert not published_for(made_up_summary("optimised", 16 / 3.6))


def test_a_difference_is_the_raw_metric_less_the_published_figure() -> None:
    row = summary_row(made_up_summary("none", 12 / 3.6, raw={"max_yaw_rate_rad_per_s": 2.50}))
    assert row["published_simulated_max_yaw_rate_rad_per_s"] == 2.17  # Table 7.1
    assert row["difference_simulated_max_yaw_rate_rad_per_s"] == pytest.approx(0.33)
    assert row["published_physical_max_yaw_rate_rad_per_s"] == 1.91  # Table 7.3
    assert row["difference_physical_max_yaw_rate_rad_per_s"] == pytest.approx(0.59)
    empty = summary_row(made_up_summary("held", 12 / 3.6))
    assert all(empty[name] is None for name in empty if name.startswith(("published_", "difference_")))


def test_numbers_survive_the_file_bit_for_bit_and_absent_ones_are_empty(tmp_path: Path) -> None:
    run = made_up_summary("none", 10 / 3.0)
    (read,) = csv.DictReader(write_summary([run], tmp_path / "s.csv").open(encoding="utf-8"))
    assert float(read["commanded_speed_m_per_s"]) == 10 / 3.0
    assert read["clean"] == "true"
    assert read["swing_trigger_time_s"] == read["aerodynamic_impulse_window_n_m_s"] == ""


def test_every_number_has_its_unit_at_the_end_of_the_column() -> None:
    units = ("_m_per_s", "_km_per_h", "_rad", "_rad_per_s", "_m_per_s2", "_s", "_j", "_n", "_n_m", "_n_m_s")
    row = summary_row(made_up_summary("swing", 16 / 3.6, trigger=2.2))
    assert [name for name, value in row.items() if type(value) is float and not name.endswith(units)] == []


def test_an_existing_table_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text("mine")
    with pytest.raises(UserError, match=r"s\.csv: exists already"):
        write_summary([made_up_summary()], path)
    assert path.read_text() == "mine"
