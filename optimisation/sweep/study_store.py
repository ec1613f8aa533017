"""The results of a study on the disk: rows as they come, one table at the end, one client at a time.

A study that was cut off at any time goes on with what its rows do not hold. The table has nothing in it that differs
from time to time, so that it is the same however often the study was stopped and wherever it ran; how long the runs
took is in a file beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from aerodima.optimisation.sweep.study_engine import SweepError
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.batch.row_store import Row, RowStore

TABLE, CSV, MARK, ROWS, TIMING = "table.parquet", "table.csv", "study.json", "rows.jsonl", "timing.json"
METADATA_KEY = b"aerodima"

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


def open_store(folder: Path, identity: Mapping[str, Any], *, force: bool = False) -> RowStore:
    """The rows of a study in a folder of its own; SweepError as `RowStore`."""
    store = RowStore(folder / ROWS, identity, force=force, alone=True, error=SweepError)
    if force:
        (folder / TABLE).unlink(missing_ok=True)
    return store


def write_table(folder: Path, frame: pd.DataFrame, identity: Mapping[str, Any], timing: Mapping[str, Any]) -> None:
    """Writes the table of a study as Parquet and CSV, and beside it what was run and how long it took."""
    table = pa.Table.from_pandas(frame, preserve_index=False)
    table = table.replace_schema_metadata({METADATA_KEY: json.dumps(identity, sort_keys=True).encode()})
    files: dict[str, str | Callable[[Path], object]] = {
        MARK: json.dumps(identity, indent=1, sort_keys=True) + "\n",
        CSV: frame.to_csv(index=False),
        TIMING: json.dumps(timing, indent=1) + "\n",
        TABLE: lambda path: pq.write_table(table, path, compression="zstd"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content, True, SweepError)


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
