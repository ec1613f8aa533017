"""MCAP files with JSON messages (https://mcap.dev), read and written with the package `mcap` (extra `logs`).

A number in a message becomes the column `<topic>.<field>`, one in a list `<topic>.<field>(1)`. The times at which a
topic was logged are the column `<topic>@log_time`, those at which it was published `<topic>@publish_time`, both s.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.workbench.errors import LogError

METADATA_RECORD = "aerodima"
"""Name of the metadata record that carries the metadata of an exported run log, as JSON."""
_NANOSECOND = 1e-9


@dataclass(frozen=True)
class McapContents:
    """Columns, the times that belong to them, topics that are not JSON, and the metadata of an exported run log."""

    columns: dict[str, pd.Series]
    time_of: dict[str, str]
    unreadable: dict[str, str]
    metadata: dict[str, Any] | None


def read_mcap(path: Path) -> McapContents:
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
                    metadata = _decode(record.metadata.get("json", ""), str(path))
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
    return _contents(rows, unreadable, metadata)


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
                data = json.dumps(dict(zip(names, map(_finite_or_none, values[row]), strict=True))).encode()
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


def _finite_or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _decode(text: str, source: str) -> dict[str, Any]:
    from aerodima.workbench.logs.schema import METADATA_KEY, decode_metadata

    return decode_metadata({METADATA_KEY: text.encode()}, source)


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


def _contents(
    rows: dict[str, list[dict[str, float]]], unreadable: dict[str, str], metadata: dict[str, Any] | None
) -> McapContents:
    columns: dict[str, pd.Series] = {}
    time_of: dict[str, str] = {}
    for topic, messages in rows.items():
        table = pd.DataFrame(messages)
        for name in table.columns:
            columns[str(name)] = table[name]
            time_of[str(name)] = f"{topic}@log_time"
    return McapContents(columns, time_of, unreadable, metadata)
