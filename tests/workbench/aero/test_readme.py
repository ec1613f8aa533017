"""The example "On the car" of `workbench/aero/README.md`, as it stands there, and the figures
beside it.
"""

import re
import shlex
from pathlib import Path

import pytest

from aerodima.workbench import aero
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
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
def test_example_on_the_car_runs_and_gives_what_it_says(tmp_path, monkeypatch, standard_runs):
    monkeypatch.chdir(tmp_path)
    for line in block("sh").splitlines():
        program, *words = shlex.split(line)
        assert program == "aerodima"
        done(*words)
    names = {}
    exec(block("python"), names)
    line = names["line"]
    wind = names["wind"]
    assert line.extra["sections_outside_measured_range"] == pytest.approx(0.42, abs=0.01)
    assert line.extra["largest_reynolds_number"] == pytest.approx(15_700, rel=0.03)
    assert wind.vector("wind", "truth_m_per_s").shape == (2001, 3)
    free = metrics_of(read_run_log("free.parquet"))
    facing = metrics_of(standard_runs["swing"])
    assert free.heading_change_rad == pytest.approx(facing.heading_change_rad, rel=0.02)
    assert free.peak_roll_rad == pytest.approx(facing.peak_roll_rad, rel=0.05)
