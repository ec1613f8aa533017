"""Resumable work: its rows in a file, one line of JSON each, locked by one process; its progress.

Work that was cut off at any time (Ctrl-C, a killed process, a full disk) goes on with the rows that
its file lacks. Each of the first two lines holds what all rows have in common, and each row has a
key of everything else that determines it: a row of other inputs is never taken for one of these.
A line that was cut off, or is damaged, costs its own row alone.
"""

import fcntl
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from aerodima.workbench.core.atomic_write import make_folder
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Facts, Json

ProgressLine = Callable[[str], None]
"""Function that receives each line of progress."""
WORKER_RECORD = "workers.jsonl"
"""File in the folder of a study: a line per event with time, worker, process and text."""
Row = Json
BAR_WIDTH = 24
"""Width of the progress bar, characters."""


def no_progress(_line: str) -> None:
    """Print nothing."""


def print_progress(line: str) -> None:
    """Print a line to stderr at once."""
    print(line, file=sys.stderr, flush=True)


class RowStore:
    """The file of one piece of work, locked until it is closed or the process ends, however it
    ends.

    Args:
        path: path of the file; its folder is made when it is not there.
        identity: what all rows have in common, JSON-able: schema, settings, versions.
        force: whether the rows that are there are dropped.
        alone: whether a folder that holds other files and no rows is refused, unless `force`.
        error: class of the errors raised.

    Raises:
        UserError: another process works with the file, it holds rows of another identity, or it
            cannot be written.
    """

    def __init__(
        self,
        path: Path,
        identity: Facts,
        *,
        force: bool = False,
        alone: bool = False,
        error: type[UserError] = UserError,
    ) -> None:
        self.path = path
        self._error = error
        make_folder(path.parent, error)
        if alone and not force and not path.exists():
            self._refuse_other_files()
        try:
            self._stream = path.open("ab+", buffering=0)
        except OSError as cause:
            raise error(f"{path}: cannot be written ({cause.strerror})") from None
        try:
            self._lock()
            if force:
                self._stream.truncate(0)
            self.rows = self._read(json.loads(json.dumps(identity)))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_reason: object) -> None:
        self.close()

    def add(self, key: str, row: Row) -> None:
        """Keep a row; it has reached the operating system when this returns."""
        self.rows[key] = row
        self._append({"key": key, **row})

    def close(self) -> None:
        """Unlock the file; the end of the process does so too."""
        self._stream.close()

    def _refuse_other_files(self) -> None:
        folder = self.path.parent
        names = sorted(path.name for path in folder.iterdir() if path.name != WORKER_RECORD)
        if names:
            raise self._error(
                f"{folder}: holds files such as {', '.join(names[:3])}; choose another folder, or "
                "--force"
            )

    def _lock(self) -> None:
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise self._error(
                f"{self.path.parent}: another process works in it; wait for it, or choose another "
                "folder"
            ) from None

    def _read(self, identity: Row) -> dict[str, Row]:
        lines = read_rows(self.path)
        heads = [line for line in lines if "key" not in line]
        if lines and identity not in heads:
            head = (heads or [{}])[0]
            differing = [key for key in {**identity, **head} if head.get(key) != identity.get(key)]
            raise self._error(
                f"{self.path}: holds results of other parameters, settings or versions "
                f"({', '.join(differing)}), or its head is damaged; "
                "choose another --out, or drop them: --force, or remove this file"
            )
        content = self.path.read_bytes()
        if content and not content.endswith(b"\n"):
            self._write(b"\n")
        for _ in range(heads.count(identity), 2):
            self._append(identity)
        return {line.pop("key"): line for line in lines if isinstance(line.get("key"), str)}

    def _append(self, line: Row) -> None:
        self._write((json.dumps(line, default=_plain) + "\n").encode())

    def _write(self, data: bytes) -> None:
        try:
            if self._stream.write(data) != len(data):
                raise OSError(None, "No space left on device")
        except OSError as cause:
            raise self._error(f"{self.path}: cannot be written ({cause.strerror})") from None


def read_rows(path: Path) -> list[Row]:
    """Read heads and rows of a `RowStore`, without damaged lines; none if there is no file."""
    lines: list[Row] = []
    if not path.is_file():
        return lines
    for text in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(line, dict):
            lines.append(line)
    return lines


def content_key(*content: Any) -> str:
    """Make a key that is the same for the same JSON-able content."""
    text = json.dumps(content, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _plain(value: Any) -> Any:
    """Convert NumPy's scalars to Python's, without loading NumPy."""
    if hasattr(value, "item"):
        return value.item()
    return str(value)


class ProgressBar:
    """A progress bar with the time that is left, at the pace so far.

    Args:
        progress: function that receives a line per piece.
        total: number of pieces of the whole work.
        there: number of pieces that were done before.
    """

    def __init__(self, progress: ProgressLine, total: int, there: int = 0) -> None:
        self.total = total
        self.done = there
        self._there = there
        self._progress = progress
        self._start = time.monotonic()

    def advance(self, what: str) -> None:
        """Count a piece, and show `what` beside the count."""
        self.done += 1
        pace = (time.monotonic() - self._start) / (self.done - self._there)
        left = pace * (self.total - self.done)
        filled = "#" * (BAR_WIDTH * self.done // self.total)
        count = f"{self.done:>{len(str(self.total))}}/{self.total}"
        self._progress(f"[{filled:.<{BAR_WIDTH}}] {count} {what:8} {left:5.0f} s to go")


@contextmanager
def print_resume_hint(progress: ProgressLine, kept: Callable[[], str]) -> Iterator[None]:
    """Print how to continue, and `kept()`, when work is stopped by Ctrl-C or an error."""
    try:
        yield
    except BaseException:
        progress(f"stopped: {kept()} are kept; the same command goes on with the rest")
        raise


def terminal_progress() -> ProgressLine:
    """Make a function that prints lines to stderr; on a terminal a progress line is overwritten."""
    shown = 0

    def progress(line: str) -> None:
        nonlocal shown
        if not sys.stderr.isatty():
            print_progress(line)
            return
        end = "" if line.startswith("[") or line.endswith("...") else "\n"
        print("\r" + line.ljust(shown), end=end, file=sys.stderr, flush=True)
        shown = 0 if end else len(line)

    return progress
