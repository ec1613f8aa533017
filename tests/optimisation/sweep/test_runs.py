"""Workers give what a serial loop gives; a run that kills its worker is reported and takes nothing
with it.
"""

import re

import pytest

from aerodima.optimisation.sweep import runs as engine_module
from aerodima.optimisation.sweep.runs import (
    WORKER_LOST,
    Runs,
    RunTask,
    evaluate,
    open_run_engine,
    run_key,
)
from aerodima.workbench.batch import dask_cluster
from aerodima.workbench.config.swing_file import read_swing, write_swing
from aerodima.workbench.errors import UserError
from aerodima.workbench.resources import model_path
from tests.optimisation.sweep.tiny import POISON, TINY_SETTINGS, evaluate_or_die


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


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("car.mass=-1", r"car\.mass: -1"),
        ("car.mass=1.3", r"car\.mass: 1\.3 kg; allowed: more than its parts"),
        ("tail.sail_length=1.2", r"tail\.sail_length: 1\.2 m"),
        ("manoeuvre.duration=0.001", "at least 2 are needed"),
    ],
)
def test_impossible_run_is_a_row_with_one_line_of_error(setting, said):
    (task,) = tasks(1, setting)
    row = evaluate(task)
    assert row["outcome"] is None
    assert "\n" not in row["error"]
    assert row["settings"].endswith(setting)
    assert re.search(said, row["error"]), row["error"]


@pytest.mark.slow
def test_workers_give_the_rows_of_a_serial_loop_in_order(engine):
    work = [*tasks(4), RunTask("bad", "straight", ("car.mass=-1",))]
    finished = []
    rows = Runs(engine).rows(work, lambda place, row: finished.append((place, row["run"])))
    assert rows == Runs().rows(work)
    assert sorted(finished) == [(place, task.name) for place, task in enumerate(work)]
    assert engine.workers == 2
    assert engine.startup > 0.0


@pytest.mark.slow
def test_run_that_kills_its_worker_is_a_row_with_an_error_and_its_neighbours_are_there(
    engine, monkeypatch
):
    monkeypatch.setattr(engine_module, "evaluate", evaluate_or_die)
    work = tasks(6)
    rows = Runs(engine).rows([*work[:2], RunTask(POISON, "straight"), *work[3:]])
    assert [row["run"] for row in rows] == ["0", "1", POISON, "3", "4", "5"]
    assert rows[2]["outcome"] is None
    assert rows[2]["error"].startswith(WORKER_LOST)
    assert [row for row in rows if row["run"] != POISON] == [
        evaluate(task) for task in work if task.name != "2"
    ]


def test_wrong_number_of_workers_and_absent_scheduler_are_refused(monkeypatch):
    with pytest.raises(UserError, match="--workers 0"), open_run_engine(0):
        pass
    monkeypatch.setattr(dask_cluster, "CONNECT_TIMEOUT", 0.5)
    absent = "tcp://127.0.0.1:1"
    with (
        pytest.raises(UserError, match=f"--scheduler {absent}: no Dask scheduler"),
        open_run_engine(2, absent),
    ):
        pass
    with pytest.raises(UserError, match="--scheduler nonsense:"), open_run_engine(2, "nonsense:/"):
        pass


def test_another_swing_of_the_same_name_is_another_run(tmp_path):
    thesis = read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))
    keys = []
    for number, limit in enumerate((8.0, 9.0)):
        limits = thesis.limits.model_copy(update={"velocity_rad_per_s": limit})
        path = write_swing(
            thesis.model_copy(update={"limits": limits}), tmp_path / f"{number}.yaml"
        )
        keys.append(run_key(RunTask("", "turn_fast", (f"controller.swing_file={path}",))))
    assert keys[0] != keys[1]
    plain = ("turn_fast", ("controller.swing_file=none",))
    assert run_key(RunTask("one", *plain)) == run_key(RunTask("other", *plain))
