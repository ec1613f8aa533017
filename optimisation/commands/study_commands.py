"""`aerodima sweep run` and `sweep threshold`: studies of many runs, and where a car begins to roll over."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima.workbench.batch.dask_cluster import THREAD_VARIABLES
from aerodima.workbench.cli.options import (
    SWINGS,
    THESIS,
    Ensemble,
    ScenarioArgument,
    Scheduler,
    Settings,
    Workers,
    WorkOptions,
    command_group,
    grouped,
)

if TYPE_CHECKING:
    from aerodima.workbench.batch.engine import Engine
    from aerodima.workbench.batch.row_store import ProgressLine


Out = Annotated[Path, typer.Option(help="Folder for the tables; a stopped study goes on in it.")]


def register(app: typer.Typer) -> None:
    """Adds the group `sweep`, `calibrate` and `report`."""
    sweep = command_group(app, "sweep", "Run studies of many runs, on this computer or a cluster.", SWINGS)
    sweep.command()(run)
    sweep.command(no_args_is_help=True)(threshold)
    for command in (calibrate, report):
        app.command(rich_help_panel=THESIS)(command)


@contextmanager
def engine_for(
    out: Path | None, workers: int = 2, scheduler: str | None = None
) -> Iterator[tuple[Engine, ProgressLine]]:
    """An engine whose workers leave their record in a folder, and the terminal for lines of progress."""
    from aerodima.optimisation.sweep.runs import open_run_engine
    from aerodima.workbench.batch.row_store import WORKER_RECORD, terminal

    progress = terminal()
    with open_run_engine(
        workers, scheduler, progress=progress, record=None if out is None else out / WORKER_RECORD
    ) as engine:
        yield engine, progress


@grouped
def run(
    study: Annotated[str, typer.Argument(help="Study file (YAML), or one that ships: turn, tail, mount, trigger, ...")],
    out: Out,
    work: WorkOptions,
) -> None:
    """Run a study file; one row per run in table.parquet and table.csv. `models/studies` has those that ship.

    Example: aerodima sweep run mount --out sweeps/mount
    """
    from aerodima.optimisation.sweep.run_study import TABLE, run_study
    from aerodima.optimisation.sweep.study import load_study, plan_runs

    loaded = load_study(study)
    plan_runs(loaded)
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        run_study(loaded, out, engine, force=work.force, progress=progress)
    print(f"table: {out / TABLE}")


def threshold(
    factor: Annotated[str, typer.Argument(help="speed (m/s), or friction of the tyres.")],
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    low: Annotated[float | None, typer.Option("--from", help="Lowest value; 2.5 m/s, or 0.4.")] = None,
    high: Annotated[float | None, typer.Option("--to", help="Highest value; 6.5 m/s, or 1.1.")] = None,
    scan: Annotated[
        float | None, typer.Option(help="Step of the scan, 0.25 m/s or 0.05; narrower islands may be missed.")
    ] = None,
    tolerance: Annotated[float | None, typer.Option(help="Between survived and flipped, 0.05 m/s or 0.01.")] = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
) -> None:
    """Find where a car begins to roll over: highest value survived, first at which it flips, and islands beyond.

    Example: aerodima sweep threshold friction turn_swing --set manoeuvre.speed=4.44
    """
    from aerodima.optimisation.sweep.rollover_threshold import SEARCHES, Case, find_thresholds
    from aerodima.optimisation.sweep.runs import Runs
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.errors import SweepError
    from aerodima.workbench.text_table import text_table

    if factor not in SEARCHES:
        raise SweepError(f"{factor}: allowed: {', '.join(SEARCHES)}")
    given = {"low": low, "high": high, "scan": scan, "tolerance": tolerance}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    search = replace(SEARCHES[factor], **changes)
    load_scenario(scenario, settings or ())
    with engine_for(None, workers, scheduler) as (engine, progress):
        cases = [Case(scenario, scenario, tuple(settings or ()))]
        (found,) = find_thresholds(cases, search, Runs(engine), lambda done, known: progress(f"[{done}/{known}] runs"))
    typer.echo("\n".join(text_table(list(found.summary), [list(found.summary.values())])))


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
