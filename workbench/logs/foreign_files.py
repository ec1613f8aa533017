"""Logs in other programs' files as named columns of numbers: CSV, Parquet, MAT and MCAP.

They are in whatever unit and rate they were written; `logs.importers` makes a run log of them. MAT
files of version 5 to 7 are read with SciPy, of version 7.3, which is HDF5, with h5py (extra
`logs`). Vectors become columns. A struct field is called `data.force`, the second column of a
matrix `force(2)`, or its second row where a sample is a column, as Simulink's To File writes them.
Objects such as `timeseries` are stored in a form that only MATLAB reads.

MCAP files (https://mcap.dev, extra `logs`) are read where their messages are JSON: a number becomes
the column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a topic was
logged are the column `<topic>@log_time`, those at which it was published `<topic>@publish_time`,
both s.

What is no number (text, objects, lists of any length) is listed as unreadable with the reason.
Checksums of a file are compared. What a parser raises of a damaged file, `logs.importers` turns
into one error.
"""

import json
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.extras import require
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.logs.hdf5_reading import read_hdf5
from aerodima.workbench.logs.mapping import CsvFormat

Columns = dict[str, pd.Series]
"""Values by the name of the column."""
Texts = dict[str, str]
"""Reason why it is unreadable, or name of the times, by the name of the column."""
MAX_COLUMNS = 64
"""A matrix with more columns than this (and than rows) has its channels in rows; a list with more
numbers is a picture or a table of something else, not a log."""
MAX_TEXT_LOG = 4 * 2**30
"""Size of the longest CSV that is read, bytes."""
NANOSECOND = 1e-9
"""One nanosecond, s."""
_NAN = ("NaN", "nan", "NAN", "NA", "null", "")
"""Texts that stand for a number that is not there."""
_VALUE = re.compile(r"[-+]?[\d.,]*\d[.,]?(e[-+]?\d+)?|nan|[-+]?inf|\d{4}-\d\d-\d\d.*", re.I)
"""A number or a date."""
_OBJECT = (
    "a MATLAB object or cell; save it as a struct of vectors (for a timeseries: its Time and Data)"
)


@dataclass(frozen=True)
class ForeignLog:
    """The columns of a file.

    Attributes:
        path: the file, for messages.
        columns: name to values; lengths may differ between columns of different rates.
        time_of: name of the column with the times of a column, where the format knows it (MCAP).
        unreadable: columns or topics that are there but cannot be read, with the reason.
    """

    path: str
    columns: Mapping[str, pd.Series]
    time_of: Mapping[str, str] = field(default_factory=dict)
    unreadable: Mapping[str, str] = field(default_factory=dict)

    def numbers(self, name: str) -> FloatArray:
        """Reads a column as float64, empty cells as NaN.

        Raises:
            LogError: no such column (names the nearest), dates or durations, a cell that is not a
                number (names its row, from 1).
        """
        series = self._series(name)
        if series.dtype.kind in "fiub":
            return series.to_numpy(float)
        if series.dtype.kind in "mM":
            raise LogError(
                f"{self.path}: column {name!r}: dates or durations, not numbers; map it as a `time`"
            )
        numbers = pd.to_numeric(series, errors="coerce")
        bad = np.flatnonzero(numbers.isna() & series.notna() & ~series.isin(_NAN))
        if bad.size:
            text = str(series.iloc[bad[0]])
            raise LogError(
                f"{self.path}: column {name!r}: {text!r} in row {bad[0] + 1} is not a number"
            )
        return numbers.to_numpy(float)

    def times(self, name: str, unit: float) -> FloatArray:
        """Reads a column of times, s: numbers in a unit of so many seconds; durations, and dates
        (ISO 8601) since 1970, have their own.
        """
        series = self._series(name)
        if series.dtype.kind == "m":
            return series.dt.total_seconds().to_numpy(float)
        try:
            return unit * self.numbers(name)
        except LogError as error:
            form = None if series.dtype.kind == "M" else "ISO8601"
            try:
                dates = pd.to_datetime(series, utc=True, format=form)
            except (ValueError, TypeError):
                raise error from None
        seconds = (dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
        return np.asarray(seconds, float)

    def _series(self, name: str) -> pd.Series:
        if name in self.unreadable:
            raise LogError(f"{self.path}: {name!r} cannot be read: {self.unreadable[name]}")
        if name not in self.columns:
            raise LogError(f"{self.path}: no column {name!r}; {nearest(name, self.columns)}")
        return self.columns[name]


def joined(logs: list[ForeignLog]) -> ForeignLog:
    """Joins files of one run: the columns of the second are called `2:<name>`, and so on."""
    whole = logs[0]
    for number, log in enumerate(logs[1:], start=2):
        prefix = f"{number}:"
        columns = {prefix + name: series for name, series in log.columns.items()}
        time_of = {prefix + name: prefix + time for name, time in log.time_of.items()}
        unreadable = {prefix + name: reason for name, reason in log.unreadable.items()}
        whole = ForeignLog(
            f"{whole.path} + {log.path}",
            {**whole.columns, **columns},
            {**whole.time_of, **time_of},
            {**whole.unreadable, **unreadable},
        )
    return whole


def read_csv(path: Path, form: CsvFormat) -> ForeignLog:
    """Reads the columns of a CSV.

    Raises:
        LogError: no line of names, rows with more values than names, one column only.
    """
    if path.stat().st_size > MAX_TEXT_LOG:
        raise LogError(f"{path}: longer than {MAX_TEXT_LOG // 2**30} GiB; cut it into parts")
    read: Any = partial(
        pd.read_csv,
        path,
        sep=form.delimiter,
        decimal=form.decimal,
        comment=form.comment,
        encoding=form.encoding,
        skipinitialspace=True,
        index_col=False,
    )
    start = form.skip_lines
    first = start
    if form.names is None:
        first = start + 1
        head = read(header=None, skiprows=start, nrows=1, dtype=str, keep_default_na=False)
        _refuse_values(path, [cell.strip() for cell in head.iloc[0]])
    skipped = [*range(start), *range(first, first + form.skip_after_names)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # values would be dropped
            table = read(
                header=0 if form.names is None else None,
                names=form.names,
                skiprows=skipped,
                low_memory=False,
            )
    except pd.errors.ParserWarning as cause:
        raise LogError(
            f"{path}: its rows hold more values than there are names; are `csv.delimiter` "
            f"{form.delimiter!r} and `csv.decimal` {form.decimal!r} right?"
        ) from cause
    if table.shape[1] < 2:
        raise LogError(
            f"{path}: one column only, {str(table.columns[0])!r}; is `csv.delimiter` "
            f"{form.delimiter!r} right?"
        )
    return ForeignLog(str(path), {str(name).strip(): table[name] for name in table.columns})


def _refuse_values(path: Path, names: list[str]) -> None:
    """Raises LogError when names are values: numbers and dates only, or one that is not a whole
    number, as the name of a channel may be.
    """
    values = [name for name in names if _VALUE.fullmatch(name)]
    if len(values) == len(names) or not all(map(str.isdigit, values)):
        raise LogError(
            f"{path}: {values[:1]} where a line has the names of the columns; state `csv.names` in "
            "the mapping, a list, or correct `csv.skip_lines`"
        )


def read_parquet(path: Path) -> ForeignLog:
    """Reads the columns of a Parquet file whose checksums, where it has any, are right."""
    columns: Columns = {}
    unreadable: Texts = {}
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        table = file.read()
    for name, values in zip(table.column_names, table.columns, strict=True):
        if name in columns:
            unreadable[f"{name} (again)"] = "two columns have this name"
        elif pa.types.is_nested(values.type):
            unreadable[name] = f"its values are {values.type}"
        else:
            columns[name] = values.to_pandas()
    return ForeignLog(str(path), columns, unreadable=unreadable)


def read_mat(path: Path) -> ForeignLog:
    """Reads the columns of a MAT file.

    Raises:
        LogError: h5py is not installed and the file is of version 7.3.
    """
    if is_version_7_3(path):
        require("logs", path, "h5py", error=LogError)
        struct = read_hdf5(path)
    else:
        from scipy.io import loadmat

        struct = loadmat(path, simplify_cells=True)
    columns: Columns = {}
    unreadable: Texts = {}
    for name, value in _walk("", struct):
        kind = "O" if isinstance(value, list) else np.asarray(value).dtype.kind
        if kind not in "fiub":
            reasons = {"U": "text", "S": "text", "c": "complex numbers; save their parts"}
            unreadable[name] = reasons.get(kind, _OBJECT)
        elif np.squeeze(value).ndim > 2:
            unreadable[name] = f"an array of {np.shape(value)} is no table of channels"
        else:
            columns |= _vectors(name, np.squeeze(value).astype(float))
    return ForeignLog(str(path), columns, unreadable=unreadable)


def is_version_7_3(path: Path) -> bool:
    """Says whether a MAT file is HDF5: its text header says so, or the HDF5 signature is at a place
    where it may be.
    """
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


def _vectors(name: str, value: NDArray) -> Columns:
    """Splits an array into its columns; into its rows where these are far fewer."""
    if value.ndim <= 1:
        return {name: pd.Series(np.atleast_1d(value))}
    if value.shape[1] > max(MAX_COLUMNS, value.shape[0]):
        value = value.T  # a block To File of Simulink writes a sample a column
    return {f"{name}({number})": pd.Series(column) for number, column in enumerate(value.T, 1)}


def _walk(prefix: str, struct: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Walks over the leaves of a struct, with their names."""
    for key, value in struct.items():
        if key.startswith(("__", "#")):
            continue
        if isinstance(value, dict):
            yield from _walk(f"{prefix}{key}.", value)
        else:
            yield prefix + key, value


def read_mcap(path: Path) -> ForeignLog:
    """Reads the columns of an MCAP file whose checksums are right.

    The file is read from its beginning to its end: its index may be damaged, and its messages are
    counted.

    Raises:
        LogError: a package is not installed, a message is missing.
    """
    require("logs", path, "mcap", error=LogError)
    from mcap.records import Channel, Message, Statistics
    from mcap.stream_reader import StreamReader

    unreadable: Texts = {}
    messages: dict[str, list[dict[str, Any]]] = {}
    channels: dict[int, Channel] = {}
    count = 0
    with open(path, "rb") as stream:
        reader = StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size)
        for record in reader.records:
            if isinstance(record, Channel):
                channels[record.id] = record
                if record.message_encoding != "json":
                    reason = f"its messages are {record.message_encoding!r}; read are 'json'"
                    unreadable[record.topic] = reason
            elif isinstance(record, Message):
                count += 1
                topic = channels[record.channel_id].topic
                if topic not in unreadable:
                    row = {
                        topic: json.loads(record.data),
                        f"{topic}@log_time": record.log_time * NANOSECOND,
                        f"{topic}@publish_time": record.publish_time * NANOSECOND,
                    }
                    messages.setdefault(topic, []).append(row)
            elif isinstance(record, Statistics) and record.message_count != count:
                raise LogError(
                    f"{path}: {count} messages are there of {record.message_count} that were "
                    "written; it is damaged, copy it again"
                )
    columns: Columns = {}
    time_of: Texts = {}
    for topic, rows in messages.items():
        time = f"{topic}@log_time"
        rows.sort(key=itemgetter(time))
        numbers: Columns = {}
        _add_numbers(pd.json_normalize(rows), numbers, unreadable)
        columns |= numbers
        time_of |= dict.fromkeys(numbers, time)
    return ForeignLog(str(path), columns, time_of, unreadable)


def _add_numbers(table: pd.DataFrame, columns: Columns, unreadable: Texts) -> None:
    """Adds every column with a number, those of a list by their places; the others to those that
    cannot be read. A number that JSON has not may be text, "NaN".
    """
    for name, values in table.items():
        cells = values.map(lambda value: str(value) if isinstance(value, dict) else value)
        if cells.map(lambda cell: isinstance(cell, list)).any():
            lists = pd.DataFrame([cell if isinstance(cell, list) else [cell] for cell in cells])
            width = lists.shape[1]
            lists.columns = [f"{name}({number})" for number in range(1, width + 1)]
            if width <= MAX_COLUMNS:
                _add_numbers(lists, columns, unreadable)
            else:
                unreadable[str(name)] = f"lists of up to {width} values"
            continue
        stated = cells.dropna()
        if stated.empty or pd.to_numeric(stated, errors="coerce").notna().any():
            columns[str(name)] = cells
        else:
            unreadable[str(name)] = f"no number, but {stated.iloc[0]!r}"
