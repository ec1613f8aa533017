"""The log of a real-time run: the rows go to a thread, so that a slow or full disk never holds up the loop."""

from __future__ import annotations

import contextlib
import math
import queue
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import sensor_columns
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.schema import run_metadata

LINK_COLUMNS = ("loop_lateness_s", "imu_sample_time_s", "teensy_sent_time_s")
"""Beside the columns of every run: how late the cycle came, and when IMU and Teensy took what stands in the row, on the
clock of the run. The Teensy's clock is aligned by `aerodima.hardware.devices.teensy_link`."""
_MOST_WAITING = 3000
_FLUSH = 0.08
"""s; with the period of the loop, what a killed drive loses stays below 0.1 s."""
_LAST_WAIT = 5.0
"""For the disk at the end of the drive, s."""


def drive_columns() -> list[str]:
    """Columns of a drive's log, in order."""
    return [*(column.name for column in sensor_columns()), *LINK_COLUMNS]


class RunJournal(JournalWriter):
    """A `JournalWriter` whose rows are written by a thread.

    The thread keeps the scheduling of the one that opens the journal. At ordinary priority another program could
    displace it while it holds the interpreter's lock, and the loop would wait for both.

    Attributes:
        columns: names, in order.
        error: what stopped the writing, empty while it works.
        lost: rows that were not written.
    """

    def __init__(self, path: Path, columns: Sequence[str], metadata: Mapping[str, Any], force: bool = False) -> None:
        super().__init__(path, columns, metadata, force, flush_interval=_FLUSH)
        self.columns = list(columns)
        self.error = ""
        self.lost = 0
        self._waiting: queue.Queue[np.ndarray | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._write, name="run-journal", daemon=True)
        self._thread.start()

    def append(self, row: ArrayLike) -> None:
        """Takes one row and returns at once."""
        try:
            self._waiting.put_nowait(np.array(row, dtype=float))
        except queue.Full:
            self.lost += 1
            self.error = self.error or f"{self.journal}: the disk is too slow"

    def close(self) -> Path:
        """Writes what waits and ends the log. LogError, with the journal kept, if the disk did not take it."""
        self._finish()
        if self.error:
            self._give_up()
            raise LogError(f"{self.error}; what was written can be rescued: aerodima log recover {self.journal}")
        return super().close()

    def discard(self) -> None:
        """Ends a log of a drive that did not begin: nothing is left of it."""
        self._finish()
        super().abandon()
        self.journal.unlink(missing_ok=True)

    def _finish(self) -> None:
        with contextlib.suppress(queue.Full):  # a disk that takes nothing must not hold up the end of the program
            self._waiting.put(None, timeout=_LAST_WAIT)
        self._thread.join(_LAST_WAIT)
        if self._thread.is_alive():
            self.error = self.error or f"{self.journal}: the disk is too slow"

    def _give_up(self) -> None:
        if self._thread.is_alive():  # the disk still holds it up
            return
        with contextlib.suppress(LogError, OSError):  # the rows of before stay readable, which is all that can be had
            super().abandon()

    def _write(self) -> None:
        while (row := self._waiting.get()) is not None:
            if self.error:
                self.lost += 1
                continue
            try:
                super().append(row)
            except Exception as error:  # whatever it is, the loop must hear of it and go on
                self.error = " ".join(str(error).split())


def open_run_journal(path: Path, scenario: Scenario, wiring: str, force: bool = False) -> RunJournal:
    """The journal of a drive of a scenario; LogError as for `JournalWriter`."""
    metadata = run_metadata(scenario.resolved(), scenario.seed, extra={"platform": "physical", "wiring": wiring})
    return RunJournal(path, drive_columns(), metadata, force)


def log_facts(reason: str, stop_time: float, cycle_times: Sequence[float], overruns: int) -> dict[str, Any]:
    """What only the end of a drive knows, for the `extra` of its log."""
    facts: dict[str, Any] = {"stop_reason": reason, "overruns": overruns, "cycles": len(cycle_times)}
    if math.isfinite(stop_time):
        facts["stop_time_s"] = stop_time
    return {**facts, **period_facts(cycle_times)}


def period_facts(cycle_times: Sequence[float], period: float = 0.01) -> dict[str, float]:
    """Error of the periods of a loop: p50, p99 and the most, s; empty for fewer than two cycles."""
    if len(cycle_times) < 2:
        return {}
    error = np.abs(np.diff(np.asarray(cycle_times)) - period)
    p50, p99 = np.percentile(error, [50, 99])
    return {
        "period_error_p50_s": float(p50),
        "period_error_p99_s": float(p99),
        "period_error_max_s": float(error.max()),
    }
