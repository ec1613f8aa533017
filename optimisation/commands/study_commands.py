"""`aerodima sweep run` and `calibrate`: studies of many runs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import optimisation
from aerodima.workbench.batch.dask_cluster import THREAD_VARIABLES
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.extras import require

if TYPE_CHECKING:
    from aerodima.optimisation.studies.runs import CachedRunner
    from aerodima.workbench.batch.engine import Engine
    from aerodima.workbench.batch.row_store import ProgressLine


Out = Annotated[Path, cli.written("Folder for the tables; a stopped study goes on in it.")]


def register(app: typer.Typer) -> None:
    """Adds the group `sweep` and `calibrate`."""
    sweep = cli.command_group(
        app, "sweep", "Run studies of many runs, on this computer or a cluster.", cli.SWINGS
    )
    sweep.command()(run)
    app.command(rich_help_panel=cli.THESIS)(calibrate)


@contextmanager
def engine_for(
    out: Path, workers: int = 2, scheduler: str | None = None
) -> Iterator[tuple[Engine, ProgressLine]]:
    """Opens an engine whose workers record in a folder, and the terminal for lines of progress."""
    from aerodima.workbench.batch.row_store import WORKER_RECORD, terminal_progress

    progress = terminal_progress()
    with optimisation.open_run_engine(
        workers, scheduler, progress=progress, record=out / WORKER_RECORD
    ) as engine:
        yield engine, progress


@contextmanager
def runs_in(out: Path, work: cli.WorkOptions) -> Iterator[CachedRunner]:
    """Opens the runs that are kept in a folder, with the engine and the workers of the options."""
    from aerodima.optimisation.studies.runs import cached_runs

    with (
        engine_for(out, work.workers, work.scheduler) as (engine, progress),
        cached_runs(out, engine, force=work.force, progress=progress) as runs,
    ):
        yield runs


@cli.grouped
def run(
    study: Annotated[str, cli.named("Study", "studies")],
    out: Out,
    work: cli.WorkOptions,
) -> None:
    """Run a study file; one row per run in a table.

    It is written as table.parquet and table.csv; `models/studies` has the studies that ship.

    Example: aerodima sweep run mount --out sweeps/mount
    """
    from aerodima.optimisation.studies.run_study import TABLE
    from aerodima.optimisation.studies.study import plan_runs

    loaded = optimisation.load_study(study)
    plan_runs(loaded)
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        table = optimisation.run_study(loaded, out, engine, force=work.force, progress=progress)
    print(f"table: {out / TABLE}")
    if table["error"].fillna("").ne("").any():
        raise typer.Exit(cli.Status.LEFT_OUT)


@cli.grouped
def calibrate(
    out: Annotated[Path, cli.written("Folder for runs, ensembles and pages.")] = Path(
        "out/calibration"
    ),
    plan: Annotated[str, cli.named("Plan", "calibration/plans", typer.Option)] = "two_systems",
    seed: Annotated[int | None, typer.Option(help="Seed; that of the plan when left out.")] = None,
    cars: Annotated[
        int, typer.Option(min=0, help="Posterior cars that play the thesis to test the intervals.")
    ] = 10,
    *,
    work: cli.WorkOptions,
) -> None:
    """Calibrate the cars to the thesis and predict its figures.

    `index.html` says what holds, and what to measure next. Needs the extra `calibration`. The same
    command goes on after Ctrl-C.

    Example: aerodima calibrate --workers 2 --out out/calibration
    """
    # Before NumPy is loaded: with another number of BLAS threads the last digits differ, other cars
    # are drawn, and an interrupted calibration would not go on with its own runs.
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    from aerodima.optimisation.calibrate.calibration_plan import load_plan
    from aerodima.optimisation.calibrate.validation_page import calibrate as carry_out

    require("calibration", "calibrate", "emcee", "sklearn")
    chosen = load_plan(plan)
    if seed is not None:
        chosen = chosen.model_copy(update={"seed": seed})
    with runs_in(out, work) as runs:
        typer.echo(carry_out(chosen, runs, out, cars))
