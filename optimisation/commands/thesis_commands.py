"""`aerodima calibrate` and `report`: what of the thesis is reproduced."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.study_commands import engine_for
from aerodima.workbench.batch.dask_cluster import THREAD_VARIABLES
from aerodima.workbench.cli.options import THESIS, Ensemble, WorkOptions, grouped


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    for command in (calibrate, report):
        app.command(rich_help_panel=THESIS)(command)


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
    from aerodima.workbench.batch.row_store import saying_how_to_go_on

    chosen = load_plan(plan)
    if seed is not None:
        chosen = chosen.model_copy(update={"seed": seed})
    with (
        RunStore.for_plan(out, chosen, force=work.force) as store,
        engine_for(out, work.workers, work.scheduler) as (engine, progress),
        saying_how_to_go_on(progress, lambda: f"{len(store)} runs"),
    ):
        result = carry_out(chosen, store, engine, progress)
        report = write_calibration(result, out, store, engine, progress)
    typer.echo(report)


@grouped
def report(
    out: Annotated[Path, typer.Option(help="Folder for page, table, runs and replays.")] = Path("out/report"),
    ensemble: Ensemble = "car",
    members: Annotated[int, typer.Option(help="How many members are run, drawn by weight.")] = 12,
    replays: Annotated[bool, typer.Option(help="Also make replays of the interesting runs of the best member.")] = True,
    survival: Annotated[
        bool, typer.Option("--survival", help="Also run every tail mode at seven speeds: survival.csv.")
    ] = False,
    *,
    work: WorkOptions,
) -> None:
    """Write one page and one CSV: every claim of the thesis that can be recomputed, with band and verdict."""
    from aerodima.optimisation.calibration.reproduction_report import write_reproduction_report
    from aerodima.workbench.config.ensemble import load_ensemble

    chosen = load_ensemble(ensemble)
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        page = write_reproduction_report(
            chosen, members, out, engine, progress, replays=replays, force=work.force, survival=survival
        )
        typer.echo(page)
