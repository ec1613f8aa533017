"""The results of a study on the disk: parts as they come, one table at the end, one client at a time.

A part is a whole file or none. A study that was cut off at any time goes on with what its parts do not hold; once the
table is written the parts are gone. The table has nothing in it that differs from time to time, so that it is the same
however often the study was stopped and wherever it ran; how long the runs took is in a file beside it.
"""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from aerodima.optimisation.sweep.study_engine import SweepError
from aerodima.workbench.atomic_write import make_folder, write_atomically
from aerodima.workbench.batch import WORKER_RECORD

TABLE, CSV, MARK, PARTS, LOCK, TIMING = "table.parquet", "table.csv", "study.json", "parts", ".lock", "timing.json"
STORE_SCHEMA = "aerodima/sweep/1"
METADATA_KEY = b"aerodima"
FLUSH_AFTER = 0.5
"""s; rows that come faster than this share a part."""

TEXT_COLUMNS = frozenset(
    [
        "block",
        "direction",
        "error",
        "member",
        "outcome",
        "run",
        "scenario",
        "scenario_sha256",
        "settings",
        "signals",
        "tail_mode",
        "touched",
    ]
)
"""Columns that are texts even where no row has one."""

Row = dict[str, Any]


class ResultStore:
    """The folder of one study, while it is open to this client; from `open_store`."""

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        self._folder, self._identity = folder, dict(identity)
        self._waiting: dict[int, Row] = {}
        self._written = time.monotonic()
        self._next_part = 1 + max((int(path.stem) for path in self._parts()), default=-1)

    @property
    def finished(self) -> bool:
        """Whether the table is there."""
        return (self._folder / TABLE).is_file()

    def rows(self) -> dict[int, Row]:
        """Place -> row of everything that is on the disk in parts."""
        found: dict[int, Row] = {}
        for path in self._parts():
            try:
                part = json.loads(path.read_text(encoding="utf-8"))
                found |= {int(place): row for place, row in part.items()}
            except (ValueError, AttributeError) as error:
                raise SweepError(f"{path}: damaged ({error}); remove it, and its runs are made again") from None
        return found

    def add(self, place: int, row: Row) -> None:
        """Keeps one row; it is on the disk within `FLUSH_AFTER` or at the next `flush`."""
        self._waiting[place] = row
        if time.monotonic() - self._written >= FLUSH_AFTER:
            self.flush()

    def flush(self) -> None:
        """Writes what waits as one part; SweepError when the disk is full, and then it still waits."""
        if not self._waiting:
            return
        text = json.dumps(self._waiting)
        path = self._folder / PARTS / f"{self._next_part:06d}.json"
        write_atomically(path, lambda temporary: _write(temporary, text), False, SweepError)
        self._next_part += 1
        self._waiting.clear()
        self._written = time.monotonic()

    def finish(self, frame: pd.DataFrame, timing: Mapping[str, Any]) -> None:
        """Writes the table as Parquet and CSV, then removes the parts."""
        table = pa.Table.from_pandas(frame, preserve_index=False)
        table = table.replace_schema_metadata({METADATA_KEY: json.dumps(self._identity, sort_keys=True).encode()})
        facts = json.dumps(dict(timing), indent=1) + "\n"
        self._put(CSV, lambda path: frame.to_csv(path, index=False))
        self._put(TIMING, lambda path: _write(path, facts))
        self._put(TABLE, lambda path: pq.write_table(table, path, compression="zstd"))
        for path in self._parts():
            path.unlink()

    def read_table(self) -> pd.DataFrame:
        """The finished table."""
        return read_table(self._folder)

    def clear(self) -> None:
        """Forgets all results."""
        for path in [*self._parts(), *(self._folder / name for name in (TABLE, CSV, TIMING))]:
            path.unlink(missing_ok=True)

    def _put(self, name: str, write: Callable[[Path], None]) -> None:
        write_atomically(self._folder / name, write, True, SweepError)

    def _parts(self) -> list[Path]:
        return sorted((self._folder / PARTS).glob("[0-9]*.json"))


@contextmanager
def open_store(folder: Path, identity: Mapping[str, Any], *, force: bool = False) -> Iterator[ResultStore]:
    """The store of a study in a folder, for this client alone.

    Args:
        folder: made when it is not there.
        identity: what makes results comparable: the study, its inputs, the versions; JSON-able.
        force: drop the results of another study or version that the folder holds, or finished ones.

    Raises:
        SweepError: another client writes there; the folder holds another study's results or foreign files; it cannot
            be written.
    """
    make_folder(folder / PARTS, SweepError)
    with _locked(folder):
        store = ResultStore(folder, identity)
        _claim(folder, identity, store, force)
        yield store


def read_table(folder: Path) -> pd.DataFrame:
    """The finished table of a folder; SweepError where there is none."""
    path = folder / TABLE
    if not path.is_file():
        raise SweepError(f"{path}: no such table; `aerodima sweep run` makes it")
    return pq.read_table(path).to_pandas(ignore_metadata=True)


def make_frame(rows: Sequence[Row]) -> pd.DataFrame:
    """Rows with different keys as one table: numbers as float, truth values as boolean, everything else as text.

    The order of the columns is that of their first appearance in a list of rows that is in order itself; the kind of a
    column does not depend on the order of its rows.
    """
    names = list(dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row))
    return pd.DataFrame({name: _column(name, [row.get(name) for row in rows]) for name in names})


def _column(name: str, values: list[Any]) -> pd.Series:
    present = [value for value in values if value is not None]
    if name == "clean" or (present and all(isinstance(value, bool) for value in present)):
        return pd.Series(values, dtype="boolean")
    is_text = name in TEXT_COLUMNS or name.startswith("version_")
    if not is_text and all(isinstance(value, int | float) for value in present):
        return pd.Series([None if value is None else float(value) for value in values], dtype="float64")
    return pd.Series([None if value is None else str(value) for value in values], dtype="str")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Holds the folder's lock; the system frees it when the process ends, however it ends."""
    with open(folder / LOCK, "w", encoding="utf-8") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise SweepError(
                f"{folder}: another client is writing this study; wait for it, or choose another folder"
            ) from None
        yield


def _claim(folder: Path, identity: Mapping[str, Any], store: ResultStore, force: bool) -> None:
    mark = folder / MARK
    if force:
        store.clear()
    elif mark.exists():
        _refuse_other(mark, identity)
    elif foreign := sorted(path.name for path in folder.iterdir() if path.name not in (PARTS, LOCK, WORKER_RECORD)):
        raise SweepError(f"{folder}: holds other files ({', '.join(foreign[:3])}); choose another folder, or --force")
    text = json.dumps({"schema": STORE_SCHEMA, **identity}, indent=1, sort_keys=True) + "\n"
    write_atomically(mark, lambda path: _write(path, text), True, SweepError)


def _refuse_other(mark: Path, identity: Mapping[str, Any]) -> None:
    try:
        found = json.loads(mark.read_text(encoding="utf-8"))
    except ValueError:
        found = {}
    expected = json.loads(json.dumps({"schema": STORE_SCHEMA, **identity}))
    differing = [key for key in expected if not isinstance(found, dict) or found.get(key) != expected[key]]
    if differing:
        raise SweepError(
            f"{mark.parent}: holds results of another study ({', '.join(differing)} differ); choose another folder, or "
            "--force drops them"
        )


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
