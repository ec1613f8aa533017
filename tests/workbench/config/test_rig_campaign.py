"""Campaigns on the rig: what they contain, going on after a cut, killed workers, wrong files."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aerodima.workbench.config.checked_files import shipped_names
from aerodima.workbench.config.rig_campaign import campaign_tasks, load_campaign
from aerodima.workbench.errors import ScenarioError, UserError
from aerodima.workbench.logs.schema import read_run_log, signals_equal
from aerodima.workbench.simulate.campaign_run import _make, run_campaign

SHORT = ["experiment.duration=0.3", "experiment.wind_off=0.1"]
SMALL = """\
schema: aerodima/rig-campaign/1
name: small
scenario: static
set: [aero.source=constant]
grid:
  experiment.angle: {values: [0, 75], unit: deg, source: chosen, reason: "test"}
repeats: {value: 2, unit: "1", source: chosen, reason: "test"}
draw:
  tunnel.psi3: {low: -0.1, high: 0.1, unit: rad, source: chosen, reason: "test"}
scatter:
  experiment.angle: {low: 0.1, high: 0.2, unit: deg, source: chosen, reason: "test"}
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


def test_the_campaigns_that_ship_have_the_published_number_of_logs() -> None:
    counts = {name: len(campaign_tasks(load_campaign(name))) for name in shipped_names("campaigns")}
    # 3 tails x 2 axes x 6 angles x 3 speeds x 5 repeats; 30 swings of the robot's tail.
    assert counts == {"static": 540, "robot": 30, "bar": 120, "flick": 120}
    tasks = campaign_tasks(load_campaign("static"))
    assert len({task.name for task in tasks}) == len({task.scenario.seed for task in tasks}) == 540


def test_draws_lie_within_their_limits_and_scatter_adds_to_the_grid(small: Path) -> None:
    tasks = campaign_tasks(load_campaign(small), seed=3, repeats=20)
    psi = [task.scenario.tunnel.psi3 for task in tasks]
    assert -0.1 <= min(psi) < -0.05
    assert 0.05 < max(psi) <= 0.1
    for task, degrees in zip(tasks, [0.0] * 20 + [75.0] * 20, strict=True):
        assert 0.1 <= math.degrees(task.scenario.experiment.angle) - degrees <= 0.2
    assert tasks[0].name == "angle_0_no_1"
    again = campaign_tasks(load_campaign(small), seed=3, repeats=20)
    assert again == tasks
    assert campaign_tasks(load_campaign(small), seed=4, repeats=20)[0].scenario.seed != tasks[0].scenario.seed


def test_a_second_call_makes_only_what_is_missing_and_the_same(small: Path, tmp_path: Path) -> None:
    tasks, out = campaign_tasks(load_campaign(small), settings=SHORT), tmp_path / "logs"
    first = run_campaign(tasks, out, workers=1)
    assert (len(first.logs), first.failed, first.reused) == (4, {}, 0)
    before = read_run_log(first.logs[2])
    assert set(before.extra["truth"]) == {"cd", "cl", "psi3", "current"}
    assert before.extra["truth"]["psi3"] == tasks[2].scenario.tunnel.psi3
    first.logs[2].unlink()
    told: list[str] = []
    second = run_campaign(tasks, out, workers=1, progress=told.append)
    assert second.reused == 3
    assert [line.split("]")[1].split()[0] for line in told] == ["4/4"]
    assert signals_equal(read_run_log(second.logs[2]), before)
    with pytest.raises(UserError, match="of other parameters, settings or versions"):
        run_campaign(campaign_tasks(load_campaign(small), seed=2, settings=SHORT), out, workers=1)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    with pytest.raises(UserError, match=r"holds other files \(thesis.tex\)"):
        run_campaign(tasks, tmp_path / "full", workers=1)


def test_a_log_that_was_written_before_its_worker_died_counts_as_made(small: Path, tmp_path: Path) -> None:
    (task, *_) = campaign_tasks(load_campaign(small), settings=SHORT)
    assert _make(tmp_path, task) == _make(tmp_path, task) == (task.name, "")


def test_a_log_that_cannot_be_made_is_told_and_the_others_are_done(small: Path, tmp_path: Path) -> None:
    tasks = campaign_tasks(load_campaign(small), repeats=1, settings=[*SHORT, "maxon.current_limit=2.3"])
    result = run_campaign(tasks, tmp_path / "logs", workers=1)
    assert list(result.failed) == ["angle_0_no_1"]
    assert "A; allowed: within +-2.3 A" in result.failed["angle_0_no_1"]
    assert [log.stem for log in result.logs] == ["angle_75_no_1"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("experiment.angle: {values", "experiment.angel: {values", "no such key of a rig scenario; did you mean"),
        ('unit: deg, source: chosen, reason: "test"}\nrep', 'unit: N, source: chosen, reason: "t"}\nrep', "unit 'N'"),
        ("values: [0, 75]", "values: []", "grid.experiment.angle.values"),
        ("low: -0.1, high: 0.1", "low: 0.1, high: -0.1", "low 0.1 is above high -0.1"),
        ("low: -0.1", "low: .nan", "finite"),
        ("value: 2", "value: 0", "greater than or equal to 1"),
        ("schema: aerodima/rig-campaign/1", "schema: aerodima/rig-campaign/9", "schema"),
        ("name: small", "names: small", "unknown key; did you mean 'name'"),
        (', reason: "test"}\nscatter', "}\nscatter", "needs a reason"),
    ],
)
def test_a_wrong_campaign_file_is_refused_with_its_place(small: Path, old: str, new: str, message: str) -> None:
    assert old in SMALL
    small.write_text(SMALL.replace(old, new))
    with pytest.raises(ScenarioError, match=message) as caught:
        load_campaign(small)
    assert str(caught.value).startswith(str(small))


def test_values_out_of_range_and_unknown_names_are_refused(small: Path) -> None:
    with pytest.raises(ScenarioError, match=r"campaign 'statik': .*; did you mean 'static'"):
        load_campaign("statik")
    small.write_text(SMALL.replace("[0, 75]", "[0, 400]"))
    with pytest.raises(ScenarioError, match=r"experiment\.angle: 6\.98"):
        campaign_tasks(load_campaign(small))
    with pytest.raises(ScenarioError, match="allowed: 1 to 10000 logs"):
        campaign_tasks(load_campaign("static"), repeats=1000)


def _workers_of(pid: int) -> list[int]:
    """Spawned worker processes of a process."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            command = (folder / "cmdline").read_text()
        except OSError:
            continue
        if parent == pid and "spawn_main" in command:
            found.append(int(folder.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the worker processes in /proc")
def test_a_killed_worker_does_not_stop_the_campaign(small: Path, tmp_path: Path) -> None:
    out = tmp_path / "logs"
    command = [
        sys.executable,
        "-m",
        "aerodima.workbench.cli.program",
        "rig",
        "campaign",
        str(small),
        "--repeats",
        "4",
        "--out",
        str(out),
    ]
    process = subprocess.Popen([*command, "--set", "experiment.duration=20"], stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120.0
    while len(list(out.glob("*.parquet"))) < 2 and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    (victim, *_) = _workers_of(process.pid)
    os.kill(victim, signal.SIGKILL)
    output, _ = process.communicate(timeout=180)
    assert process.returncode == 0
    assert "8 logs in" in output
    assert len(list(out.glob("*.parquet"))) == 8
