"""Makes the logs of a campaign in one folder: in parallel, going on where an earlier call stopped."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.batch import WORKER_RECORD, check_workers, run_batch
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, RowStore, saying_how_to_go_on, silent
from aerodima.workbench.config.rig_campaign import RigTask
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.simulate.simulation import simulate
from aerodima.workbench.stations.rig_station import known_truth

MARK, TABLE = "campaign.json", "campaign.csv"
"""What the folder holds beside the logs: the scenarios, so that a second call can tell whether it is the same
campaign; and the table of the logs with their truth."""
MARK_SCHEMA = "aerodima/rig-campaign-logs/2"
WORKER_KILLED = "its worker process was killed, beside other logs and alone (out of memory?)"


@dataclass(frozen=True)
class CampaignResult:
    """Outcome of a campaign.

    Attributes:
        logs: finished, in the order of the tasks.
        failed: name of the task -> reason.
        reused: how many logs were there already.
    """

    logs: list[Path]
    failed: dict[str, str]
    reused: int


def run_campaign(
    tasks: Sequence[RigTask],
    out: Path,
    *,
    workers: int = 2,
    force: bool = False,
    progress: ProgressLine = silent,
) -> CampaignResult:
    """Makes what is missing of the logs `out/<name>.parquet`, and the table `campaign.csv` with the truth of each.

    A log appears under its name only when it is whole, so a second call after Ctrl-C or a crash makes the rest. A log
    that cannot be made (the current's limit, a killed worker) is told and does not stop the others.

    Args:
        tasks: see `campaign_tasks`.
        out: folder; made when it is not there.
        workers: processes.
        force: make the logs of these tasks again, also over another campaign's.
        progress: told lines of progress.

    Raises:
        UserError: workers out of range, or the folder belongs to other things or another campaign.
    """
    check_workers(workers)
    scenarios = {task.name: task.scenario.resolved() for task in tasks}
    with RowStore(out / MARK, {"schema": MARK_SCHEMA, "scenarios": scenarios}, force=force, alone=True):
        paths = {task.name: out / f"{task.name}.parquet" for task in tasks}
        if force:
            for path in paths.values():
                path.unlink(missing_ok=True)
        missing = [task for task in tasks if not paths[task.name].exists()]
        reused, failed = len(tasks) - len(missing), dict[str, str]()
        bar = ProgressBar(progress, len(tasks), reused)

        def done(_count: int, outcome: tuple[str, str]) -> None:
            name, error = outcome
            if error:
                failed[name] = error
            bar.one_more(name)

        with saying_how_to_go_on(progress, lambda: f"{bar.done} of {len(tasks)} logs"):
            run_batch(partial(_make, out), missing, workers, done, _lost, progress=progress, record=out / WORKER_RECORD)
        made = [task for task in tasks if task.name not in failed]
        _write_table(out, made)
    return CampaignResult([paths[task.name] for task in made], failed, reused)


def _make(out: Path, task: RigTask) -> tuple[str, str]:
    """Name of the task and "", or the reason why there is no log."""
    path = out / f"{task.name}.parquet"
    if path.exists():  # whole: the worker was killed between writing it and saying so
        return task.name, ""
    journal_path(path).unlink(missing_ok=True)  # of a campaign that was killed
    try:
        simulate(task.scenario, path)
    except UserError as error:
        journal_path(path).unlink(missing_ok=True)
        return task.name, str(error)
    return task.name, ""


def _lost(task: RigTask) -> tuple[str, str]:
    return task.name, WORKER_KILLED


def _write_table(out: Path, tasks: Sequence[RigTask]) -> None:
    """One row per log: its experiment, seed and truth."""
    rows: list[dict[str, Any]] = []
    for task in tasks:
        scenario = task.scenario
        experiment = scenario.experiment
        rows.append(
            {
                "log": f"{task.name}.parquet",
                "kind": experiment.kind,
                "tail": scenario.tail_name,
                "axis": experiment.axis if scenario.has_cheetah_tail else "none",
                "angle_rad": experiment.angle,
                "wind_speed_m_per_s": experiment.wind_speed,
                "seed": scenario.seed,
                **{f"true_{name}": value for name, value in known_truth(scenario).items()},
            }
        )
    write_atomically(out / TABLE, pd.DataFrame(rows).to_csv(index=False), True, UserError)
