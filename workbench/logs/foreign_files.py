"""Logs in other programs' files as named columns of numbers: CSV, Parquet, MAT and MCAP.

They are in whatever unit and rate they were written; `logs.importers` makes a run log of them. MAT
files of version 5 to 7 are read with SciPy, of version 7.3, which is HDF5, with h5py (extra
`logs`). Vectors become columns. A struct field is called `data.force`, the second column of a
matrix `force(2)`. Objects such as `timeseries` are stored in a form that only MATLAB reads: they
are listed as unreadable.

MCAP files (https://mcap.dev, extra `logs`) are read where their messages are JSON: a number becomes
the column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a topic was
logged are the column `<topic>@log_time`, those at which it was published `<topic>@publish_time`,
both s. Text is left out.
"""

import json
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.logs.mapping import CsvFormat

MAX_COLUMNS = 64
"""A matrix with more columns than this (and than rows) is a picture or a table of something else,
not a log; so is a list with more numbers."""
NANOSECOND = 1e-9
"""One nanosecond, s."""
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
            LogError: no such column (names the nearest), a cell that is not a number (names its
                row, from 1).
        """
        series = self._series(name)
        if series.dtype.kind in "fiub":
            return series.to_numpy(float)
        numbers = pd.to_numeric(series, errors="coerce")
        bad = np.flatnonzero(numbers.isna() & series.notna())
        if bad.size:
            text = str(series.iloc[bad[0]])
            raise LogError(
                f"{self.path}: column {name!r}: {text!r} in row {bad[0] + 1} is not a number"
            )
        return numbers.to_numpy(float)

    def times(self, name: str) -> FloatArray:
        """Reads a column of times: numbers as they are, dates (ISO 8601) as seconds since 1970."""
        series = self._series(name)
        if series.dtype.kind in "fiub":
            return self.numbers(name)
        form = None if series.dtype.kind == "M" else "ISO8601"
        try:
            dates = pd.to_datetime(series, utc=True, format=form)
        except (ValueError, TypeError):
            return self.numbers(name)
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
    """Reads the columns of a CSV; LogError when it is not a table that can be read."""
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
            f"{path}: its rows hold more values than its first line has names; are `csv.delimiter` "
            f"{form.delimiter!r} and `csv.decimal` {form.decimal!r} right?"
        ) from cause
    except (ValueError, LookupError, pd.errors.ParserError) as cause:
        raise LogError(f"{path}: not a table that can be read: {_one_line(cause)}") from cause
    if table.shape[1] < 2:
        raise LogError(
            f"{path}: one column only, {str(table.columns[0])!r}; is `csv.delimiter` "
            f"{form.delimiter!r} right?"
        )
    return ForeignLog(str(path), {str(name).strip(): table[name] for name in table.columns})


def _one_line(cause: Exception) -> str:
    """Joins the lines of a parser's message."""
    return " ".join(str(cause).split())


def read_parquet(path: Path) -> ForeignLog:
    """Reads the columns of a Parquet file; LogError when it is damaged."""
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as cause:
        raise LogError(f"{path}: cut off, damaged or not a Parquet file") from cause
    frame = table.to_pandas(ignore_metadata=True)
    return ForeignLog(str(path), {str(name): frame[name] for name in frame.columns})


def read_mat(path: Path) -> ForeignLog:
    """Reads the columns of a MAT file.

    Raises:
        LogError: damaged or not a MAT file; h5py is not installed and the file is of version 7.3.
    """
    columns: dict[str, pd.Series] = {}
    unreadable: dict[str, str] = {}
    leaves = _leaves_7_3(path) if is_version_7_3(path) else _leaves_5(path)
    for name, value in leaves:
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            columns |= _vectors(name, value)
        elif isinstance(value, int | float | np.number) and not isinstance(value, bool):
            columns[name] = pd.Series([float(value)])
        elif not isinstance(value, str | bytes):
            unreadable[name] = _OBJECT
    if not columns:
        objects = f"; {', '.join(unreadable)}: {_OBJECT}" if unreadable else ""
        raise LogError(f"{path}: no vectors of numbers{objects}")
    return ForeignLog(str(path), columns, unreadable=unreadable)


def is_version_7_3(path: Path) -> bool:
    """Says whether a MAT file is HDF5: its text header says so, or the HDF5 signature is at a place
    where it may be.
    """
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


def _vectors(name: str, value: NDArray) -> dict[str, pd.Series]:
    """Splits an array into its columns; none of what is no table."""
    value = np.squeeze(value).astype(float)
    if value.ndim <= 1:
        return {name: pd.Series(np.atleast_1d(value))}
    if value.ndim > 2 or value.shape[1] > max(MAX_COLUMNS, value.shape[0]):
        return {}
    return {f"{name}({number})": pd.Series(column) for number, column in enumerate(value.T, 1)}


def _leaves_5(path: Path) -> Iterator[tuple[str, Any]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    errors = (ValueError, TypeError, MatReadError, NotImplementedError, OSError, LookupError)
    try:
        yield from _walk("", loadmat(path, simplify_cells=True))
    except errors as cause:
        raise LogError(f"{path}: damaged or not a MAT file ({_one_line(cause)})") from cause


def _leaves_7_3(path: Path) -> Iterator[tuple[str, Any]]:
    require_packages(path, "h5py")
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield from _walk("", file)
    except OSError as cause:
        raise LogError(f"{path}: damaged or not a MAT file of version 7.3") from cause


def _walk(prefix: str, struct: Any) -> Iterator[tuple[str, Any]]:
    """Walks over the leaves of a struct, a dict of SciPy or a group of h5py, with their names."""
    for key, value in struct.items():
        if key.startswith(("__", "#")):
            continue
        if hasattr(value, "items"):
            yield from _walk(f"{prefix}{key}.", value)
        else:
            yield prefix + key, _content(value) if hasattr(value, "attrs") else value


def _content(dataset: Any) -> NDArray | str | None:
    """Reads an HDF5 dataset.

    It keeps MATLAB's order of the numbers, so that rows and columns are exchanged.
    """
    if dataset.attrs.get("MATLAB_class") == b"char":
        return ""
    if dataset.dtype.kind not in "fiub" or "MATLAB_object_decode" in dataset.attrs:
        return None
    if "MATLAB_empty" in dataset.attrs:
        return np.array([])
    return np.asarray(dataset).T


def read_mcap(path: Path) -> ForeignLog:
    """Reads the columns of an MCAP file.

    Raises:
        LogError: a package is not installed, the file is cut off or damaged, no topic can be read.
    """
    require_packages(path, "mcap")
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    unreadable: dict[str, str] = {}
    messages: dict[str, list[dict[str, Any]]] = {}
    try:
        with open(path, "rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                topic = channel.topic
                encoding = channel.message_encoding
                if encoding != "json":
                    unreadable[topic] = f"its messages are {encoding!r}; read are 'json'"
                    continue
                row = {
                    topic: json.loads(message.data),
                    f"{topic}@log_time": message.log_time * NANOSECOND,
                    f"{topic}@publish_time": message.publish_time * NANOSECOND,
                }
                messages.setdefault(topic, []).append(row)
    except (McapError, ValueError, EOFError) as cause:
        raise LogError(
            f"{path}: cut off, damaged or not an MCAP file ({str(cause) or repr(cause)})"
        ) from cause
    if not messages:
        reasons = "; ".join(f"{topic}: {reason}" for topic, reason in unreadable.items())
        raise LogError(f"{path}: no messages that can be read ({reasons or 'the file is empty'})")
    columns: dict[str, pd.Series] = {}
    time_of: dict[str, str] = {}
    for topic, rows in messages.items():
        numbers = dict(_numbers(pd.json_normalize(rows)))
        columns |= numbers
        time_of |= dict.fromkeys(numbers, f"{topic}@log_time")
    return ForeignLog(str(path), columns, time_of, unreadable)


def _numbers(table: pd.DataFrame) -> Iterator[tuple[str, pd.Series]]:
    """Selects every column of numbers by name, null as NaN; a list gives one for each of its
    places.
    """
    for name, values in table.items():
        is_list = values.map(lambda value: isinstance(value, list))
        if values.dtype.kind in "fiub" or values.isna().all():
            yield str(name), values.astype(np.float64)
        elif is_list.any():
            lists = pd.DataFrame(
                values.where(is_list, None).map(lambda value: value or []).tolist()
            )
            numbers = range(1, lists.shape[1] + 1)
            lists.columns = [f"{name}({number})" for number in numbers]
            if lists.shape[1] <= MAX_COLUMNS:
                yield from _numbers(lists)


def require_packages(path: Path | str, *packages: str) -> None:
    """Raises LogError, naming the extra, for a package that a kind of file needs and that is not
    installed.
    """
    for package in packages:
        try:
            __import__(package)
        except ImportError:
            raise LogError(
                f"{path}: this kind of file needs the package {package}: pip install "
                "'aerodima-workbench[logs]'"
            ) from None
