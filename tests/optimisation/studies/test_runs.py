"""Workers give what a serial loop gives; a run that kills its worker is reported and takes nothing
with it.
"""

from dataclasses import replace

import pytest

from aerodima.optimisation.studies import runs as engine_module
from aerodima.optimisation.studies.runs import (
    WORKER_LOST,
    CachedRunner,
    RunTask,
    evaluate,
    open_run_engine,
    run_key,
    scenario_content,
)
from aerodima.workbench.batch import dask_cluster
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import read_swing, write_swing
from tests.optimisation.studies.tiny import POISON, TINY_SETTINGS, evaluate_or_die
from tests.refusals import assert_named, assert_refused


def tasks(number, *settings):
    speeds = [f"manoeuvre.speed={1.0 + 0.1 * place!r}" for place in range(number)]
    return [
        RunTask(f"{place}", "straight", (*TINY_SETTINGS, speed, *settings))
        for place, speed in enumerate(speeds)
    ]


def test_row_has_outcome_metrics_and_provenance_and_nothing_that_changes():
    (task,) = tasks(1)
    row = evaluate(task)
    assert (row["outcome"], row["clean"], row["error"], row["run"]) == ("survived", True, "", "0")
    assert row["commanded_speed_m_per_s"] == 1.0
    assert len(row["scenario_sha256"]) == 64
    assert row["version_drake"]
    assert evaluate(task) == row


def test_an_old_log_is_not_taken_for_that_of_a_run(tmp_path):
    rows = [evaluate(replace(task, log=str(tmp_path / "run.parquet"))) for task in tasks(2)]
    assert [row["commanded_speed_m_per_s"] for row in rows] == [1.0, 1.1]


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("car.mass=-1", ("car.mass", "-1")),
        ("car.mass=1.3", ("car.mass", "1.3 kg")),
        ("tail.sail_length=1.2", ("tail.sail_length", "1.2 m")),
        ("manoeuvre.duration=0.001", ("1 sample",)),
    ],
)
def test_impossible_run_is_a_row_with_one_line_of_error(setting, named):
    (task,) = tasks(1, setting)
    row = evaluate(task)
    assert row["outcome"] is None
    assert "\n" not in row["error"]
    assert row["settings"].endswith(setting)
    assert_named(row["error"], named)


@pytest.mark.parametrize(
    ("error", "law", "raised"),
    [
        (ArithmeticError("a\nb"), "", False),
        (RuntimeError("solver"), "", False),
        (KeyError("mistake"), "", True),
        (KeyError("gain"), "my_law.py:Mine", False),
    ],
)
def test_a_mistake_of_the_programme_is_raised_and_one_in_a_law_is_a_row(
    monkeypatch, error, law, raised
):
    def failing(*_):
        raise error

    monkeypatch.setattr(engine_module, "_measured", failing)
    task = replace(tasks(1)[0], law=law)
    if raised:
        with pytest.raises(KeyError):
            evaluate(task)
        return
    error = evaluate(task)["error"]
    assert error
    assert "\n" not in error


@pytest.mark.slow
def test_workers_give_the_rows_of_a_serial_loop_in_order(engine):
    work = [*tasks(4), RunTask("bad", "straight", ("car.mass=-1",))]
    finished = []
    rows = CachedRunner(engine, progress=finished.append).rows(work)
    assert rows == CachedRunner().rows(work)
    assert [line.split()[1] for line in finished] == ["1/5", "2/5", "3/5", "4/5", "5/5"]
    assert engine.workers == 2
    assert engine.startup > 0.0


@pytest.mark.slow
def test_run_that_kills_its_worker_is_a_row_with_an_error_and_its_neighbours_are_there(
    engine, monkeypatch
):
    monkeypatch.setattr(engine_module, "evaluate", evaluate_or_die)
    work = tasks(6)
    rows = CachedRunner(engine).rows([*work[:2], RunTask(POISON, "straight"), *work[3:]])
    assert [row["run"] for row in rows] == ["0", "1", POISON, "3", "4", "5"]
    lost = rows.pop(2)
    assert lost["outcome"] is None
    assert lost["error"].startswith(WORKER_LOST)
    assert rows == [evaluate(task) for task in work if task.name != "2"]


@pytest.mark.parametrize(
    ("workers", "scheduler", "named"),
    [
        (2, "tcp://127.0.0.1:1", ("--scheduler", "tcp://127.0.0.1:1")),
        (2, "nonsense:/", ("--scheduler", "nonsense:")),
    ],
)
def test_wrong_number_of_workers_and_absent_scheduler_are_refused(
    monkeypatch, workers, scheduler, named
):
    monkeypatch.setattr(dask_cluster, "CONNECT_TIMEOUT", 0.5)
    assert_refused(lambda: open_run_engine(workers, scheduler).__enter__(), UserError, *named)


def test_the_key_of_a_run_follows_all_that_determines_its_row(tmp_path, monkeypatch):
    scenario = tmp_path / "turn.yaml"
    law = tmp_path / "law.py"
    scenario.write_text("schema: aerodima/scenario/1\nname: mine\n")
    law.write_text("class Mine: pass\nclass Other: pass\n")
    thesis = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    swing = write_swing(thesis, tmp_path / "swing.yaml")
    base = RunTask("", str(scenario), (f"controller.swing_file={swing}",), law=f"{law}:Mine")
    changes = [
        {},
        {"settings": (*base.settings, "car.mass=6.5")},
        {"signals": "all"},
        {"law": ""},
        {"law": f"{law}:Other"},
        {"scenario": "turn_fast"},
    ]
    keys = [run_key(replace(base, **change)) for change in changes]
    assert run_key(replace(base, name="other", log="kept.parquet")) == keys[0]
    law.write_text("class Mine: gain = 2\nclass Other: pass\n")
    keys.append(run_key(base))
    scenario.write_text("schema: aerodima/scenario/1\nname: mine\ncar: {mass: 6.6}\n")
    keys.append(run_key(base))
    limits = thesis.limits.model_copy(update={"velocity_rad_per_s": 9.0})
    write_swing(thesis.model_copy(update={"limits": limits}), swing, force=True)
    keys.append(run_key(base))
    monkeypatch.setattr(engine_module, "software_versions", lambda: {"project": "0.0.0"})
    keys.append(run_key(base))
    assert len(set(keys)) == len(keys), keys


WING = """
schema: aerodima/bodies/1
bodies:
- {name: wing, root: [0, -0.15, 0.25], axes: [[0, 1, 0]], lengths: [0.3], chords: [0.1, 0.1],
   normal: [0, 0, 1], density: 0.8, coefficients: POLAR}
"""


def test_the_key_follows_the_files_of_tail_bodies_and_coefficients(tmp_path):
    tail, polar, wing, wing_polar = (tmp_path / f"{name}.yaml" for name in "abcd")
    for path in (tail, polar, wing_polar):
        path.write_text("name: own")
    wing.write_text(WING.replace("POLAR", str(wing_polar)))
    files = f"tail.geometry={tail}", f"tail.coefficients={polar}", f"car.bodies={wing}"
    task = RunTask("", "turn_swing", ("tail.sail=locked", *files))
    keys = [run_key(task)]
    for path in (tail, polar, wing, wing_polar):
        path.write_text(f"{path.read_text()}\n# edited")
        keys.append(run_key(task))
    assert len(set(keys)) == 5
    # Keys of rows that were stored before know no such files.
    assert scenario_content("turn_swing") == [load_scenario("turn_swing").resolved(), ""]


class Losing(Engine):
    """Loses every run with its worker."""

    def map(self, work, items, done=None, lost=None):
        for index, item in enumerate(items):
            done(index, lost(item))


def test_a_run_that_was_lost_with_its_worker_is_made_by_the_next_command(tmp_path):
    work = tasks(1)
    with RowStore(tmp_path / "rows.jsonl", {}) as store:
        runs = CachedRunner(Losing(), store)
        (lost,) = runs.rows(work)
        assert lost["error"] == WORKER_LOST
        assert runs.rows(work) == [lost]
        assert (runs.ran, store.rows) == (1, {})
    with RowStore(tmp_path / "rows.jsonl", {}) as store:
        (row,) = CachedRunner(store=store).rows(work)
    assert row["outcome"] == "survived"


def test_a_run_of_two_names_is_made_once_and_a_kept_one_not_again(monkeypatch):
    made = []

    def made_up(task):
        made.append(task.settings)
        return {"run": task.name, "outcome": "survived", "error": ""}

    monkeypatch.setattr(engine_module, "evaluate", made_up)
    (one,) = tasks(1)
    runs = CachedRunner()
    rows = runs.rows([one, replace(one, name="twin")])
    assert [row["run"] for row in rows] == ["0", "twin"]
    runs.rows([replace(one, name="later"), replace(one, signals="all")])
    assert len(made) == runs.ran == 2
