import contextlib
import errno
import itertools
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.journal import JournalWriter, journal_path, read_journal, recover
from aerodima.workbench.logs.schema import read_run_log, run_metadata
from tests.refusals import assert_refused

COLUMNS = ("time_s", "angle_rad", "current_a")


def metadata():
    """Of a log that is not a run of the car, so that three columns will do."""
    return run_metadata({"name": "bench"}, seed=3, kind="bench_run", extra={"mass_kg": 0.15})


def row(number):
    return np.array([0.01 * number, np.sin(number), -float(number)])


def fill(journal, *numbers):
    for number in range(*numbers):
        journal.append(row(number))


def written(path, rows, **options):
    journal = JournalWriter(path, COLUMNS, metadata(), **options)
    fill(journal, rows)
    return journal


def expected(rows):
    return np.array([row(number) for number in range(rows)])


def assert_rows(table, rows):
    assert_array_equal(table.to_numpy(), expected(rows))


@pytest.mark.parametrize("rows", [0, 1, 249, 250, 251, 1003])
def test_an_orderly_run_becomes_parquet_and_leaves_no_journal(tmp_path, rows):
    path = tmp_path / "run.parquet"
    assert written(path, rows).close() == path
    run = read_run_log(path)
    assert run.table.to_numpy().shape == (rows, 3)
    if rows:
        assert_rows(run.table, rows)
    assert run.seed == 3
    assert list(tmp_path.iterdir()) == [path]


def test_an_exception_keeps_the_journal_with_every_row(tmp_path):
    path = tmp_path / "run.parquet"

    def run_that_fails():
        with JournalWriter(path, COLUMNS, metadata()) as journal:
            fill(journal, 260)
            raise RuntimeError("the plant blew up")

    with pytest.raises(RuntimeError, match="the plant blew up"):
        run_that_fails()
    assert not path.exists()
    rescued = recover(journal_path(path))
    assert (rescued.path, rescued.rows, rescued.complete) == (path, 260, True)
    run = read_run_log(path)
    assert_rows(run.table, 260)
    assert run.extra["recovered_rows"] == 260
    assert journal_path(path).exists()


def test_any_cut_rescues_the_complete_batches_and_nothing_else(tmp_path):
    """Lengths of the file inside the header, a batch's metadata, its numbers, and the end mark."""
    journal = written(tmp_path / "run.parquet", 12, rows_per_batch=4).abandon()
    content = journal.read_bytes()
    cut = tmp_path / "cut.parquet.journal"
    rescued = []
    for length in [*range(0, len(content) - 12, 7), *range(len(content) - 12, len(content) + 1)]:
        cut.write_bytes(content[:length])
        try:
            table, damage = read_journal(cut)
        except LogError:
            rescued.append(-1)
            continue
        assert (not damage) == (length == len(content))
        rows = table.num_rows
        if rows:
            assert_rows(table.to_pandas(), rows)
        rescued.append(rows)
    assert rescued == sorted(rescued)
    assert set(rescued) == {-1, 0, 1, 5, 9, 12}


def test_recover_does_not_overwrite_without_force(tmp_path):
    journal = written(tmp_path / "run.parquet", 4, rows_per_batch=4).abandon()
    (tmp_path / "run.parquet").write_text("precious")
    assert_refused(lambda: recover(journal), LogError, "run.parquet", "--force")
    assert (tmp_path / "run.parquet").read_text() == "precious"
    assert recover(journal, force=True).rows == 4


def test_neither_a_log_nor_a_left_journal_is_overwritten_without_force(tmp_path):
    path = tmp_path / "run.parquet"
    written(path, 4).abandon()
    assert_refused(lambda: written(path, 0), LogError, "run.parquet.journal", "log recover")
    assert read_journal(journal_path(path))[0].num_rows == 4
    written(path, 6, force=True).close()
    assert_refused(lambda: written(path, 0), LogError, "run.parquet", "--force")
    assert len(read_run_log(path).table) == 6


def left_empty(folder):
    recover(written(folder / "empty.parquet", 0).abandon())


def no_arrow_stream(folder):
    (folder / "text.journal").write_text("not an Arrow stream, but long enough to look like one")
    recover(folder / "text.journal")


def folder_is_a_file(folder):
    (folder / "out").write_text("a file")
    JournalWriter(folder / "out" / "run.parquet", COLUMNS, metadata())


@pytest.mark.parametrize(
    ("work", "named"),
    [
        (lambda folder: recover(folder / "none.parquet.journal"), ["none.parquet.journal"]),
        (lambda folder: recover(folder / "run.parquet"), ["run.parquet", "*.journal"]),
        (no_arrow_stream, ["text.journal"]),
        (left_empty, ["empty.parquet.journal"]),
        (folder_is_a_file, ["/out"]),
        (
            lambda folder: JournalWriter(folder / "run", (*COLUMNS, "angle_rad"), metadata()),
            ["/run", "angle_rad"],
        ),
        (
            lambda folder: JournalWriter(folder / "run", COLUMNS, metadata() | {"kind": "car_run"}),
            ["/run", "imu_yaw_rad"],
        ),
        (
            lambda folder: written(folder / "run", 1).append(np.zeros(1)),
            ["/run", "1 values", "3 columns"],
        ),
    ],
)
def test_what_cannot_be_written_or_rescued_is_named(tmp_path, work, named):
    assert_refused(lambda: work(tmp_path), LogError, *named)


def test_a_closed_journal_takes_no_rows(tmp_path):
    journal = written(tmp_path / "run.parquet", 3)
    assert journal.close() == journal.close()
    assert_refused(journal.flush, LogError, "run.parquet.journal")


def test_the_journal_of_another_run_is_left_alone(tmp_path):
    """Somebody removed the journal of a run that goes on, and began another run of that name."""
    path = tmp_path / "run.parquet"
    first = written(path, 5)
    first.journal.unlink()
    assert not first.in_place
    second = written(path, 7)
    assert second.in_place
    first.close()
    assert_rows(read_run_log(path).table, 5)
    assert read_journal(second.abandon())[0].num_rows == 7


@pytest.mark.parametrize("rows", [1, 200])
def test_a_disk_that_fails_to_sync_stops_the_run_or_its_rescue(tmp_path, monkeypatch, rows):
    """The disk answers in a thread, so the next request for it, or the end, reports the failure."""

    def fail(descriptor):
        raise OSError(errno.EIO, "input/output error")

    journal = JournalWriter(
        tmp_path / "run.parquet", COLUMNS, metadata(), rows_per_batch=1, sync_interval=0.0
    )
    monkeypatch.setattr(os, "fsync", fail)

    def run():
        for number in range(rows):
            journal.append(row(number))
            time.sleep(0.01)
        journal.abandon()

    assert_refused(run, LogError, "run.parquet.journal", "input/output error")
    assert journal.rows < 200


def test_the_disk_has_the_whole_journal_of_a_run_that_failed(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_size))
    journal = written(tmp_path / "run.parquet", 260).abandon()
    assert synced == [journal.stat().st_size]


def test_no_flipped_bit_gives_a_wrong_value_or_goes_unsaid(tmp_path):
    journal = written(tmp_path / "run.parquet", 300, rows_per_batch=10).abandon()
    content = journal.read_bytes()
    every_row = expected(300)
    rescued = []
    for bit in np.random.default_rng(49).integers(8 * len(content), size=300):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        journal.write_bytes(damaged)
        table, damage = read_journal(journal)
        rows = table.to_pandas().to_numpy()
        numbers = np.rint(100.0 * rows[:, 0]).astype(int)
        assert_array_equal(rows, every_row[numbers])
        lost = np.setdiff1d(np.arange(300), numbers)
        assert "damaged" in damage[0]
        if len(lost):
            assert f"{len(lost)} rows after row {lost[0]} are lost" in damage[0]
        rescued.append(len(rows))
    assert {290, 300} <= set(rescued)
    rescue = recover(journal)
    assert list(rescue.damage) == read_run_log(rescue.path).extra["journal_notes"] == damage


def test_no_frame_that_is_missing_or_doubled_costs_or_gives_rows_unsaid(tmp_path):
    content = written(tmp_path / "run.parquet", 40, rows_per_batch=10).abandon().read_bytes()
    other = written(tmp_path / "other.parquet", 3).abandon().read_bytes()
    changed = tmp_path / "changed.journal"
    borders = [*re.finditer(rb"\x89AJ1", content)]
    borders = [*(border.start() for border in borders), len(content)]
    for begin, end in itertools.pairwise(borders):
        for times in (0, 2):
            changed.write_bytes(content[:begin] + times * content[begin:end] + content[end:])
            table, damage = read_journal(changed)
            rows = table.to_pandas().to_numpy()
            numbers = np.rint(100.0 * rows[:, 0]).astype(int)
            assert_array_equal(rows, expected(40)[numbers])
            assert np.all(np.diff(numbers) > 0)
            assert damage or len(rows) == 40
    changed.write_bytes(content[: borders[-2]] + other[other.rindex(b"\x89AJ1") :])
    assert "not ended in order" in read_journal(changed)[1][-1]


@pytest.mark.parametrize("left", [0.0, 0.5, 0.99])
@pytest.mark.parametrize("compared", [100, 4_000_000])
def test_what_others_do_to_the_journal_costs_no_row_and_stands_in_the_log(tmp_path, left, compared):
    journal = written(tmp_path / "run.parquet", 40, rows_per_batch=4)
    for rows in (40, 80):
        os.truncate(journal.journal, int(left * journal.journal.stat().st_size))
        journal.check(compared)
        assert read_journal(journal.journal)[0].num_rows == journal.rows > rows - 10
        fill(journal, rows, rows + 40)
    run = read_run_log(journal.close())
    assert_rows(run.table, 120)
    assert str(journal.journal) in run.extra["journal_notes"][0]


def test_a_disk_that_never_answers_does_not_hold_up_the_end_of_the_program(tmp_path):
    program = textwrap.dedent(
        """
        import os, sys, threading
        from aerodima.workbench.logs.journal import JournalWriter
        from aerodima.workbench.logs.schema import run_metadata
        os.fsync = lambda _: threading.Event().wait()
        metadata = run_metadata({"name": "bench"}, seed=3, kind="bench_run")
        journal = JournalWriter(sys.argv[1], ("time_s",), metadata, sync_interval=0.0)
        journal.append([0.0])
        """
    )
    command = [sys.executable, "-c", program, str(tmp_path / "run.parquet")]
    subprocess.run(command, cwd=Path(__file__).parents[3], timeout=60.0, check=True)


def test_a_second_writer_is_refused_also_with_force_and_the_first_loses_nothing(tmp_path):
    path = tmp_path / "run.parquet"
    first = written(path, 5)
    assert_refused(lambda: written(path, 7, force=True), LogError, "run.parquet.journal", "process")
    first.close()
    assert len(read_run_log(path).table) == 5


def test_a_fork_of_the_process_leaves_the_journal_alone(tmp_path, monkeypatch):
    journal = written(tmp_path / "run.parquet", 5)
    with monkeypatch.context() as fork:
        fork.setattr(os, "getpid", lambda: -1)
        assert_refused(journal.flush, LogError, "fork")
        journal.close()
        journal.abandon()
    assert journal.in_place
    assert len(read_run_log(journal.close()).table) == 5


def test_a_journal_of_version_0_3_is_read_and_its_doubts_are_named(tmp_path):
    schema = written(tmp_path / "run.parquet", 0)._schema
    old = tmp_path / "old.parquet.journal"
    with old.open("wb") as file, pa.ipc.new_stream(file, schema) as stream:
        for begin in (0, 4, 8):
            rows = [row(number) for number in range(begin, begin + 4)]
            stream.write_table(pa.table(list(np.array(rows).T), schema=schema))
    table, damage = read_journal(old)
    assert_rows(table.to_pandas(), 12)
    assert "checksums" in " ".join(damage)
    content = old.read_bytes()
    for place in range(0, len(content), 5):
        old.write_bytes(content[:place] + bytes([content[place] ^ 0x41]) + content[place + 1 :])
        with contextlib.suppress(LogError):
            assert "checksums" in read_journal(old)[1][0]


@pytest.mark.parametrize(
    ("options", "in_file"),
    [({"rows_per_batch": 4}, 9), ({"flush_interval": 0.0}, 10)],
    ids=["the first row and full batches", "old batches"],
)
def test_full_and_old_batches_are_in_the_file_while_the_run_goes_on(tmp_path, options, in_file):
    journal = written(tmp_path / "run.parquet", 10, **{"flush_interval": 60.0, **options})
    assert read_journal(journal.journal)[0].num_rows == in_file
    journal.close()


def test_facts_of_the_end_stand_beside_those_of_the_start(tmp_path):
    journal = written(tmp_path / "run.parquet", 1)
    journal.add_facts({"stop_time_s": 0.5})
    journal.add_facts({"slow_ticks": 2})
    journal.close()
    assert journal.run_log().extra == {"mass_kg": 0.15, "stop_time_s": 0.5, "slow_ticks": 2}


def test_a_killed_process_loses_at_most_the_batch_it_was_filling(tmp_path):
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
        assert child.stdout.readline() == b"running\n"
    finally:
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
    assert child.returncode == -signal.SIGKILL
    assert_refused(lambda: read_run_log(path), LogError, "run.parquet.journal", "log recover")
    rescued = recover(journal_path(path))
    assert not rescued.complete
    # 637 rows in batches of 250, or in smaller ones of at most a second on a slow machine.
    assert 500 <= rescued.rows <= 637
    assert_rows(read_run_log(path).table, rescued.rows)
