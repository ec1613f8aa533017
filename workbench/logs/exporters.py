"""Run logs for other programs: CSV for spreadsheets, MCAP for Foxglove and the like.

Both keep every bit of every number, and the metadata, so that `aerodima log import` gives back the same log. A CSV has
its metadata in a file beside it, `run.csv.json`; MCAP has them inside.
"""

from pathlib import Path
from typing import Any, Literal

from aerodima.workbench.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.config.signal_table import PLANT_POSITION_PREFIX, TIME
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import metadata_json, sidecar
from aerodima.workbench.logs.schema import RunLog

Format = Literal["csv", "mcap"]
FORMATS: tuple[Format, ...] = ("csv", "mcap")


def export_log(run_log: RunLog, path: Path | str, form: Format, force: bool = False) -> list[Path]:
    """Writes a run log as CSV or MCAP; gives the files written.

    Raises:
        LogError: a file exists and `force` is not set; MCAP without the package, or with negative times.
    """
    path = Path(path)
    metadata = metadata_json(_exported(run_log))
    if form == "csv":
        beside = sidecar(path)
        refuse_existing(beside, force, LogError)
        write_atomically(path, run_log.table.to_csv(index=False), force, LogError)
        write_atomically(beside, metadata + "\n", force, LogError)
        return [path, beside]
    from aerodima.workbench.logs.mcap_files import write_mcap

    def write(temporary: Path) -> None:
        write_mcap(temporary, run_log.table, topics_of(list(run_log.table.columns)), TIME, metadata)

    write_atomically(path, write, force, LogError)
    return [path]


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
