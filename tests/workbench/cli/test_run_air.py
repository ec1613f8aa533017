"""`aerodima run` with a free sail and with a coefficient table, from the run to its pictures."""

import re

import pytest

from aerodima.workbench.logs.schema import read_run_log
from tests.commands import SHORT, done


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["turn_swing_free_sail", "turn_swing_wind"])
def test_shipped_scenario_goes_from_run_to_replay_and_strip(tmp_path, scenario):
    log, page, strip = (tmp_path / f"run.{ending}" for ending in ("parquet", "html", "png"))
    told = done("run", scenario, "--speed", 1.5, *SHORT, "--out", log, "--html", page)
    assert "largest_reynolds_number" in told
    assert page.stat().st_size > 100_000
    done("replay", log, "--strip", strip)
    assert strip.read_bytes().startswith(b"\x89PNG")
    run = read_run_log(log)
    assert ("plant_position_tail_tail_sail_turn_q" in run.table.columns) == (
        run.scenario["tail"]["sail"] == "free"
    )
    assert ("wind_x_truth_m_per_s" in run.table.columns) == (scenario == "turn_swing_wind")


@pytest.mark.slow
def test_turn_says_when_a_table_was_left():
    words = ("run", "turn_swing", "--speed", 1.0, *SHORT)
    left = done(*words, "--set", "tail.coefficients=robot_tail_line")
    assert re.search(r"sections_outside_measured_range +0\.\d\d", left)
    assert re.search(r"sections_outside_measured_range +0\n", done(*words))
    assert "sections_outside" not in done(*words, "--tail", "none")
