"""Where the rows of a run go: through a journal into a file, or into memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata


class LogInMemory:
    """Does without a file what `JournalWriter` does: takes rows within a `with` block; after it there is the log."""

    def __init__(self, columns: Sequence[str], metadata: Mapping[str, Any]) -> None:
        self._columns, self._metadata = list(columns), dict(metadata)
        self._rows: list[np.ndarray] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing to be closed."""

    def append(self, row: np.ndarray) -> None:
        """Takes one row; a copy of it, since the recorder writes the next one into the same array."""
        self._rows.append(row.copy())

    def add_facts(self, facts: Mapping[str, Any]) -> None:
        """Adds to `extra` of the log what only the end of the run knows."""
        self._metadata["extra"] = {**self._metadata["extra"], **facts}

    def run_log(self) -> RunLog:
        """The log, after the block."""
        return run_log_from_metadata(pd.DataFrame(np.array(self._rows), columns=self._columns), self._metadata)


LogSink = JournalWriter | LogInMemory


def open_log(path: str | Path | None, columns: Sequence[str], metadata: Mapping[str, Any], force: bool) -> LogSink:
    """A journal that becomes the log `path`, or rows in memory without one.

    Raises:
        LogError: as `JournalWriter`.
    """
    return LogInMemory(columns, metadata) if path is None else JournalWriter(path, columns, metadata, force=force)
