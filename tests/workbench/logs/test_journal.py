import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.journal import JournalWriter, journal_path, read_journal, recover
from aerodima.workbench.logs.schema import read_run_log, run_metadata

COLUMNS = ("time_s", "angle_rad", "current_a")


def metadata():
    """Of a log that is not a run of the car, so that three columns will do."""
    return run_metadata({"name": "bench"}, seed=3, kind="bench_run")


def row(number: int) -> np.ndarray:
    return np.array([0.01 * number, np.sin(number), -float(number)])


def written(path: Path, rows: int, **options) -> JournalWriter:
    journal = JournalWriter(path, COLUMNS, metadata(), **options)
    for number in range(rows):
        journal.append(row(number))
    return journal


def expected(rows: int) -> np.ndarray:
    return np.array([row(number) for number in range(rows)])


@pytest.mark.parametrize("rows", [0, 1, 249, 250, 251, 1003])
def test_an_orderly_run_becomes_parquet_and_leaves_no_journal(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "run.parquet"
    assert written(path, rows).close() == path
    run = read_run_log(path)
    assert run.table.to_numpy().shape == (rows, 3)
    if rows:
        np.testing.assert_array_equal(run.table.to_numpy(), expected(rows))
    assert run.seed == 3
    assert list(tmp_path.iterdir()) == [path]


def test_the_caller_may_reuse_its_row(tmp_path: Path) -> None:
    buffer = np.zeros(3)
    with JournalWriter(tmp_path / "run.parquet", COLUMNS, metadata()) as journal:
        for number in range(5):
            buffer[:] = row(number)
            journal.append(buffer)
    np.testing.assert_array_equal(
        read_run_log(tmp_path / "run.parquet").table.to_numpy(), expected(5)
    )


def test_closing_twice_is_harmless_and_appending_after_it_is_not(tmp_path: Path) -> None:
    journal = written(tmp_path / "run.parquet", 3)
    assert journal.close() == journal.close()
    with pytest.raises(LogError, match="closed already"):
        journal.flush()


def test_a_row_of_another_length_is_refused(tmp_path: Path) -> None:
    journal = written(tmp_path / "run.parquet", 1)
    with pytest.raises(LogError, match="row of 1 values for 3 columns"):
        journal.append(np.zeros(1))
    journal.abandon()


def test_an_exception_keeps_the_journal_with_every_row(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"

    def run_that_fails() -> None:
        with JournalWriter(path, COLUMNS, metadata()) as journal:
            for number in range(260):
                journal.append(row(number))
            raise RuntimeError("the plant blew up")

    with pytest.raises(RuntimeError, match="the plant blew up"):
        run_that_fails()
    assert not path.exists()
    rescued = recover(journal_path(path))
    assert (rescued.path, rescued.rows, rescued.complete) == (path, 260, True)
    run = read_run_log(path)
    np.testing.assert_array_equal(run.table.to_numpy(), expected(260))
    assert run.extra["recovered_rows"] == 260
    assert journal_path(path).exists()


def test_any_cut_rescues_the_complete_batches_and_nothing_else(tmp_path: Path) -> None:
    """Every length of the file: inside the header, a batch's metadata, its numbers, and the end
    mark.
    """
    journal = written(tmp_path / "run.parquet", 12, rows_per_batch=4).abandon()
    content = journal.read_bytes()
    cut = tmp_path / "cut.parquet.journal"
    rescued = []
    for length in range(len(content) + 1):
        cut.write_bytes(content[:length])
        try:
            table, complete = read_journal(cut)
        except LogError:
            rescued.append(-1)
            continue
        assert complete == (length == len(content))
        rows = table.num_rows
        if rows:
            np.testing.assert_array_equal(table.to_pandas().to_numpy(), expected(rows))
        rescued.append(rows)
    assert rescued == sorted(rescued)
    assert set(rescued) == {-1, 0, 4, 8, 12}


@pytest.mark.parametrize("lost", [1, 8, 9, 60])
def test_recover_writes_what_a_cut_left(tmp_path: Path, lost: int) -> None:
    journal = written(tmp_path / "run.parquet", 12, rows_per_batch=4).abandon()
    journal.write_bytes(journal.read_bytes()[:-lost])
    rescued = recover(journal, tmp_path / "rescued.parquet")
    assert not rescued.complete
    assert rescued.rows == (12 if lost <= 8 else 8)
    np.testing.assert_array_equal(
        read_run_log(rescued.path).table.to_numpy(), expected(rescued.rows)
    )


def test_recover_refuses_what_it_cannot_or_must_not_do(tmp_path: Path) -> None:
    journal = written(tmp_path / "run.parquet", 4, rows_per_batch=4).abandon()
    (tmp_path / "run.parquet").write_text("precious")
    with pytest.raises(LogError, match="exists already"):
        recover(journal)
    assert (tmp_path / "run.parquet").read_text() == "precious"
    assert recover(journal, force=True).rows == 4

    with pytest.raises(LogError, match="no such journal"):
        recover(tmp_path / "none.parquet.journal")
    with pytest.raises(LogError, match=r"a journal is named \*\.journal"):
        recover(tmp_path / "run.parquet")
    (tmp_path / "text.journal").write_text(
        "not an Arrow stream at all, but long enough to look like one"
    )
    with pytest.raises(LogError, match="nothing to rescue"):
        recover(tmp_path / "text.journal")
    empty = written(tmp_path / "empty.parquet", 0).abandon()
    with pytest.raises(LogError, match="no complete batch"):
        recover(empty)


def test_neither_a_log_nor_a_left_journal_is_overwritten_without_force(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    written(path, 4).abandon()
    with pytest.raises(LogError, match=r"run\.parquet\.journal: holds a run that was cut off"):
        JournalWriter(path, COLUMNS, metadata())
    assert read_journal(journal_path(path))[0].num_rows == 4
    written(path, 6, force=True).close()
    with pytest.raises(LogError, match="exists already"):
        JournalWriter(path, COLUMNS, metadata())
    assert len(read_run_log(path).table) == 6


def test_unusable_folder_and_bad_columns_stop_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(LogError, match="cannot be made or used as a folder"):
        JournalWriter(tmp_path / "out" / "run.parquet", COLUMNS, metadata())
    with pytest.raises(LogError, match="named twice: angle_rad"):
        JournalWriter(tmp_path / "run.parquet", (*COLUMNS, "angle_rad"), metadata())
    with pytest.raises(LogError, match=r"missing: .*imu_yaw_rad"):
        JournalWriter(tmp_path / "run.parquet", COLUMNS, {**metadata(), "kind": "car_run"})
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_a_killed_process_loses_at_most_the_batch_it_was_filling(tmp_path: Path) -> None:
    """SIGKILL in mid-run: no handler runs, only what the operating system has is left."""
    program = textwrap.dedent(
        """
        import sys, time
        import numpy as np
        from aerodima.workbench.logs.journal import JournalWriter
        from aerodima.workbench.logs.schema import run_metadata
        journal = JournalWriter(sys.argv[1], ("time_s", "angle_rad", "current_a"),
                                run_metadata({"name": "bench"}, seed=3, kind="bench_run"))
        for number in range(637):
            journal.append(np.array([0.01 * number, np.sin(number), -float(number)]))
        print("running", flush=True)
        time.sleep(60.0)
        """
    )
    path = tmp_path / "run.parquet"
    root = Path(__file__).parents[3]
    child = subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, cwd=root
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == b"running\n"
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
    assert child.returncode == -signal.SIGKILL
    with pytest.raises(LogError, match="aerodima log recover"):
        read_run_log(path)
    rescued = recover(journal_path(path))
    assert not rescued.complete
    # 637 rows in batches of 250, or in smaller ones of at most a second on a slow machine.
    assert 500 <= rescued.rows <= 637
    np.testing.assert_array_equal(read_run_log(path).table.to_numpy(), expected(rescued.rows))
