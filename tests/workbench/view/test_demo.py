"""The demo: every number again from its logs, going on after Ctrl-C, and folders that are not its
own.
"""

import csv
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest

from aerodima.workbench.car.tail_impulses import tail_impulses
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.published_values import flip_bracket
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.view.demo import DemoPlan, demo_runs, make_demo
from tests.commands import refused
from tests.refusals import assert_refused

pytestmark = pytest.mark.slow

PLAN = DemoPlan(
    turns=tuple((mode, speed / 3.6) for mode in ("none", "swing") for speed in (12, 16)),
    shown=(("swing", 16 / 3.6),),
    opening=False,
)
NAMES = ("none_3.33", "none_4.44", "swing_3.33", "swing_4.44")


class Made(NamedTuple):
    """A demo that was interrupted after its first run and then asked for again."""

    out: Path
    first_log_when_interrupted: int
    messages: list[str]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "out"
    messages = []

    def interrupt(line):
        messages.append(line)
        if "] 1/4 " in line:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_demo(out, PLAN, workers=1, progress=interrupt)
    (log,) = (out / "logs").glob("*.parquet")
    changed = log.stat().st_mtime_ns
    # The next run as a killed process leaves it: a journal that would be in the way of a new one.
    (out / "logs" / "turn_none_3.33.parquet.journal").write_bytes(b"cut off")
    make_demo(out, PLAN, workers=1, progress=messages.append)
    return Made(out, changed, messages)


@pytest.fixture(scope="module")
def rows(made):
    with (made.out / "summary.csv").open(encoding="utf-8") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


@pytest.fixture
def unfinished(made, tmp_path):
    """As an interruption before the last step leaves it."""
    out = shutil.copytree(made.out, tmp_path / "out")
    mark = out / "demo.json"
    mark.write_text(mark.read_text().splitlines(keepends=True)[0])
    return out


def test_everything_is_there_and_the_page_links_only_to_it(made):
    found = {
        path.relative_to(made.out).as_posix() for path in made.out.rglob("*") if path.is_file()
    }
    assert found == {
        "index.html",
        "summary.csv",
        "demo.json",
        "replay_swing_4.44.html",
        *(f"logs/turn_{name}.parquet" for name in NAMES),
    }
    page = (made.out / "index.html").read_text(encoding="utf-8")
    for name in found - {"index.html", "demo.json"}:
        assert f'"{name}"' in page, name


def test_ctrl_c_keeps_finished_runs_and_says_how_to_go_on(made):
    (stopped,) = [line for line in made.messages if line.startswith("stopped")]
    assert "1 of 4" in stopped
    log = (
        made.out / "logs" / "turn_swing_4.44.parquet"
    )  # shown in full, so it is the first piece of work
    assert log.stat().st_mtime_ns == made.first_log_when_interrupted


@pytest.mark.parametrize("name", NAMES)
def test_every_metric_is_computed_again_from_the_log(made, rows, name):
    row = rows[name]
    log = read_run_log(made.out / "logs" / f"turn_{name}.parquet")
    for column, value in metrics_of(log).as_row().items():
        expected = "" if value is None else str(value)
        assert row[column] == expected, column
    impulses = tail_impulses(log)
    for cause in ("aerodynamic", "weight", "inertial"):
        cell = row[f"{cause}_impulse_window_n_m_s"]
        assert cell == "" if impulses is None else float(cell) == getattr(impulses, cause)


def test_a_finished_demo_is_kept(made):
    before = {path: path.stat().st_mtime_ns for path in made.out.rglob("*")}
    work = partial(make_demo, made.out, PLAN, workers=1)
    assert_refused(work, UserError, str(made.out), "--force")
    assert {path: path.stat().st_mtime_ns for path in made.out.rglob("*")} == before


@pytest.mark.parametrize("changed", [{"seed": 2}, {"turns": (("none", 3.0),)}])
def test_logs_of_another_demo_are_not_mixed_in(unfinished, changed):
    work = partial(make_demo, unfinished, replace(PLAN, **changed), workers=1)
    assert_refused(work, UserError, "out")


def test_a_damaged_log_is_named(unfinished):
    (unfinished / "logs" / "turn_none_3.33.parquet").write_bytes(b"PAR1")
    named = ("turn_none_3.33.parquet", "--force")
    assert_refused(partial(make_demo, unfinished, PLAN, workers=1), UserError, *named)


def test_force_makes_again_and_leaves_foreign_files(tmp_path):
    out = tmp_path / "out"
    (out / "logs").mkdir(parents=True)
    (out / "notes.txt").write_text("mine")
    old = out / "logs" / "turn_none_3.33.parquet"
    old.write_text("old")

    def interrupt(line):
        if line.startswith("1 runs"):  # before the first run: the old log is gone, the note is not
            raise KeyboardInterrupt

    plan = DemoPlan(turns=(("none", 12 / 3.6),), shown=(), opening=False)
    with pytest.raises(KeyboardInterrupt):
        make_demo(out, plan, workers=1, force=True, progress=interrupt)
    assert not old.exists()
    assert (out / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("arrange", "flags", "named"),
    [
        ("foreign", [], "notes.txt"),
        ("file", [], "out"),
        ("file", ["--force"], "out"),
        ("file above", [], "out"),
        ("nothing", ["--workers", "0"], "--workers 0"),
        ("nothing", ["--seed", "-1"], "seed"),
    ],
)
def test_wrong_input_is_one_line_and_changes_nothing(tmp_path, arrange, flags, named):
    out = tmp_path / "out"
    if arrange == "foreign":
        out.mkdir()
        (out / "notes.txt").write_text("mine")
    elif arrange.startswith("file"):
        out.write_text("mine")
    target = out / "demo" if arrange == "file above" else out
    before = sorted(tmp_path.rglob("*"))
    assert named in refused("demo", "--out", target, *flags)
    assert sorted(tmp_path.rglob("*")) == before


def test_the_plan_of_the_command_has_both_sides_of_the_published_flips():
    # Thesis 7.1, speeds in whole km/h (ERRATA E37): without tail 3.33 and 3.61 m/s, swung 4.44 and
    # 4.72 m/s.
    runs = [run for run in demo_runs(Path("out"), DemoPlan()) if not run.opening]
    brackets = {"none": flip_bracket("tailless"), "swing": flip_bracket("tailed")}
    both = [
        (mode, speed) for mode, one in brackets.items() for speed in (one.survived, one.flipped)
    ]
    assert sorted(run.name for run in runs) == sorted(f"{mode}_{speed:.2f}" for mode, speed in both)
    assert {run.name for run in runs if run.replay is not None} == {"none_3.61", "swing_4.44"}
