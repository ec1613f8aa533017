"""`aerodima calibrate`: from the published figures to the cars and tails that they leave possible."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.batch.dask_cluster import THREAD_VARIABLES
from aerodima.workbench.cli.help_sections import THESIS
from aerodima.workbench.cli.options import WorkOptions, grouped


def register(app: typer.Typer) -> None:
    """Adds the command `calibrate`."""
    app.command(rich_help_panel=THESIS)(calibrate)


@grouped
def calibrate(
    out: Annotated[Path, typer.Option(help="Folder for runs, ensemble and report.")] = Path("out/calibration"),
    plan: Annotated[str, typer.Option(help="Plan: a name of models/calibration/plans, or a file.")] = "car",
    seed: Annotated[int | None, typer.Option(help="Seed; that of the plan when left out.")] = None,
    *,
    work: WorkOptions,
) -> None:
    """Calibrate the car: ensemble, best set, sensitivities, validation. Ctrl-C stops it; the same command goes on."""
    # Before NumPy is loaded: with another number of BLAS threads the last digits differ, other cars are drawn, and an
    # interrupted calibration would not go on with its own runs.
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    from aerodima.optimisation.calibration.calibration import calibrate as carry_out
    from aerodima.optimisation.calibration.calibration_output import write_calibration
    from aerodima.optimisation.calibration.calibration_plan import load_plan
    from aerodima.optimisation.calibration.calibration_runs import RunStore
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import saying_how_to_go_on, terminal

    chosen = load_plan(plan)
    if seed is not None:
        chosen = chosen.model_copy(update={"seed": seed})
    say = terminal()
    with (
        RunStore(out, (*chosen.car, *chosen.tail), force=work.force) as store,
        saying_how_to_go_on(say, lambda: f"{len(store)} runs"),
        open_engine(work.workers, work.scheduler, say=say, record=out / WORKER_RECORD) as engine,
    ):
        result = carry_out(chosen, store, engine, say)
        report = write_calibration(result, out, store, engine, say)
    typer.echo(report)
