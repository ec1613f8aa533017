"""Logs in other programs' files: read from CSV, Parquet, MAT, MCAP, bags of ROS and ULog, written as CSV and MCAP.

A log that is read is named columns of numbers, in whatever unit and rate they were written; `logs.importers` makes it a
run log. One that is written keeps every bit of every number, and the metadata, so that `aerodima log import` gives back
the same log: a CSV has its metadata in a file beside it, `run.csv.json`; MCAP has them inside.
"""

import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from aerodima.workbench.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.config.signal_table import PLANT_POSITION_PREFIX, TIME
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.journal import follow_run
from aerodima.workbench.logs.mapping import CsvFormat
from aerodima.workbench.logs.schema import METADATA_KEY, RunLog, decode_metadata

if TYPE_CHECKING:
    from aerodima.workbench.logs.message_logs import SceneMessage

SIDECAR_SUFFIX = ".json"
"""An exported `run.csv` has its metadata in `run.csv.json`."""


@dataclass(frozen=True)
class ForeignLog:
    """The columns of a file.

    Attributes:
        path: the file, for messages.
        columns: name to values; lengths may differ between columns of different rates.
        time_of: name of the column with the times of a column, where the format knows it (MCAP).
        unreadable: columns or topics that are there but cannot be read, with the reason.
        metadata: of a file that this project exported; None otherwise.
    """

    path: str
    columns: Mapping[str, pd.Series]
    time_of: Mapping[str, str] = field(default_factory=dict)
    unreadable: Mapping[str, str] = field(default_factory=dict)
    metadata: dict[str, Any] | None = None

    def numbers(self, name: str) -> FloatArray:
        """A column as float64, empty cells as NaN.

        Raises:
            LogError: no such column (names the nearest), a cell that is not a number (names its row, from 1).
        """
        series = self._series(name)
        if series.dtype.kind in "fiub":
            return series.to_numpy(dtype=np.float64)
        numbers = pd.to_numeric(series, errors="coerce")
        bad = np.flatnonzero(numbers.isna().to_numpy() & series.notna().to_numpy())
        if bad.size:
            raise LogError(
                f"{self.path}: column {name!r}: {str(series.iloc[bad[0]])!r} in row {bad[0] + 1} is not a number"
            )
        return numbers.to_numpy(dtype=np.float64)

    def times(self, name: str) -> FloatArray:
        """A column of times: numbers as they are, dates (ISO 8601) as seconds since 1970."""
        series = self._series(name)
        if series.dtype.kind in "fiub":
            return self.numbers(name)
        try:
            dates = pd.to_datetime(series, utc=True, format=None if series.dtype.kind == "M" else "ISO8601")
        except (ValueError, TypeError):
            return self.numbers(name)
        seconds = (dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
        return np.asarray(seconds, dtype=np.float64)

    def _series(self, name: str) -> pd.Series:
        if name in self.unreadable:
            raise LogError(f"{self.path}: {name!r} cannot be read: {self.unreadable[name]}")
        if name not in self.columns:
            raise LogError(f"{self.path}: no column {name!r}; {nearest(name, self.columns)}")
        return self.columns[name]


def read_foreign_log(path: Path | str, csv: CsvFormat | None = None) -> ForeignLog:
    """Reads a file by its ending: .csv, .txt, .tsv, .parquet, .mat, .mcap, .bag, .ulg; a folder is a bag of ROS 2.

    Raises:
        LogError: missing, of another kind, damaged, or an optional package is not installed (names the extra).
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        raise LogError(f"{path}: a folder without metadata.yaml, so not a bag of ROS 2")
    if path.is_dir() or (suffix == ".bag" and path.is_file()):
        from aerodima.workbench.logs.message_logs import read_bag

        return read_bag(path)
    if not path.is_file():
        raise LogError(f"{path}: no such file")
    if suffix in (".csv", ".txt", ".tsv"):
        return _read_csv(path, csv or CsvFormat(delimiter="\t" if suffix == ".tsv" else ","))
    if suffix == ".parquet":
        return _read_parquet(path)
    if suffix == ".mat":
        from aerodima.workbench.logs.mat_files import read_mat

        return read_mat(path)
    if suffix == ".mcap":
        from aerodima.workbench.logs.message_logs import read_mcap

        return read_mcap(path)
    if suffix == ".ulg":
        from aerodima.workbench.logs.message_logs import read_ulog

        return read_ulog(path)
    if suffix == ".db3":
        raise LogError(f"{path}: a part of a bag of ROS 2; name its folder, with metadata.yaml: {path.parent}")
    raise LogError(
        f"{path}: {suffix or 'a file without ending'} is not read; allowed: .csv .txt .tsv .parquet .mat .mcap .bag "
        ".ulg, and the folder of a bag of ROS 2"
    )


def joined(logs: list[ForeignLog]) -> ForeignLog:
    """Several files of one run as one: the columns of the second file are called `2:<name>`, and so on."""
    if len(logs) == 1:
        return logs[0]
    columns: dict[str, pd.Series] = {}
    time_of: dict[str, str] = {}
    unreadable: dict[str, str] = {}
    for number, log in enumerate(logs, start=1):
        prefix = "" if number == 1 else f"{number}:"
        columns |= {prefix + name: series for name, series in log.columns.items()}
        time_of |= {prefix + name: prefix + time for name, time in log.time_of.items()}
        unreadable |= {prefix + name: reason for name, reason in log.unreadable.items()}
    return ForeignLog(" + ".join(log.path for log in logs), columns, time_of, unreadable)


def sidecar(path: Path) -> Path:
    """The file with the metadata of an exported CSV."""
    return path.with_name(path.name + SIDECAR_SUFFIX)


def _read_csv(path: Path, form: CsvFormat) -> ForeignLog:
    first = form.skip_lines + 1
    skipped = [*range(form.skip_lines), *range(first, first + form.skip_after_names)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # values would be dropped
            table = pd.read_csv(
                path,
                sep=form.delimiter,
                decimal=form.decimal,
                skiprows=skipped,
                comment=form.comment,
                encoding=form.encoding,
                skipinitialspace=True,
                index_col=False,
                low_memory=False,
            )
    except pd.errors.ParserWarning as cause:
        raise LogError(
            f"{path}: its rows hold more values than its first line has names; are `csv.delimiter` {form.delimiter!r} "
            f"and `csv.decimal` {form.decimal!r} right?"
        ) from cause
    except (ValueError, LookupError, pd.errors.ParserError) as cause:
        raise LogError(f"{path}: not a table that can be read: {' '.join(str(cause).split())}") from cause
    if table.shape[1] < 2:
        raise LogError(
            f"{path}: one column only, {str(table.columns[0])!r}; is `csv.delimiter` {form.delimiter!r} right?"
        )
    metadata = None
    if sidecar(path).is_file():
        metadata = decode_metadata({METADATA_KEY: sidecar(path).read_bytes()}, str(sidecar(path)))
    return ForeignLog(str(path), {str(name).strip(): table[name] for name in table.columns}, metadata=metadata)


def _read_parquet(path: Path) -> ForeignLog:
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as cause:
        raise LogError(f"{path}: cut off, damaged or not a Parquet file") from cause
    stored = table.schema.metadata or {}
    metadata = decode_metadata(stored, str(path)) if METADATA_KEY in stored else None
    frame = table.to_pandas(ignore_metadata=True)
    return ForeignLog(str(path), {str(name): frame[name] for name in frame.columns}, metadata=metadata)


Format = Literal["csv", "mcap"]
FORMATS: tuple[Format, ...] = ("csv", "mcap")


def export_log(
    run_log: RunLog, path: Path | str, form: Format, force: bool = False, scene: "Iterable[SceneMessage]" = ()
) -> list[Path]:
    """Writes a run log as CSV or MCAP; gives the files written.

    Args:
        run_log: the run.
        path: to write.
        form: of the file.
        force: replace an existing file.
        scene: for MCAP, what a viewer draws, such as `aerodima.workbench.replay.foxglove_scene` gives.

    Raises:
        LogError: a file exists and `force` is not set; MCAP without the package, or with negative times.
    """
    path = Path(path)
    metadata = json.dumps(_exported(run_log), sort_keys=True, indent=1, allow_nan=False)
    if form == "csv":
        beside = sidecar(path)
        refuse_existing(beside, force, LogError)
        write_atomically(path, run_log.table.to_csv(index=False), force, LogError)
        write_atomically(beside, metadata + "\n", force, LogError)
        return [path, beside]
    from aerodima.workbench.logs.message_logs import McapFile

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as stream:
            written = McapFile(stream, topics_of(list(run_log.table.columns)), TIME)
            written.add(run_log.table, scene)
            written.finish(metadata)

    write_atomically(path, write, force, LogError)
    return [path]


def export_live(
    run: Path, path: Path, scene: "Callable[[RunLog, int], Iterable[SceneMessage]]", wait: float = 0.5,
    force: bool = False,
) -> Iterator[int]:  # fmt: skip
    """Writes a run as MCAP while it is still going on; gives the rows so far at every look, until it has ended.

    Its journal is read from beside, so that the program that writes it does nothing for it. When the reading is ended
    (`close` of the generator, Ctrl-C), the file is ended in order, with the rows of until then.

    Args:
        run: the run log to be.
        path: to write.
        scene: what a viewer draws of the rows from one on, such as `foxglove_scene`.
        wait: between two looks at the journal, s.
        force: replace an existing file, once the run is found.

    Raises:
        LogError: no such run, the file is there or cannot be written, a package is missing, or negative times.
    """
    from aerodima.workbench.logs.message_logs import McapFile

    following = follow_run(run, wait)
    first = run_log = next(following)
    seen, written = 0, None
    try:
        with open(path, "wb" if force else "xb") as stream:
            try:
                for run_log in chain([first], following):
                    written = written or McapFile(stream, topics_of(list(run_log.table.columns)), TIME)
                    if len(run_log.table) > seen:
                        written.add(run_log.table.iloc[seen:], scene(run_log, seen))
                        seen = len(run_log.table)
                    yield seen
            finally:
                if written is not None:
                    written.finish(json.dumps(_exported(run_log), sort_keys=True, indent=1, allow_nan=False))
    except OSError as cause:
        raise LogError(f"{path}: cannot be written ({cause.strerror})") from None


def topics_of(columns: list[str]) -> dict[str, list[str]]:
    """MCAP topics and their columns: one per device, so that a viewer shows them in groups."""
    topics: dict[str, list[str]] = {}
    for name in columns:
        if name != TIME:
            topics.setdefault(_topic(name), []).append(name)
    return topics


def _topic(column: str) -> str:
    if column.startswith(PLANT_POSITION_PREFIX):
        return "/plant"
    if "_truth" in column:
        return "/truth"
    for device in ("imu", "tail", "sail", "status", "speed"):
        if column.startswith(f"{device}_"):
            return f"/{device}"
    if column.startswith(("angle", "angular", "current", "force", "torque")):
        return "/rig"
    return "/driver"


def _exported(run_log: RunLog) -> dict[str, Any]:
    metadata = run_log.metadata()
    return {**metadata, "extra": {**metadata["extra"], "exported_columns": list(run_log.table.columns)}}
