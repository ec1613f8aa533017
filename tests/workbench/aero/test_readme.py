"""The example "On the car" of `workbench/aero/README.md`, as it stands there, and the figures beside it."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import workbench.aero
from workbench.cli import build_app
from workbench.logs.schema import read_run_log
from workbench.metrics import metrics_of

SECTION = (Path(workbench.aero.__file__).parent / "README.md").read_text(encoding="utf-8").split("## On the car\n")[1]


def block(language):
    found = re.search(rf"```{language}\n(.*?)```", SECTION, flags=re.DOTALL)
    assert found
    return found.group(1)


def side_force(run):
    """Largest force of the air across the first heading while the tail swings, N."""
    swinging = (run.time > 2.0) & (run.time < 2.7)
    return np.abs(run.signal("tail_force_y_truth_n")[swinging]).max()


def test_example_on_the_car_runs_and_gives_what_it_says(tmp_path, monkeypatch, standard_runs):
    monkeypatch.chdir(tmp_path)
    app = build_app()
    for line in block("sh").splitlines():
        program, *words = shlex.split(line)
        assert program == "aerodima"
        result = CliRunner().invoke(app, words, catch_exceptions=False)
        assert result.exit_code == 0, result.output
    names = {}
    exec(block("python"), names)
    line, wind = names["line"], names["wind"]
    assert line.extra["sections_outside_measured_range"] == pytest.approx(0.31, abs=0.01)
    assert line.extra["largest_reynolds_number"] == pytest.approx(98_000, rel=0.01)
    assert wind.vector("wind", "truth_m_per_s").shape == (2001, 3)
    free, locked = read_run_log("free.parquet"), standard_runs["swing"]
    # Degrees as printed; both ends of the supported versions of Drake agree to a few tenths.
    assert np.degrees(metrics_of(free).peak_roll_rad) == pytest.approx(6.3, abs=0.4)
    assert np.degrees(metrics_of(locked).peak_roll_rad) == pytest.approx(4.8, abs=0.4)
    assert side_force(free) == pytest.approx(1.1, abs=0.1)
    assert side_force(locked) == pytest.approx(3.4, abs=0.2)
