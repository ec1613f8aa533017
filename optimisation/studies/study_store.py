"""Where studies keep their runs: one store for a folder, for runs of these parameters and versions."""

from __future__ import annotations

from collections.abc import Container, Sequence
from pathlib import Path

from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.config.scenario import default_values, load_scenario
from aerodima.workbench.logs.schema import software_versions

SCENARIO = "turn_fast"


def open_runs(out: Path, *, force: bool = False) -> RowStore:
    """The store of runs below a folder.

    Args:
        out: folder; the runs are in its `runs.jsonl`.
        force: drop the runs of other parameters or versions.

    Raises:
        UserError: the folder is in use, or holds the runs of other parameters or versions.
    """
    identity = {
        "schema": "aerodima/leaderboard/5",
        "parameters": default_values(),
        "scenario": load_scenario(SCENARIO).resolved(),
        "versions": software_versions(),
    }
    return RowStore(out / "runs.jsonl", identity, force=force)


def drop_stale(out: Path, names: Sequence[str], written: Container[str]) -> None:
    """Removes files of an earlier call that this one does not write, so that all that is there is of one call.

    Args:
        out: folder; what it keeps of runs stays.
        names: of files that a call may write or not.
        written: those of this call.
    """
    for name in names:
        if name not in written:
            (out / name).unlink(missing_ok=True)
