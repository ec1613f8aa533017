"""`aerodima run` with a free sail and with a coefficient table, from the run to its pictures."""

import re

import pytest

from aerodima.workbench.logs.schema import read_run_log

SETTINGS = "manoeuvre.turn_start=0.4 manoeuvre.speed_ramp=0.3 manoeuvre.duration=1.2"
SHORT = tuple(word for setting in SETTINGS.split() for word in ("--set", setting))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["turn_swing_free_sail", "turn_swing_wind"])
def test_shipped_scenario_goes_from_run_to_replay_and_strip(call, tmp_path, scenario):
    log, page, strip = (tmp_path / f"run.{ending}" for ending in ("parquet", "html", "png"))
    words = ["run", scenario, "--speed", 1.5, *SHORT, "--out", log, "--html", page]
    result = call(*words)
    assert result.exit_code == 0, result.output
    assert "largest_reynolds_number" in result.stdout
    assert page.stat().st_size > 100_000
    assert call("replay", log, "--strip", strip).exit_code == 0
    assert strip.read_bytes().startswith(b"\x89PNG")
    run = read_run_log(log)
    assert ("plant_position_tail_tail_sail_turn_q" in run.table.columns) == (
        run.scenario["tail"]["sail"] == "free"
    )
    assert ("wind_x_truth_m_per_s" in run.table.columns) == (scenario == "turn_swing_wind")


@pytest.mark.slow
def test_turn_says_when_a_table_was_left(call):
    left = call(
        "run", "turn_swing", "--speed", 1.0, *SHORT, "--set", "tail.coefficients=robot_tail_line"
    )
    assert re.search(r"sections_outside_measured_range +0\.\d\d", left.stdout)
    constant = call("run", "turn_swing", "--speed", 1.0, *SHORT)
    assert re.search(r"sections_outside_measured_range +0$", constant.stdout, re.MULTILINE)
    assert (
        "sections_outside"
        not in call("run", "turn_swing", "--speed", 1.0, "--tail", "none", *SHORT).stdout
    )


def test_settings_of_the_air_are_refused_in_one_line(refused):
    assert "'robot_tail_line'" in refused(
        "run", "turn_swing", "--set", "tail.coefficients=robot_tail_lime"
    )
    assert "tail.added_mass" in refused("run", "turn_swing", "--set", "tail.added_mass=-0.1")
    assert "'winds'" in refused("run", "turn_swing", "--set", "winds.mean_x=1")
