"""MCAP files (https://mcap.dev) with JSON messages: read as columns of numbers, and written.

A number in a message becomes the column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a
topic was logged are the column `<topic>@log_time`, those at which it was published `<topic>@publish_time`, both s.
Text, and lists of more than `MOST_NUMBERS`, are left out. The packages are those of the extra `logs`.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from heapq import merge
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import ForeignLog
from aerodima.workbench.logs.schema import METADATA_KEY, decode_metadata

METADATA_RECORD = "aerodima"
"""Name of the metadata record that carries the metadata of an exported run log, as JSON."""
MOST_NUMBERS = 64
"""A list with more numbers than this is a picture, a scan or a map, not a signal."""
_NANOSECOND = 1e-9


class SceneMessage(NamedTuple):
    """A message of a Foxglove schema, to be written beside the signals.

    Args:
        time: s.
        topic: name.
        message: an object of a class of `foxglove_schemas_protobuf`.
    """

    time: float
    topic: str
    message: Any


def read_mcap(path: Path) -> ForeignLog:
    """Columns of an MCAP file.

    Raises:
        LogError: a package is not installed, the file is cut off or damaged, no topic can be read.
    """
    _need(path, "MCAP", "mcap")
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    found = _Messages(path)
    metadata = None
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream)
            for record in reader.iter_metadata():
                if record.name == METADATA_RECORD:
                    stored = {METADATA_KEY: record.metadata.get("json", "").encode()}
                    metadata = decode_metadata(stored, str(path))
            for _, channel, message in reader.iter_messages():
                if channel.message_encoding != "json":
                    found.unreadable[channel.topic] = f"its messages are {channel.message_encoding!r}; read are 'json'"
                    continue
                times = {"log_time": message.log_time, "publish_time": message.publish_time}
                found.add(channel.topic, times, json.loads(message.data))
    except (McapError, ValueError, EOFError) as cause:
        raise LogError(f"{path}: cut off, damaged or not an MCAP file ({str(cause) or repr(cause)})") from cause
    return found.log(metadata)


class _Messages:
    """Numbers of messages, a row each, until they are columns."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.unreadable: dict[str, str] = {}
        self._rows: dict[str, list[dict[str, float]]] = {}

    def add(self, topic: str, times: Mapping[str, int], message: Any) -> None:
        """Takes one message; its times are ns."""
        row = {f"{topic}@{name}": time * _NANOSECOND for name, time in times.items()}
        row.update(_numbers(f"{topic}.", message))
        self._rows.setdefault(topic, []).append(row)

    def log(self, metadata: dict[str, Any] | None = None) -> ForeignLog:
        """The columns; LogError when there is none."""
        if not self._rows:
            reasons = "; ".join(f"{topic}: {reason}" for topic, reason in self.unreadable.items())
            raise LogError(f"{self.path}: no messages that can be read" + (f" ({reasons})" if reasons else ""))
        tables = {topic: pd.DataFrame(rows) for topic, rows in self._rows.items()}
        columns = {str(name): table[name] for table in tables.values() for name in table.columns}
        time_of = {str(name): f"{topic}@log_time" for topic, table in tables.items() for name in table.columns}
        return ForeignLog(str(self.path), columns, time_of, self.unreadable, metadata)


def _numbers(prefix: str, value: Any) -> Iterator[tuple[str, float]]:
    """Every number in a message with its name; null is NaN."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(f"{prefix}{key}." if isinstance(inner, dict) else f"{prefix}{key}", inner)
    elif isinstance(value, list):
        if len(value) <= MOST_NUMBERS:
            for index, inner in enumerate(value, start=1):
                if isinstance(inner, int | float):
                    yield f"{prefix}({index})", float(inner)
    elif value is None or isinstance(value, int | float):
        yield prefix, float("nan") if value is None else float(value)


class McapFile:
    """An MCAP file that is being written: JSON messages, one per row and topic, each with its time; NaN becomes null.

    Args:
        stream: of the file, binary.
        topics: topic to the columns of its messages.
        time: name of the column with the times, s; times are kept in the messages too, as nanoseconds round them.

    Raises:
        LogError: a package is not installed.
    """

    def __init__(self, stream: Any, topics: Mapping[str, list[str]], time: str) -> None:
        _need(stream.name, "MCAP", "mcap", "mcap_protobuf", "foxglove_schemas_protobuf")
        from mcap.writer import Writer

        self._writer: Any = Writer(stream)
        self._writer.start(profile="", library="aerodima")
        self._time = time
        self._signals = {self._channel(topic, [time, *names]): [time, *names] for topic, names in topics.items()}
        self._scenes: dict[str, int] = {}

    def add(self, table: pd.DataFrame, scene: Iterable[SceneMessage] = ()) -> None:
        """Takes rows, and what a viewer draws (Protobuf), in the order of its times.

        Raises:
            LogError: a time is negative or not finite.
        """
        times = table[self._time].to_numpy(dtype=np.float64)
        if not np.all(np.isfinite(times)) or times.min(initial=0.0) < 0.0:
            raise LogError(f"column {self._time!r}: MCAP needs finite times from 0 s on")
        signals = [_rows(channel, table[names], times) for channel, names in self._signals.items()]
        for stamp, channel, data in merge(*signals, self._drawn(scene), key=lambda item: item[0]):
            self._writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)

    def finish(self, metadata: str) -> None:
        """Ends the file; `metadata` (JSON) is kept as the metadata record `aerodima`."""
        self._writer.add_metadata(METADATA_RECORD, {"json": metadata})
        self._writer.finish()

    def _channel(self, topic: str, names: list[str]) -> int:
        properties = {name: {"type": ["number", "null"]} for name in names}
        schema = json.dumps({"type": "object", "properties": properties}).encode()
        schema_id = self._writer.register_schema(
            name=f"aerodima.{topic.strip('/')}", encoding="jsonschema", data=schema
        )
        return int(self._writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id))

    def _drawn(self, scene: Iterable[SceneMessage]) -> Iterator[tuple[int, int, bytes]]:
        """Stamp, channel and data of messages of Foxglove's schemas."""
        from mcap_protobuf.schema import register_schema

        for time, topic, message in scene:
            if topic not in self._scenes:
                schema = register_schema(self._writer, type(message))
                self._scenes[topic] = self._writer.register_channel(
                    topic=topic, message_encoding="protobuf", schema_id=schema
                )
            yield stamp_of(time), self._scenes[topic], message.SerializeToString()


def stamp_of(time: float) -> int:
    """A time (s) in ns, as MCAP keeps it."""
    return round(time / _NANOSECOND)


def _rows(channel: int, table: pd.DataFrame, times: Iterable[float]) -> Iterator[tuple[int, int, bytes]]:
    """Stamp, channel and data of the messages of a topic."""
    names = list(table.columns)
    for time, row in zip(times, table.to_numpy().tolist(), strict=True):
        numbers = (value if np.isfinite(value) else None for value in row)
        yield stamp_of(time), channel, json.dumps(dict(zip(names, numbers, strict=True))).encode()


def _need(path: Path | str, what: str, *packages: str) -> None:
    for package in packages:
        try:
            __import__(package)
        except ImportError:
            raise LogError(
                f"{path}: {what} needs the package {package}: pip install 'aerodima-workbench[logs]'"
            ) from None
