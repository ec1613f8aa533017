"""Logs in other programs' files as named columns of numbers: CSV, Parquet, MAT, MCAP, ROS bags.

They keep the units and rates in which they were written; `logs.importers` makes a run log of them.
MAT files of version 5 to 7 are read with SciPy, those of version 7.3, which is HDF5, with h5py
(extra `logs`). Vectors become columns. A struct field is called `data.force`, the second column of
a matrix `force(2)`, or its second row where a sample is a column, as Simulink's To File writes
them. Objects such as `timeseries` are stored in a form that only MATLAB reads.

MCAP files (https://mcap.dev, extra `logs`) are read where their messages are JSON: a number becomes
the column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a topic was
logged are the column `<topic>@log_time`, those at which it was published `<topic>@publish_time`,
both s. The same holds for bags of ROS 1 and ROS 2, also in MCAP, which rosbags reads (extra
`logs`). Elements of a list of structs or messages are the rows of one table.

Columns that are not numbers (text, objects, lists of any length) are listed as unreadable with the
reason. Checksums of a file, where it has any, are compared. `logs.importers` turns whatever a
parser raises for a damaged file into one error.
"""

import json
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.elementwise import roll_pitch_yaw, rotation_rows
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.extras import require
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.logs.mapping import CsvFormat, time_factor
from aerodima.workbench.logs.mat_reading import is_version_7_3, read_struct

Columns = dict[str, pd.Series]
"""Values of each column by its name."""
Texts = dict[str, str]
"""Reason why a column is unreadable, or name of its times, by the name of the column."""
MAX_COLUMNS = 64
"""Largest number of channels. A matrix with more columns (and more than rows) has its channels in
rows; a list with more numbers is a picture or a table of something else, not a log."""
MAX_TEXT_LOG = 4 * 2**30
"""Size of the longest CSV that is read, bytes."""
MAX_LENGTH_ERROR = 0.05
"""Largest deviation of the length of a quaternion from 1."""
NANOSECOND = 1e-9
"""One nanosecond, s."""
_NAN = ("NaN", "nan", "NAN", "NA", "null", "")
"""Texts that stand for a missing number."""
_VALUE = re.compile(r"[-+]?[\d.,]*\d[.,]?(e[-+]?\d+)?|nan|[-+]?inf|\d{4}-\d\d-\d\d.*", re.I)
"""Pattern of a number or a date."""
_OBJECT = (
    "a MATLAB object or cell; save it as a struct of vectors (for a timeseries: its Time and Data)"
)


@dataclass(frozen=True)
class ForeignLog:
    """The columns of a file.

    Attributes:
        path: path of the file, for messages.
        columns: values of each column by its name; columns of different rates may differ in length.
        time_of: name of the column with the times of each column, where the format has it (MCAP,
            ROS bags).
        unreadable: reason for each column or topic that is there but cannot be read, by its name.
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
        numbers = pd.to_numeric(series, errors="coerce")
        bad = numbers.isna() & ~series.isin(_NAN)
        self._refuse_cells(name, series, bad | (series.dtype.kind in "mM"), "a number")
        return numbers.to_numpy(float)

    def times(self, name: str, unit: str) -> FloatArray:
        """Reads a column of times, s: numbers in a unit, or durations; dates, which are ISO 8601
        unless the unit is their form (`%d.%m.%Y %H:%M:%S`), count since 1970, UTC.

        Raises:
            LogError: as `numbers`; a cell that is not a date of this form (names its row, from 1).
        """
        series = self._series(name)
        if series.dtype.kind == "m":
            return series.dt.total_seconds().to_numpy(float)
        factor = time_factor(unit, name)
        if factor and series.dtype.kind != "M" and _has_numbers(series):
            return factor * self.numbers(name)
        form = "ISO8601" if factor else unit
        texts = series.astype(str).str.strip()
        dates = pd.to_datetime(texts, utc=True, format=form, errors="coerce")
        self._refuse_cells(name, series, dates.isna(), f"a date of the form {form}")
        return np.asarray((dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), float)

    def combined(
        self, stamps: Mapping[str, Sequence[str]], quaternions: Mapping[str, Sequence[str]]
    ) -> Self:
        """Adds columns made of several others: `Mapping.stamps` and `Mapping.quaternions`.

        Raises:
            LogError: as `numbers`; a stamp of columns of different size; a quaternion whose length
                is not 1 (names its row, from 1).
        """
        columns = dict(self.columns)
        time_of = dict(self.time_of)
        for name, (first, second) in stamps.items():
            date = self._series(first)
            clock = self._series(second)
            if date.size != clock.size:
                raise LogError(
                    f"{self.path}: stamps.{name}: {first!r} has {date.size} rows and {second!r} "
                    f"{clock.size}; must be as many"
                )
            time_of[name] = time_of.get(first, "")
            if _has_numbers(date):
                columns[name] = pd.Series(self.numbers(first)) + NANOSECOND * self.numbers(second)
            else:
                columns[name] = date.astype(str) + " " + clock.astype(str)
        for name, parts in quaternions.items():
            quaternion = pd.DataFrame({part: pd.Series(self.numbers(part)) for part in parts})
            length = pd.Series(np.linalg.norm(quaternion, axis=1))
            off = (length - 1.0).abs() > MAX_LENGTH_ERROR
            self._refuse_cells(name, length, off, "1, the length of a quaternion")
            angles = roll_pitch_yaw(rotation_rows(quaternion.to_numpy().T))
            for angle, values in zip(("roll", "pitch", "yaw"), angles, strict=True):
                columns[f"{name}.{angle}"] = pd.Series(values)
                time_of[f"{name}.{angle}"] = time_of.get(parts[0], "")
        return replace(self, columns=columns, time_of=time_of)

    def _refuse_cells(self, name: str, series: pd.Series, bad: pd.Series, kind: str) -> None:
        """Raises LogError for the first `bad` cell that is not empty."""
        rows = np.flatnonzero(bad & series.notna())
        if rows.size:
            raise LogError(
                f"{self.path}: column {name!r}: {str(series.iloc[rows[0]])!r} in row "
                f"{rows[0] + 1} is not {kind}"
            )

    def _series(self, name: str) -> pd.Series:
        if name in self.unreadable:
            raise LogError(f"{self.path}: {name!r} cannot be read: {self.unreadable[name]}")
        if name not in self.columns:
            raise LogError(f"{self.path}: no column {name!r}; {nearest(name, self.columns)}")
        return self.columns[name]


def _has_numbers(series: pd.Series) -> bool:
    """Says whether any cell is a number, or a text that is one."""
    return bool(pd.to_numeric(series, errors="coerce").notna().any())


def joined(logs: list[ForeignLog]) -> ForeignLog:
    """Joins files of one run: the columns of the second are called `2:<name>`, and so on."""
    columns: Columns = {}
    time_of: Texts = {}
    unreadable: Texts = {}
    for number, log in enumerate(logs, 1):
        prefix = f"{number}:" if number > 1 else ""
        columns |= {prefix + name: series for name, series in log.columns.items()}
        time_of |= {prefix + name: prefix + time for name, time in log.time_of.items()}
        unreadable |= {prefix + name: reason for name, reason in log.unreadable.items()}
    return ForeignLog(" + ".join(log.path for log in logs), columns, time_of, unreadable)


def read_csv(path: Path, form: CsvFormat) -> ForeignLog:
    """Reads the columns of a CSV.

    Raises:
        LogError: no line of names, rows with more values than names, one column only.
    """
    if path.stat().st_size > MAX_TEXT_LOG:
        raise LogError(f"{path}: longer than {MAX_TEXT_LOG // 2**30} GiB; cut it into parts")
    first = form.skip_lines + (form.names is None)
    skipped = [*range(form.skip_lines), *range(first, first + form.skip_after_names)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # values would be dropped
            table = pd.read_csv(
                path,
                sep=form.delimiter,
                decimal=form.decimal,
                comment=form.comment,
                encoding=form.encoding,
                header=0 if form.names is None else None,
                names=form.names or None,
                skiprows=skipped,
                skipinitialspace=True,
                index_col=False,
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
    if form.names == ():
        table.columns = pd.RangeIndex(1, 1 + table.shape[1])
    columns = {str(name).strip(): column for name, column in table.items()}
    if form.names is None:
        _refuse_values(path, list(columns))
    return ForeignLog(str(path), columns)


def _refuse_values(path: Path, names: list[str]) -> None:
    """Raises LogError if names are values: only numbers and dates, or one that is not a whole
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
    columns: Columns = {}
    unreadable: Texts = {}
    for name, value in _leaves("", read_struct(path)):
        kind = "O" if isinstance(value, list) else np.asarray(value).dtype.kind
        if kind not in "fiub":
            reasons = {"U": "text", "S": "text", "c": "complex numbers; save their parts"}
            unreadable[name] = reasons.get(kind, _OBJECT)
        elif np.squeeze(value).ndim > 2:
            unreadable[name] = f"an array of {np.shape(value)} is no table of channels"
        else:
            columns |= _vectors(name, np.squeeze(value).astype(float))
    return ForeignLog(str(path), columns, unreadable=unreadable)


def _vectors(name: str, value: NDArray) -> Columns:
    """Splits an array into its columns; into its rows where these are far fewer."""
    if value.ndim <= 1:
        return {name: pd.Series(np.atleast_1d(value))}
    if value.shape[1] > max(MAX_COLUMNS, value.shape[0]):
        value = value.T  # Simulink's block To File writes each sample as a column
    return {f"{name}({number})": pd.Series(column) for number, column in enumerate(value.T, 1)}


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Walks over the leaves of a struct or message, with their names.

    A leaf of a list of structs joins that leaf of all of them. Numbers and vectors of one length
    become an array; other elements of a list are numbered, `data.force(2)`.
    """
    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.ravel("F").tolist()
    if isinstance(value, list):
        parts = [getattr(part, "__dict__", part) for part in value]
        if all(isinstance(part, dict) for part in parts):
            value = pd.DataFrame(parts).to_dict("list")
        else:
            try:
                value = np.array(value, float)
            except (TypeError, ValueError):
                if len(value) <= MAX_COLUMNS:
                    value = {f"({number})": part for number, part in enumerate(value, 1)}
    value = getattr(value, "__dict__", value)
    if isinstance(value, dict):
        for key, part in value.items():
            if not key.startswith(("__", "#")):
                yield from _leaves(f"{name}.{key}".removeprefix(".").replace(".(", "("), part)
    else:
        yield name, value


def read_mcap(path: Path) -> ForeignLog:
    """Reads the columns of an MCAP file whose checksums are right.

    The file is read from its beginning to its end: its index may be damaged, and its messages are
    counted.

    Raises:
        LogError: a package is not installed, a message is missing.
    """
    require("logs", path, "mcap", error=LogError)
    from mcap.records import Channel, Header, Message, Statistics
    from mcap.stream_reader import StreamReader

    unreadable: Texts = {}
    messages: dict[str, list[Json]] = {}
    channels: dict[int, Channel] = {}
    count = 0
    with open(path, "rb") as stream:
        reader = StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size)
        for record in reader.records:
            if isinstance(record, Header) and record.profile == "ros2":
                return read_bag(path)
            if isinstance(record, Channel):
                channels[record.id] = record
                if record.message_encoding != "json":
                    reason = f"its messages are {record.message_encoding!r}; must be 'json'"
                    unreadable[record.topic] = reason
            elif isinstance(record, Message):
                count += 1
                topic = channels[record.channel_id].topic
                if topic not in unreadable:
                    row = _row(topic, json.loads(record.data), record.log_time)
                    row[f"{topic}@publish_time"] = record.publish_time * NANOSECOND
                    messages.setdefault(topic, []).append(row)
            elif isinstance(record, Statistics):
                _refuse_lost(path, count, record.message_count)
    return _of_topics(path, messages, unreadable)


def read_bag(path: Path) -> ForeignLog:
    """Reads the columns of a ROS bag: a file of ROS 1, or for ROS 2 a file or the folder that holds
    its `metadata.yaml`. Types that the bag does not define are those of ROS 2 itself.

    Raises:
        LogError: rosbags is not installed, a message is missing.
    """
    require("logs", path, "rosbags", error=LogError)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    unreadable: Texts = {}
    messages: dict[str, list[Json]] = {}
    count = 0
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, time, data in reader.messages():
            count += 1
            topic, kind = connection.topic, connection.msgtype
            if kind in reader.typestore.fielddefs:
                row = _row(topic, reader.deserialize(data, kind), time)
                messages.setdefault(topic, []).append(row)
            else:
                unreadable[topic] = f"the bag does not define its type {kind}"
        _refuse_lost(path, count, reader.message_count)
    return _of_topics(path, messages, unreadable)


def _row(topic: str, message: Any, time: int) -> Json:
    """Makes the row of a message: single values, and the time (ns) at which it was logged, in s."""
    row: Json = {f"{topic}@log_time": time * NANOSECOND}
    for name, value in _leaves(topic, message):
        if isinstance(value, list) or np.size(value) > MAX_COLUMNS:
            row[name] = f"{len(value)} values"
        elif isinstance(value, np.ndarray):
            for index, number in np.ndenumerate(value):
                row[name + "".join(f"({place + 1})" for place in index)] = number
        else:
            row[name] = value
    return row


def _refuse_lost(path: Path, count: int, written: int) -> None:
    """Raises LogError unless there are as many messages as were written."""
    if count != written:
        raise LogError(
            f"{path}: {count} messages are there of {written} that were written; it is damaged, "
            "copy it again"
        )


def _of_topics(path: Path, messages: Mapping[str, list[Json]], unreadable: Texts) -> ForeignLog:
    """Makes the columns of the messages of each topic, in the order of their times."""
    columns: Columns = {}
    time_of: Texts = {}
    for topic, rows in messages.items():
        time = f"{topic}@log_time"
        table = pd.DataFrame(rows).sort_values(time, kind="stable", ignore_index=True)
        for name, values in table.items():
            stated = values.dropna()
            if stated.empty or _has_numbers(stated):
                columns[str(name)] = values
                time_of[str(name)] = time
            else:
                unreadable[str(name)] = f"no number, but {stated.iloc[0]!r}"
    return ForeignLog(str(path), columns, time_of, unreadable)
