"""Crash-safe journal of a run: batches with checksums that become Parquet when the run ends well.

A Parquet file without its footer is unreadable, so a run that dies would be lost. The journal is
appended in batches instead, each complete in itself: after a crash, or damage by others, every
batch that is whole is found (`journal_frames`), and `recover` turns them into a run log.
`run.parquet` has the journal `run.parquet.journal`.
"""

import errno
import fcntl
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from aerodima.workbench.core.atomic_write import make_folder, refuse_existing
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.core.key_errors import require_unique
from aerodima.workbench.logs.journal_frames import (
    END,
    HEAD,
    ROWS,
    Content,
    make_frame,
    read_content,
)
from aerodima.workbench.logs.schema import (
    METADATA_KEY,
    RunLog,
    decode_metadata,
    encode_metadata,
    read_run_log,
    refuse_missing,
    write_table,
)

JOURNAL_SUFFIX = ".journal"
_CHECKED = 4_000_000
"""Number of last bytes that `check` compares while the run goes on: a minute of a drive."""
_SYNC_LIMIT = 30.0
"""Time within which the disk confirms the last rows at the end of the run, s."""


@dataclass(frozen=True)
class Recovery:
    """Result of `recover`.

    Attributes:
        path: path of the run log that was written.
        rows: number of complete rows in it.
        damage: sentences on what is damaged, missing or in doubt.
    """

    path: Path
    rows: int
    damage: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Says whether the journal was closed in order and is whole, so that nothing was lost."""
        return not self.damage


def journal_path(path: Path | str) -> Path:
    """Names the journal of a run log."""
    path = Path(path)
    return path.with_name(path.name + JOURNAL_SUFFIX)


class JournalWriter:
    """Appends rows to the journal of one run; `close` turns it into the Parquet file.

    As a context manager it closes after an orderly end. After an exception it keeps the journal,
    with every row that was appended.

    The first row, and then a batch that is full or `flush_interval` old, goes to the operating
    system, so a killed process loses at most that much. Every `sync_interval` a thread asks the
    disk to keep it, so that a power cut loses little and the loop never waits.

    One process writes a journal: it holds a lock, and a fork of it is refused. What it wrote stays
    in memory too (200 MB for a drive of an hour): `check` finds what others changed in the file and
    writes it again, and the log is made from the copy.

    Attributes:
        notes: sentences on what happened to the journal; in the log as `journal_notes` of `extra`.

    Args:
        path: path of the Parquet file to be written.
        columns: names of the columns, in the order of the rows.
        metadata: metadata object, see `aerodima.workbench.logs.schema.run_metadata`.
        force: whether an existing log, and a journal left by an earlier run, are replaced.
        rows_per_batch: number of rows in a full batch.
        flush_interval: age of a batch at which it goes to the operating system, s.
        sync_interval: time between two requests to the disk, s.

    Raises:
        LogError: log or journal exists, another process writes it, folder unusable, columns missing
            or named twice.
    """

    def __init__(
        self,
        path: Path | str,
        columns: Sequence[str],
        metadata: Facts,
        force: bool = False,
        rows_per_batch: int = 250,
        flush_interval: float = 0.1,
        sync_interval: float = 2.0,
    ) -> None:
        self.path = Path(path)
        self.journal = journal_path(path)
        self.rows = 0
        self.notes: list[str] = []
        self._metadata = dict(metadata)
        self._force = force
        self._width = len(columns)
        self._buffer = np.empty((rows_per_batch, self._width))
        self._filled = 0
        self._refuse(columns)
        self._schema = pa.schema(
            [(name, pa.float64()) for name in columns],
            metadata={METADATA_KEY: encode_metadata(metadata)},
        )
        make_folder(self.path.parent, LogError)
        self._run = os.urandom(8)
        self._copy = bytearray()
        self._open_file()
        self._sync = Future[None]()
        self._sync.set_result(None)
        self._sync_interval = sync_interval
        now = time.monotonic()
        self._flush_interval = flush_interval
        self._flush_due = now
        self._sync_due = now + sync_interval
        self._writer = os.getpid()

    def append(self, row: ArrayLike) -> None:
        """Takes one row, shape (number of columns,), in the order of the columns."""
        if len(row) != self._width:  # type: ignore[arg-type]
            raise LogError(f"{self.path}: row of {len(row)} values for {self._width} columns")  # type: ignore[arg-type]
        self._buffer[self._filled] = row
        self._filled += 1
        if self._filled == len(self._buffer) or time.monotonic() >= self._flush_due:
            self.flush()

    def add_facts(self, facts: Facts) -> None:
        """Adds facts known only at the run's end to `extra` of the log, not to the journal."""
        self._metadata["extra"] = {**self._metadata["extra"], **facts}

    def note(self, text: str) -> None:
        """Keeps a sentence on the journal for the log, once."""
        if text not in self.notes:
            self.notes.append(text)

    def flush(self) -> None:
        """Hands the rows so far to the operating system; LogError if it refuses (disk full)."""
        if not self._open:
            raise LogError(f"{self.journal}: closed already, or opened before a fork (os.fork)")
        try:
            self._write_batch()
            self._request_sync()
        except OSError as cause:
            raise LogError(
                f"{self.journal}: cannot be written after {self.rows} rows ({cause})"
            ) from cause

    @property
    def _open(self) -> bool:
        """Says whether it takes rows; never in a fork of the process that opened it."""
        return self._writer == os.getpid()

    def check(self, size: int = _CHECKED) -> None:
        """Compares the last `size` bytes with the copy; writes all of it again, with a note, if
        others changed them.

        Raises:
            OSError: the disk does not take it.
        """
        content = self._copy[-size:]
        place = len(self._copy) - len(content)
        if os.pread(self._file.fileno(), len(content), place) != content:
            self._write_at(0, self._copy)
            self.note(f"{self.journal}: changed by somebody else; it is written again, all rows")

    def close(self) -> Path:
        """Ends the journal, writes the Parquet file, removes the journal; returns the path of the
        Parquet file.

        The rows come from the copy in memory: they are there even if the folder has been removed or
        renamed.

        Raises:
            LogError: the log cannot be written; the journal is kept.
        """
        if self._open:
            self.flush()
            with self._file:
                self._end()
                self._write_table(self._table(), self.path, self._force)
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

    def _table(self) -> pa.Table:
        """Returns the rows that were written."""
        return read_content(self._copy, str(self.journal))[0]

    def _write_table(self, table: pa.Table, path: Path, force: bool) -> None:
        if self.notes:
            self.add_facts({"journal_notes": self.notes})
        write_table(table, self._metadata, path, force)

    def run_log(self) -> RunLog:
        """Reads the log that was written."""
        return read_run_log(self.path)

    def abandon(self) -> Path:
        """Flushes a run that failed and leaves its journal for `recover`; returns its path.

        Raises:
            LogError: the disk did not take the last rows.
        """
        if self._open:
            with self._file:
                try:
                    self.flush()
                finally:
                    failure = self._end(stays=True)
                if failure:
                    raise LogError(failure)
        return self.journal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()

    def _refuse(self, columns: Sequence[str]) -> None:
        require_unique(columns, f"{self.path}: column", LogError)
        refuse_missing(columns, self._metadata, str(self.path))
        refuse_existing(self.path, self._force, LogError)
        if self.journal.exists() and not self._force:
            raise LogError(
                f"{self.journal}: holds a run that goes on or was cut off; rescue it with "
                "`aerodima log recover` or use --force"
            )

    def _open_file(self) -> None:
        """Opens the journal and locks it; the end of the process unlocks it, however it ends."""
        try:
            self.journal.touch(exist_ok=self._force)
            self._file = open(self.journal, "r+b", buffering=0)  # noqa: SIM115 - open for as long as the run lasts
        except OSError as cause:
            raise LogError(f"{self.journal}: cannot be written ({cause.strerror})") from cause
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._file.truncate(0)
            for _ in range(2):
                self._write_frame(HEAD, self._schema.serialize().to_pybytes())
        except OSError as cause:
            self._file.close()
            reason = f"cannot be written ({cause.strerror})"
            if isinstance(cause, BlockingIOError):
                reason = "another process writes it; wait for its end, or choose another name"
            raise LogError(f"{self.journal}: {reason}") from cause

    def _write_frame(self, kind: bytes, content: bytes = b"") -> None:
        frame = make_frame(kind, self._run, self.rows, content)
        self._write_at(len(self._copy), frame)
        self._copy += frame

    def _write_at(self, place: int, content: bytes | bytearray) -> None:
        if os.pwrite(self._file.fileno(), content, place) != len(content):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _write_batch(self) -> None:
        self._flush_due = time.monotonic() + self._flush_interval
        if self._filled == 0:
            return
        self._write_frame(ROWS, self._buffer[: self._filled].tobytes())
        self.rows += self._filled
        self._filled = 0

    def _request_sync(self) -> None:
        if time.monotonic() >= self._sync_due and self._sync.done():
            self._begin_sync()

    def _begin_sync(self) -> None:
        """Waits for the last request to the disk, and makes another one."""
        self._sync.result(_SYNC_LIMIT)
        self._sync = Future()
        # a daemon: a disk that never answers must not hold up the end of the program
        threading.Thread(
            target=_sync_disk, args=(self._file.fileno(), self._sync), name="journal", daemon=True
        ).start()
        self._sync_due = time.monotonic() + self._sync_interval

    def _end(self, stays: bool = False) -> str:
        """Writes the end mark and waits for the disk, which then has all rows of a journal that
        stays; returns and notes a failure, if any.
        """
        self._writer = 0
        try:
            self.check(len(self._copy))
            self._write_frame(END)
            if stays:
                self._begin_sync()
            self._sync.result(_SYNC_LIMIT)
        except OSError as cause:
            failure = f"{self.journal}: the disk does not confirm the last rows ({cause!r})"
            self.note(failure)
            return failure
        return ""


def _sync_disk(descriptor: int, answer: Future[None]) -> None:
    """Asks the disk to keep a file, and hands over its answer."""
    try:
        os.fsync(descriptor)
        answer.set_result(None)
    except OSError as error:
        answer.set_exception(error)


def read_journal(path: Path | str) -> Content:
    """Reads the rows of the whole batches of a journal, and names what is damaged, missing or in
    doubt: nothing for one that was closed in order.

    Journals of version 0.3 and before have no checksums: their values are always in doubt.

    Raises:
        LogError: no such file, no whole head, not a journal, another schema version.
    """
    path = Path(path)
    if not path.is_file():
        raise LogError(f"{path}: no such journal")
    return read_content(path.read_bytes(), str(path))


def recover(
    journal: Path | str, out_path: Path | str | None = None, force: bool = False
) -> Recovery:
    """Writes the whole batches of a journal as a run log; the journal stays where it is.

    Damaged or missing parts are named, also in the log as `journal_notes` of `extra`.

    Args:
        journal: path of the journal, such as `run.parquet.journal`.
        out_path: path of the run log to write; by default the journal's path without its suffix.
        force: whether an existing file is replaced.

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
    table, damage = read_journal(journal)
    if table.num_rows == 0:
        raise LogError(f"{journal}: no complete batch in it; nothing to rescue")
    metadata = decode_metadata(table.schema.metadata, str(journal))
    metadata["extra"] |= {"recovered_rows": table.num_rows, "journal_notes": damage}
    path = write_table(table, metadata, Path(out_path), force)
    return Recovery(path, table.num_rows, tuple(damage))
