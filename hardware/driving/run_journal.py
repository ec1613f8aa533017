"""The log of a real-time run: the rows go to a thread, so that a slow or full disk never holds up
the loop.
"""

import contextlib
import math
import queue
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from aerodima.hardware.car.wiring import PERIOD
from aerodima.hardware.driving.speaker import Say
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.schema import run_metadata
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import names_of, sensor_columns

LINK_COLUMNS = ("loop_lateness_s", "imu_sample_time_s", "teensy_sent_time_s", "controller_time_s")
"""Columns that only a drive has: lateness of the cycle, times at which IMU and Teensy sampled the
values of the row, on the clock of the run, and how long the controller computed. The Teensy's clock
is aligned by `aerodima.hardware.devices.teensy_link`."""
_MAX_WAITING = 3000
"""Largest number of rows that wait for the disk, or are kept after it has failed."""
_FLUSH = 0.08
"""Age at which waiting rows are passed on, s; with the period of the loop, a killed drive loses
less than 0.1 s."""
_CHECK_PERIOD = 0.5
"""Time between two checks of the journal, s."""
_LAST_WAIT = 5.0
"""Longest wait for the disk at the end of the drive, s."""


def drive_columns() -> list[str]:
    """Returns the columns of a drive's log, in order."""
    return [*names_of(sensor_columns()), *LINK_COLUMNS]


class RunJournal(JournalWriter):
    """A `JournalWriter` whose rows are written by a thread.

    The thread keeps the scheduling of the one that opens the journal. At ordinary priority another
    program could displace it while it holds the interpreter's lock, and the loop would wait for
    both. Twice a second it checks whether the journal is still where its name leads, and holds what
    was written (`JournalWriter.check`). Rows that the disk does not take stay in memory.

    Args:
        say: function that receives errors and notes of the log at once, in the thread; it must
            return at once, as a `Speaker` does.

    Attributes:
        columns: names of the columns, in order.
        error: reason why the writing stopped; empty while it works.
        lost: number of rows that were not written.
    """

    def __init__(
        self,
        path: Path,
        columns: Sequence[str],
        metadata: Facts,
        force: bool = False,
        say: Say = lambda _: None,
    ) -> None:
        super().__init__(path, columns, metadata, force, flush_interval=_FLUSH)
        self.columns = list(columns)
        self.error = ""
        self.lost = 0
        self._say = say
        self._kept: list[FloatArray] = []
        self._check_due = time.monotonic() + _CHECK_PERIOD
        self._waiting: queue.Queue[FloatArray | None] = queue.Queue(_MAX_WAITING)
        self._thread = threading.Thread(target=self._write, name="run-journal", daemon=True)
        self._thread.start()

    def append(self, row: ArrayLike) -> None:
        """Takes one row and returns at once; raises `LogError` if closed or in a forked process."""
        if not self._open:
            raise LogError(f"{self.journal}: closed already, or opened before a fork (os.fork)")
        try:
            self._waiting.put_nowait(np.array(row, dtype=float))
        except queue.Full:
            self.lost += 1
            self.error = self.error or f"{self.journal}: the disk is too slow"

    def note(self, text: str) -> None:
        """Says a sentence about the journal and keeps it for the log, once."""
        if text in self.notes:
            return
        super().note(text)
        self._say(f"log: {text}")

    def close(self) -> Path:
        """Writes what waits and ends the log; returns its path, another one than asked for if that
        takes no log any more.

        Raises:
            LogError: the disk still holds up the thread (the journal is kept), or no place takes
                the log.
        """
        if not self._open:
            return self.path
        self._finish()
        if self._thread.is_alive():
            raise LogError(
                f"{self.error}; what was written can be rescued: aerodima log recover "
                f"{self.journal}"
            )
        if not self.error:
            with contextlib.suppress(LogError):
                self.flush()
        try:
            return self._write_log()
        except LogError:
            raise
        except Exception as error:  # such as no memory: the journal is on the disk
            raise LogError(
                f"the log cannot be written ({error!r}); what was written can be rescued: "
                f"aerodima log recover {self.journal}"
            ) from error

    def discard(self) -> None:
        """Ends the log of a drive that did not begin; nothing stays on the disk."""
        if self._open:
            self._finish()
            self._remove()
            # A file that holds up its thread would hold up this one too.
            if not self._thread.is_alive():
                with contextlib.suppress(LogError):
                    self.abandon()

    def _finish(self) -> None:
        # A disk that takes nothing must not hold up the end of the program.
        with contextlib.suppress(queue.Full):
            self._waiting.put(None, timeout=_LAST_WAIT)
        self._thread.join(_LAST_WAIT)
        if self._thread.is_alive():
            self.error = self.error or f"{self.journal}: the disk is too slow"

    def _write_log(self) -> Path:
        """Writes what the open journal and the memory hold to the first place that takes it."""
        if not self.error:
            self._end()
        if self.lost:
            self.note(f"{self.journal}: {self.lost} rows are lost")
        unwritten = np.vstack([self._buffer[: self._filled], *self._kept])
        rest = pa.table(list(np.ascontiguousarray(unwritten.T)), schema=self._schema)
        table = pa.concat_tables([self._table(), rest])
        failed = ""
        for path in self._places():
            try:
                # Without the journal's name, a log of that name may be another run's.
                may_replace = self._force and path == self.path and self.in_place
                self._write_table(table, path, may_replace)
            except LogError as error:
                failed = failed or str(error)
                continue
            if self.error or self.notes or path != self.path:
                reason = f"{failed}; " if failed else ""
                self.note(f"{reason}the run of {table.num_rows} rows is in {path}")
            self.path = path
            self._remove()
            self._writer = 0
            with contextlib.suppress(OSError):  # somebody closed it
                self._file.close()
            return path
        raise LogError(
            f"{failed}; what was written can be rescued: aerodima log recover {self.journal}"
        )

    def _places(self) -> Iterator[Path]:
        """Yields the places for the log, in order: the one asked for, the nearest existing folder
        above its own, a new temporary folder.
        """
        yield self.path
        above = self.path.absolute().parents[1:]
        yield next(folder for folder in above if folder.is_dir()) / self.path.name
        with contextlib.suppress(OSError):
            yield Path(tempfile.mkdtemp(prefix="aerodima_log_")) / self.path.name

    def _write(self) -> None:
        while True:
            with contextlib.suppress(Exception):  # the rows matter more
                self._check_journal()
            try:
                row = self._waiting.get(timeout=_CHECK_PERIOD)
            except queue.Empty:
                continue
            if row is None:
                return
            if self.error:
                self._keep(row)
                continue
            try:
                super().append(row)
            except Exception as error:  # whatever it is, the loop must learn of it and go on
                self.error = " ".join(str(error).split()) or type(error).__name__
                self.note(f"{self.error}; the car stops, what comes now is kept in memory")

    def _keep(self, row: FloatArray) -> None:
        if len(self._kept) < _MAX_WAITING:
            self._kept.append(row)
        else:
            self.lost += 1

    def _check_journal(self) -> None:
        now = time.monotonic()
        if now < self._check_due:
            return
        self._check_due = now + _CHECK_PERIOD
        if not self.in_place:
            self.note(
                f"{self.journal} was removed, renamed or replaced; the drive goes on, and writes "
                "its log at its end"
            )
        if not self.error:
            self.check()


def open_run_journal(
    path: Path,
    scenario: Scenario,
    wiring: str,
    force: bool = False,
    own: Sequence[str] = (),
    say: Say = lambda _: None,
) -> RunJournal:
    """Opens the journal of a drive of a scenario, with a diagram's `own` columns; raises `LogError`
    as `JournalWriter` does.
    """
    metadata = run_metadata(
        scenario.resolved(), scenario.seed, extra={"platform": "physical", "wiring": wiring}
    )
    return RunJournal(path, [*drive_columns(), *own], metadata, force, say)


def log_facts(reason: str, stop_time: float, cycle_times: Sequence[float], overruns: int) -> Json:
    """Returns the facts of a finished drive for the `extra` of its log; errors of its periods in s.

    `begin_unix_s` is the time of its first cycle on the clock of the traffic log, s.
    """
    facts: Json = {
        "stop_reason": reason,
        "overruns": overruns,
        "cycles": len(cycle_times),
    }
    if math.isfinite(stop_time):
        facts["stop_time_s"] = stop_time
    if len(cycle_times) > 1:
        facts["begin_unix_s"] = cycle_times[0] + time.time() - time.monotonic()
        error = np.abs(np.diff(np.asarray(cycle_times)) - PERIOD)
        for name, percentage in (("p50", 50), ("p99", 99), ("max", 100)):
            facts[f"period_error_{name}_s"] = float(np.percentile(error, percentage))
    return facts
