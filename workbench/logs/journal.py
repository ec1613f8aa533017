"""Crash-safe journal of a run: an Arrow IPC stream on disk that becomes Parquet when the run ends
well.

A Parquet file without its footer is unreadable, so a run that dies would be lost. The journal is
appended in record batches instead, each complete in itself: after a crash every batch that reached
the file is still there, and `recover` turns them into a run log. `run.parquet` has the journal
`run.parquet.journal`.
"""

import os
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from aerodima.workbench.core.atomic_write import make_folder, refuse_existing
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import (
    METADATA_KEY,
    Facts,
    RunLog,
    decode_metadata,
    encode_metadata,
    read_run_log,
    refuse_missing,
    write_table,
)

JOURNAL_SUFFIX = ".journal"


@dataclass(frozen=True)
class Recovery:
    """What `recover` rescued.

    Attributes:
        path: the run log that was written.
        rows: complete rows in it.
        complete: whether the journal had been closed in order, so that nothing was lost.
    """

    path: Path
    rows: int
    complete: bool


def journal_path(path: Path | str) -> Path:
    """Names the journal of a run log."""
    path = Path(path)
    return path.with_name(path.name + JOURNAL_SUFFIX)


class JournalWriter:
    """Appends rows to the journal of one run; `close` turns it into the Parquet file.

    As a context manager it closes after an orderly end. After an exception it keeps the journal,
    with every row that was appended.

    A batch goes to the operating system when it is full or `flush_interval` old, so a killed
    process loses at most that much. The shorter it is, the larger the journal: a batch of 60
    columns costs about 10 kB beside its numbers. Every `sync_interval` a thread asks the disk to
    keep it, so that a power cut loses little and the loop never waits.

    Args:
        path: name of the Parquet file to be.
        columns: names of the columns, in the order of the rows.
        metadata: metadata object, see `aerodima.workbench.logs.schema.run_metadata`.
        force: replace an existing log, and a journal that an earlier run left behind.
        rows_per_batch: rows in a record batch.
        flush_interval: age of a batch at which it goes to the operating system, s.
        sync_interval: time between two requests to the disk, s.

    Raises:
        LogError: log or journal exists, folder unusable, columns missing or named twice.
    """

    def __init__(
        self,
        path: Path | str,
        columns: Sequence[str],
        metadata: Facts,
        force: bool = False,
        rows_per_batch: int = 250,
        flush_interval: float = 1.0,
        sync_interval: float = 2.0,
    ) -> None:
        self.path = Path(path)
        self.journal = journal_path(path)
        self.rows = 0
        self._metadata = dict(metadata)
        self._force = force
        self._width = len(columns)
        self._buffer = np.empty((rows_per_batch, self._width))
        self._filled = 0
        self._refuse(columns)
        encoded = encode_metadata(metadata)
        self._schema = pa.schema(
            [(name, pa.float64()) for name in columns], metadata={METADATA_KEY: encoded}
        )
        make_folder(self.path.parent, LogError)
        try:
            self._file = open(self.journal, "w+b" if force else "x+b")  # noqa: SIM115 - open for as long as the run lasts
        except OSError as cause:
            raise LogError(f"{self.journal}: cannot be written ({cause.strerror})") from cause
        self._stream = pa.ipc.new_stream(self._file, self._schema)
        self._file.flush()
        self._syncing = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._sync: Future[None] | None = None
        self._sync_interval = sync_interval
        now = time.monotonic()
        self._flush_interval = flush_interval
        self._flush_due = now + flush_interval
        self._sync_due = now + sync_interval
        self._open = True

    def append(self, row: ArrayLike) -> None:
        """Takes one row, shape (number of columns,), in the order of the columns."""
        if len(row) != self._width:  # type: ignore[arg-type]
            raise LogError(f"{self.path}: row of {len(row)} values for {self._width} columns")  # type: ignore[arg-type]
        self._buffer[self._filled] = row
        self._filled += 1
        if self._filled == len(self._buffer) or time.monotonic() >= self._flush_due:
            self.flush()

    def add_facts(self, facts: Facts) -> None:
        """Adds to `extra` of the log what only the run's end knows; the journal goes without."""
        self._metadata["extra"] = {**self._metadata.get("extra", {}), **facts}

    def flush(self) -> None:
        """Hands the rows so far to the operating system; LogError if it refuses (disk full)."""
        if not self._open:
            raise LogError(f"{self.journal}: closed already")
        try:
            self._write_batch()
            self._request_sync()
        except OSError as cause:
            raise LogError(
                f"{self.journal}: cannot be written after {self.rows} rows ({cause})"
            ) from cause

    def close(self) -> Path:
        """Ends the journal, writes the Parquet file, removes the journal; returns the name of the
        Parquet file.

        The rows are read through the open file: it holds them also when its folder has been removed
        or renamed.
        """
        if self._open:
            self.flush()
            with self._file:
                self._end_stream()
                table, _ = read_journal(self.journal, self._file.fileno())
                write_table(table, self._metadata, self.path, self._force)
                self._remove()
        return self.path

    @property
    def in_place(self) -> bool:
        """Says whether the name of the journal still leads to the file that is being written."""
        try:
            return os.path.samestat(os.stat(self.journal), os.fstat(self._file.fileno()))
        except OSError:
            return False

    def _remove(self) -> None:
        if self.in_place:  # another run may have begun a journal of that name
            self.journal.unlink()

    def run_log(self) -> RunLog:
        """Reads the log that was written."""
        return read_run_log(self.path)

    def abandon(self) -> Path:
        """Flushes a run that failed and leaves its journal for `recover`; returns its name."""
        if self._open:
            try:
                self.flush()
            finally:
                self._release()
        return self.journal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _refuse(self, columns: Sequence[str]) -> None:
        twice = sorted({name for name in columns if list(columns).count(name) > 1})
        if twice:
            raise LogError(f"{self.path}: column(s) named twice: {', '.join(twice)}")
        refuse_missing(columns, self._metadata, str(self.path))
        refuse_existing(self.path, self._force, LogError)
        if self.journal.exists() and not self._force:
            raise LogError(
                f"{self.journal}: holds a run that was cut off; rescue it with `aerodima log "
                "recover` or use --force"
            )

    def _write_batch(self) -> None:
        self._flush_due = time.monotonic() + self._flush_interval
        if self._filled == 0:
            return
        by_column = np.ascontiguousarray(self._buffer[: self._filled].T)
        batch = pa.record_batch([pa.array(values) for values in by_column], schema=self._schema)
        self._stream.write_batch(batch)
        self._file.flush()
        self.rows += self._filled
        self._filled = 0

    def _request_sync(self) -> None:
        if time.monotonic() < self._sync_due or (self._sync is not None and not self._sync.done()):
            return
        if self._sync is not None:
            self._sync.result()
        self._sync = self._syncing.submit(os.fsync, self._file.fileno())
        self._sync_due = time.monotonic() + self._sync_interval

    def _release(self) -> None:
        with self._file:
            self._end_stream()

    def _end_stream(self) -> None:
        self._open = False
        self._syncing.shutdown(wait=True)
        self._stream.close()
        self._file.flush()


def read_journal(path: Path | str, descriptor: int | None = None) -> tuple[pa.Table, bool]:
    """Reads the complete batches of a journal and whether it had been ended in order.

    The cut may be anywhere: a batch that is not whole is left out, with all that comes after it.

    Args:
        descriptor: of the open journal, read instead of the file at `path`, which may have gone.

    Raises:
        LogError: no such file, cut off before the end of its header, not a journal, another schema
            version.
    """
    path = Path(path)
    if descriptor is None and not path.is_file():
        raise LogError(f"{path}: no such journal")
    batches: list[pa.RecordBatch] = []
    with open(path if descriptor is None else os.dup(descriptor), "rb") as file:
        ended = _has_end_mark(file)
        file.seek(0)
        try:
            stream = pa.ipc.open_stream(file)
        except (pa.ArrowException, OSError) as cause:
            raise LogError(
                f"{path}: cut off in its header, or not a journal; nothing to rescue"
            ) from cause
        decode_metadata(stream.schema.metadata, str(path))
        while True:
            try:
                batches.append(stream.read_next_batch())
            except StopIteration:
                break
            except (pa.ArrowException, OSError):
                ended = False
                break
    return pa.Table.from_batches(batches, schema=stream.schema), ended


def _has_end_mark(file: BinaryIO) -> bool:
    """Says whether the file ends with Arrow's end-of-stream mark (continuation 0xFFFFFFFF, length
    0).
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 8))
    return file.read() == b"\xff\xff\xff\xff\x00\x00\x00\x00"


def recover(
    journal: Path | str, out_path: Path | str | None = None, force: bool = False
) -> Recovery:
    """Writes the complete batches of a cut-off journal as a run log; the journal stays where it is.

    Args:
        journal: the journal, `run.parquet.journal`.
        out_path: the run log to write; the journal's name without its suffix when not given.
        force: replace an existing file.

    Raises:
        LogError: nothing to rescue, `out_path` exists, or cannot be written.
    """
    journal = Path(journal)
    if out_path is None:
        if journal.suffix != JOURNAL_SUFFIX:
            raise LogError(
                f"{journal}: a journal is named *{JOURNAL_SUFFIX}; give the name of the log to "
                "write"
            )
        out_path = journal.with_suffix("")
    table, complete = read_journal(journal)
    if table.num_rows == 0:
        raise LogError(f"{journal}: no complete batch in it; nothing to rescue")
    metadata = decode_metadata(table.schema.metadata, str(journal))
    metadata["extra"] = {**metadata.get("extra", {}), "recovered_rows": table.num_rows}
    return Recovery(write_table(table, metadata, Path(out_path), force), table.num_rows, complete)
