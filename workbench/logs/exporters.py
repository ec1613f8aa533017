"""Run logs written for other programs, as CSV and MCAP, also while the run goes on.

A file keeps every bit of every number, and the metadata, so that `aerodima log import` gives back the same log: a CSV
has its metadata in a file beside it, `run.csv.json`; MCAP has them inside.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, Literal

from aerodima.workbench.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.config.signal_table import PLANT_POSITION_PREFIX, TIME
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import sidecar
from aerodima.workbench.logs.journal import follow_run
from aerodima.workbench.logs.mcap_files import McapFile, SceneMessage
from aerodima.workbench.logs.schema import RunLog

Format = Literal["csv", "mcap"]


FORMATS: tuple[Format, ...] = ("csv", "mcap")


def export_log(
    run_log: RunLog, path: Path | str, form: Format, force: bool = False, scene: Iterable[SceneMessage] = ()
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

    def write(temporary: Path) -> None:
        with open(temporary, "wb") as stream:
            written = McapFile(stream, topics_of(list(run_log.table.columns)), TIME)
            written.add(run_log.table, scene)
            written.finish(metadata)

    write_atomically(path, write, force, LogError)
    return [path]


def export_live(
    run: Path, path: Path, scene: Callable[[RunLog, int], Iterable[SceneMessage]], wait: float = 0.5,
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
