"""The example "On the car" of `workbench/aero/README.md`, as it stands there, and the figures
beside it.
"""

import re
import shlex
from pathlib import Path

import pytest

from aerodima.workbench import aero
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from tests.certain_cars import HIGH_CAR
from tests.commands import done

SECTION = (
    (Path(aero.__file__).parent / "README.md")
    .read_text(encoding="utf-8")
    .split("## On the car\n")[1]
)


def block(language):
    found = re.search(rf"```{language}\n(.*?)```", SECTION, flags=re.DOTALL)
    assert found
    return found.group(1)


@pytest.mark.slow
def test_example_on_the_car_runs_and_gives_what_it_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in block("sh").splitlines():
        program, *words = shlex.split(line)
        assert program == "aerodima"
        done(*words)
    names = {}
    exec(block("python"), names)
    line = names["line"]
    wind = names["wind"]
    assert line.extra["sections_outside_measured_range"] == pytest.approx(0.52, abs=0.01)
    assert line.extra["largest_reynolds_number"] == pytest.approx(29_400, rel=0.03)
    assert wind.vector("wind", "truth_m_per_s").shape == (2001, 3)
    assert metrics_of(read_run_log("free.parquet")).outcome.result == "survived"
    free, facing = (
        metrics_of(simulate(load_scenario("turn_swing", [*HIGH_CAR, f"tail.sail={sail}"])))
        for sail in ("free", "facing")
    )
    assert free.heading_change_rad == pytest.approx(facing.heading_change_rad, rel=0.02)
    assert free.peak_roll_rad == pytest.approx(facing.peak_roll_rad, rel=0.05)
