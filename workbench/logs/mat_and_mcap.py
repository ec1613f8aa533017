"""MAT files of MATLAB, and MCAP files with JSON messages, as columns of numbers.

MAT of version 5 to 7 is read with SciPy, version 7.3, which is HDF5, with h5py (extra `logs`). Vectors become columns.
A struct field is called `data.force`, the second column of a matrix `force(2)`. Objects such as `timeseries` are
stored in a form that only MATLAB reads: they are listed as unreadable.

MCAP (https://mcap.dev) is read and written with the package `mcap` (extra `logs`). A number in a message becomes the
column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a topic was logged are the column
`<topic>@log_time`, those at which it was published `<topic>@publish_time`, both s.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import ForeignLog
from aerodima.workbench.logs.schema import METADATA_KEY, decode_metadata

MOST_COLUMNS = 64
"""A matrix with more columns than this (and than rows) is a picture or a table of something else, not a log."""
_OBJECT = "a MATLAB object or cell; save it as a struct of vectors (for a timeseries: its Time and Data)"


def read_mat(path: Path) -> ForeignLog:
    """Columns of a MAT file.

    Raises:
        LogError: damaged or not a MAT file; h5py is not installed and the file is of version 7.3.
    """
    columns: dict[str, NDArray[np.float64]] = {}
    unreadable: dict[str, str] = {}
    for name, value in _leaves_7_3(path) if is_version_7_3(path) else _leaves_5(path):
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            columns |= _vectors(name, value)
        elif isinstance(value, int | float | np.number) and not isinstance(value, bool):
            columns[name] = np.array([value], dtype=np.float64)
        elif not isinstance(value, str | bytes):
            unreadable[name] = _OBJECT
    if not columns:
        raise LogError(
            f"{path}: no vectors of numbers" + (f"; {', '.join(unreadable)}: {_OBJECT}" if unreadable else "")
        )
    return ForeignLog(str(path), {name: pd.Series(values) for name, values in columns.items()}, unreadable=unreadable)


def is_version_7_3(path: Path) -> bool:
    """Whether a MAT file is HDF5: its text header says so, or the HDF5 signature is at a place where it may be."""
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


def _vectors(name: str, value: NDArray) -> dict[str, NDArray[np.float64]]:
    value = np.squeeze(value)
    if value.ndim <= 1:
        return {name: np.atleast_1d(value).astype(np.float64)}
    if value.ndim > 2 or (value.shape[1] > MOST_COLUMNS and value.shape[1] > value.shape[0]):
        return {}
    return {f"{name}({column + 1})": value[:, column].astype(np.float64) for column in range(value.shape[1])}


def _leaves_5(path: Path) -> Iterator[tuple[str, Any]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        contents = loadmat(path, simplify_cells=True)
    except (ValueError, TypeError, MatReadError, NotImplementedError, OSError, KeyError, IndexError) as cause:
        raise LogError(f"{path}: damaged or not a MAT file ({' '.join(str(cause).split())})") from cause
    for name, value in contents.items():
        if not name.startswith("__"):
            yield from _walk(name, value)


def _walk(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _walk(f"{name}.{key}", inner)
    else:
        yield name, value


def _leaves_7_3(path: Path) -> Iterator[tuple[str, Any]]:
    try:
        import h5py
    except ImportError:
        raise LogError(
            f"{path}: a MAT file of version 7.3 needs h5py: pip install 'aerodima-workbench[logs]'"
        ) from None
    try:
        with h5py.File(path, "r") as file:
            yield from _walk_7_3(h5py, "", file)
    except OSError as cause:
        raise LogError(f"{path}: damaged or not a MAT file of version 7.3") from cause


def _walk_7_3(h5py: Any, prefix: str, group: Any) -> Iterator[tuple[str, Any]]:
    for key in group:
        if key in ("#refs#", "#subsystem#"):
            continue
        value, name = group[key], prefix + key
        matlab_class = value.attrs.get("MATLAB_class", b"")
        if isinstance(value, h5py.Group):
            yield from _walk_7_3(h5py, f"{name}.", value)
        elif matlab_class == b"char":
            yield name, ""
        elif value.dtype.kind in "fiub" and "MATLAB_object_decode" not in value.attrs:
            # HDF5 keeps MATLAB's order of the numbers, so rows and columns are exchanged.
            yield name, np.array([]) if "MATLAB_empty" in value.attrs else np.asarray(value).T
        else:
            yield name, None


METADATA_RECORD = "aerodima"
"""Name of the metadata record that carries the metadata of an exported run log, as JSON."""
_NANOSECOND = 1e-9


def read_mcap(path: Path) -> ForeignLog:
    """Columns of an MCAP file.

    Raises:
        LogError: `mcap` is not installed, the file is cut off or damaged, no topic is JSON.
    """
    _need_mcap(path)
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    rows: dict[str, list[dict[str, float]]] = {}
    unreadable: dict[str, str] = {}
    metadata = None
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream)
            for record in reader.iter_metadata():
                if record.name == METADATA_RECORD:
                    stored = {METADATA_KEY: record.metadata.get("json", "").encode()}
                    metadata = decode_metadata(stored, str(path))
            for _, channel, message in reader.iter_messages():
                topic = channel.topic
                if channel.message_encoding != "json":
                    unreadable[topic] = f"its messages are {channel.message_encoding!r}, only 'json' is read"
                    continue
                row = {f"{topic}@log_time": message.log_time * _NANOSECOND}
                row[f"{topic}@publish_time"] = message.publish_time * _NANOSECOND
                row.update(_numbers(topic + ".", json.loads(message.data)))
                rows.setdefault(topic, []).append(row)
    except (McapError, ValueError, EOFError) as cause:
        raise LogError(f"{path}: cut off, damaged or not an MCAP file ({str(cause) or repr(cause)})") from cause
    if not rows:
        reasons = "; ".join(f"{topic}: {reason}" for topic, reason in unreadable.items())
        raise LogError(f"{path}: no messages that can be read" + (f" ({reasons})" if reasons else ""))
    tables = {topic: pd.DataFrame(messages) for topic, messages in rows.items()}
    columns = {str(name): table[name] for table in tables.values() for name in table.columns}
    time_of = {str(name): f"{topic}@log_time" for topic, table in tables.items() for name in table.columns}
    return ForeignLog(str(path), columns, time_of, unreadable, metadata)


def write_mcap(path: Path, table: pd.DataFrame, topics: Mapping[str, list[str]], time: str, metadata: str) -> None:
    """Writes a table as JSON messages, one per row and topic, each with its time; NaN becomes null.

    Args:
        path: to write.
        table: float64 columns.
        topics: topic to the columns of its messages.
        time: name of the column with the times, s; times are kept in the messages too, as nanoseconds round them.
        metadata: JSON, kept as the metadata record `aerodima`.

    Raises:
        LogError: `mcap` is not installed, or a time is negative or not finite.
    """
    _need_mcap(path)
    from mcap.writer import Writer

    times = table[time].to_numpy(dtype=np.float64)
    if not np.all(np.isfinite(times)) or times[0] < 0.0:
        raise LogError(f"column {time!r}: MCAP needs finite times from 0 s on")
    stamps = np.round(times / _NANOSECOND).astype(np.int64).tolist()
    messages = [(topic, [time, *names], table[[time, *names]].to_numpy().tolist()) for topic, names in topics.items()]
    with open(path, "wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="", library="aerodima")
        channels = [_channel(writer, topic, names) for topic, names, _ in messages]
        for row, stamp in enumerate(stamps):
            for channel, (_, names, values) in zip(channels, messages, strict=True):
                numbers = (value if np.isfinite(value) else None for value in values[row])
                data = json.dumps(dict(zip(names, numbers, strict=True))).encode()
                writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
        writer.add_metadata(METADATA_RECORD, {"json": metadata})
        writer.finish()


def _need_mcap(path: Path) -> None:
    try:
        import mcap  # noqa: F401
    except ImportError:
        raise LogError(f"{path}: MCAP needs the package mcap: pip install 'aerodima-workbench[logs]'") from None


def _channel(writer: Any, topic: str, names: list[str]) -> int:
    properties = {name: {"type": ["number", "null"]} for name in names}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    schema_id = writer.register_schema(name=f"aerodima.{topic.strip('/')}", encoding="jsonschema", data=schema)
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id))


def _numbers(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number in a message with its name; null is NaN, text is left out."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{prefix}{key}." if isinstance(inner, dict) else f"{prefix}{key}", inner)
    elif isinstance(value, list):
        for index, inner in enumerate(value, start=1):
            if isinstance(inner, int | float):
                yield f"{prefix}({index})", float(inner)
    elif value is None or isinstance(value, int | float):
        yield prefix, float("nan") if value is None else float(value)
