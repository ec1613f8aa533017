"""Run logs written for other programs, as CSV and MCAP (https://mcap.dev).

A file keeps every bit of every number, and the metadata: a CSV has them in a file beside it,
`run.csv.json`, MCAP has them inside. The packages for MCAP are those of the extra `logs`.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from aerodima.workbench.core.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.extras import require
from aerodima.workbench.logs.foreign_files import NANOSECOND
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.signal_table import PLANT_POSITION_PREFIX, TIME

Format = Literal["csv", "mcap"]

Stamped = tuple[int, int, bytes]
"""Time (ns), channel and data of a message."""


class SceneMessage(NamedTuple):
    """A message of a Foxglove schema, to be written beside the signals.

    Args:
        time: time of the message, s.
        topic: name of the topic.
        message: object of a class of `foxglove_schemas_protobuf`.
    """

    time: float
    topic: str
    message: Any


def export_log(
    run_log: RunLog,
    path: Path | str,
    form: Format,
    force: bool = False,
    scene: Iterable[SceneMessage] = (),
) -> list[Path]:
    """Writes a run log as CSV or MCAP; returns the files written.

    Args:
        run_log: log of the run.
        path: path of the file to be written.
        form: format of the file.
        force: whether existing files are replaced.
        scene: for MCAP, messages that a viewer draws, such as those that
            `aerodima.workbench.view.foxglove_scene` makes.

    Raises:
        LogError: a file exists and `force` is not set; MCAP without the package, or with negative
            times.
    """
    path = Path(path)
    metadata = json.dumps(run_log.metadata(), sort_keys=True, indent=1, allow_nan=False)
    if form == "csv":
        beside = path.with_name(path.name + ".json")
        refuse_existing(beside, force, LogError)
        write_atomically(path, run_log.table.to_csv(index=False), force, LogError)
        write_atomically(beside, metadata + "\n", force, LogError)
        return [path, beside]
    require("logs", path, "mcap", "mcap_protobuf", "foxglove_schemas_protobuf", error=LogError)
    if not np.all(np.isfinite(run_log.time)) or run_log.time.min(initial=0.0) < 0.0:
        raise LogError(f"column {TIME!r}: MCAP needs finite times from 0 s on")
    write = partial(_write_mcap, table=run_log.table, metadata=metadata, scene=scene)
    return [write_atomically(path, write, force, LogError)]


def topics_of(columns: Sequence[str]) -> dict[str, list[str]]:
    """Groups columns by MCAP topics: one per device, so that a viewer shows them in groups."""
    topics: dict[str, list[str]] = {}
    for name in columns:
        if name != TIME:
            topics.setdefault(_topic(name), []).append(name)
    return topics


def _topic(column: str) -> str:
    """Names the topic of a column."""
    if column.startswith(PLANT_POSITION_PREFIX):
        return "/plant"
    if "_truth" in column:
        return "/truth"
    device = column.partition("_")[0]
    if device in ("imu", "tail", "sail", "status", "speed"):
        return f"/{device}"
    if column.startswith(("angle", "angular", "current", "force", "torque")):
        return "/rig"
    return "/driver"


def _write_mcap(
    path: Path, table: pd.DataFrame, metadata: str, scene: Iterable[SceneMessage]
) -> None:
    """Writes JSON messages, one per row and topic, each with its time; NaN becomes null.

    The scene is Protobuf.
    """
    from mcap.writer import Writer

    with open(path, "wb") as stream:
        writer: Any = Writer(stream)
        writer.start(profile="", library="aerodima")
        messages = [
            _signals(writer, topic, table[[TIME, *names]])
            for topic, names in topics_of(list(table.columns)).items()
        ]
        for stamp, channel, data in merge(*messages, _drawn(writer, scene), key=itemgetter(0)):
            writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
        writer.add_metadata("aerodima", {"json": metadata})
        writer.finish()


def _signals(writer: Any, topic: str, table: pd.DataFrame) -> Iterator[Stamped]:
    """Makes the messages of a topic; they hold the times too, which nanoseconds round."""
    names = list(table.columns)
    properties = {name: {"type": ["number", "null"]} for name in names}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    schema_id = writer.register_schema(
        name=f"aerodima.{topic.strip('/')}", encoding="jsonschema", data=schema
    )
    channel = writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id)
    for row in table.to_numpy().tolist():
        numbers = (value if np.isfinite(value) else None for value in row)
        data = json.dumps(dict(zip(names, numbers, strict=True)))
        yield stamp_of(row[0]), channel, data.encode()


def _drawn(writer: Any, scene: Iterable[SceneMessage]) -> Iterator[Stamped]:
    """Makes the messages of Foxglove's schemas."""
    from mcap_protobuf.schema import register_schema

    channels: dict[str, int] = {}
    for time, topic, message in scene:
        if topic not in channels:
            schema = register_schema(writer, type(message))
            channels[topic] = writer.register_channel(
                topic=topic, message_encoding="protobuf", schema_id=schema
            )
        yield stamp_of(time), channels[topic], message.SerializeToString()


def stamp_of(time: float) -> int:
    """Converts a time (s) to ns, as MCAP keeps it."""
    return round(time / NANOSECOND)
