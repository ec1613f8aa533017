"""`aerodima sweep run` and `sweep threshold`: studies of many runs, and where a car begins to roll over."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    grouped,
)

if TYPE_CHECKING:
    from aerodima.optimisation.sweep.rollover_threshold import Search, Threshold
    from aerodima.workbench.batch import Engine
    from aerodima.workbench.batch.row_store import ProgressLine


Out = Annotated[Path, typer.Option(help="Folder for the tables; a stopped study goes on in it.")]


def register(app: typer.Typer) -> None:
    """Adds the group `sweep`, `calibrate` and `report`."""
    sweep = typer.Typer(no_args_is_help=True, help="Run studies of many runs, on this computer or a cluster.")
    sweep.callback()(_studies)
    sweep.command()(run)
    threshold = typer.Typer(no_args_is_help=True, help="Find where a car begins to roll over.")
    threshold.callback()(_thresholds)
    threshold.command()(speed)
    threshold.command()(friction)
    sweep.add_typer(threshold, name="threshold")
    app.add_typer(sweep, name="sweep", rich_help_panel=SWINGS)
    for command in (calibrate, report):
        app.command(rich_help_panel=THESIS)(command)


@contextmanager
def engine_for(
    out: Path | None, workers: int = 2, scheduler: str | None = None
) -> Iterator[tuple[Engine, ProgressLine]]:
    """An engine whose workers leave their record in a folder, and the terminal for lines of progress."""
    from aerodima.optimisation.sweep.runs import open_run_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.row_store import terminal

    progress = terminal()
    with open_run_engine(
        workers, scheduler, progress=progress, record=None if out is None else out / WORKER_RECORD
    ) as engine:
        yield engine, progress


def _studies() -> None:
    """Run studies of many runs, on this computer or a cluster; each can be stopped and goes on when asked again."""


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


def _thresholds() -> None:
    """Find where a car begins to roll over: by speed, or by grip."""


def speed(
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    low: Annotated[float, typer.Option("--from", help="Lowest speed, m/s.")] = 2.5,
    high: Annotated[float, typer.Option("--to", help="Highest speed, m/s.")] = 6.5,
    scan: Annotated[float, typer.Option(help="Step of the scan, m/s; narrower islands may be missed.")] = 0.25,
    tolerance: Annotated[float, typer.Option(help="Between survived and flipped, m/s.")] = 0.05,
    workers: Workers = 2,
    scheduler: Scheduler = None,
) -> None:
    """Highest speed survived at the scenario's friction, the first at which it flips, and islands beyond.

    Example: aerodima sweep threshold speed turn_none --to 4.5
    """
    from aerodima.optimisation.sweep.rollover_threshold import SPEED, Search

    _print_threshold(scenario, settings or (), Search(SPEED, low, high, scan, tolerance), "m/s", workers, scheduler)


def friction(
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    low: Annotated[float, typer.Option("--from", help="Lowest tyre friction.")] = 0.4,
    high: Annotated[float, typer.Option("--to", help="Highest tyre friction.")] = 1.1,
    scan: Annotated[float, typer.Option(help="Step of the scan; narrower islands may be missed.")] = 0.05,
    tolerance: Annotated[float, typer.Option(help="Between survived and flipped.")] = 0.01,
    workers: Workers = 2,
    scheduler: Scheduler = None,
) -> None:
    """Critical friction at the scenario's speed: highest tyre friction survived, first that flips, islands beyond.

    Example: aerodima sweep threshold friction turn_swing --set manoeuvre.speed=4.44
    """
    from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search

    _print_threshold(scenario, settings or (), Search(FRICTION, low, high, scan, tolerance), "", workers, scheduler)


def _print_threshold(
    scenario: str, settings: Sequence[str], search: Search, unit: str, workers: int, scheduler: str | None
) -> None:
    from aerodima.optimisation.sweep.rollover_threshold import Case, find_thresholds
    from aerodima.optimisation.sweep.runs import Runs
    from aerodima.workbench.config.scenario import load_scenario

    load_scenario(scenario, settings)
    cases = [Case(scenario, scenario, tuple(settings))]
    with engine_for(None, workers, scheduler) as (engine, progress):
        (found,) = find_thresholds(cases, search, Runs(engine), lambda done, known: progress(f"[{done}/{known}] runs"))
    print("\n".join(describe(found, unit)))


def describe(found: Threshold, unit: str) -> list[str]:
    """Lines that say what a search came to."""
    from aerodima.optimisation.sweep.rollover_threshold import TIPPED

    search = found.search
    suffix = f" {unit}" if unit else ""
    name = search.factor
    if found.lost is None and found.survived is None:
        lines = [f"{name}: no run from {search.low:g} to {search.high:g}{suffix} came to its turn"]
    elif found.lost is None:
        lines = [f"{name}: no flip from {search.low:g} to {search.high:g}{suffix}; survives up to {found.survived:g}"]
    elif found.survived is None:
        lines = [f"{name}: flips at {found.lost:g}{suffix} already, the lowest value"]
    else:
        lines = [
            f"{name}: survives up to {found.survived:g}{suffix}, flips at {found.lost:g}{suffix} "
            f"(tolerance {search.tolerance:g}, {len(found.outcomes)} runs)"
        ]
        if found.lost - found.survived > search.tolerance + 1e-9:
            lines[0] += f"; the values between them, {found.lost - found.survived:.3g} apart, told nothing"
    if over := [value for value, outcome in found.outcomes.items() if outcome == TIPPED]:
        lines.append(f"{len(over)} run(s) tipped over before their turn, the first at {over[0]:g}: no evidence of it")
    for first, last in found.islands:
        where = f"at {first:g}" if first == last else f"from {first:g} to {last:g}"
        lines.append(f"island: survives again {where}{suffix} (scan step {search.scan:g})")
    if failed := [value for value, outcome in found.outcomes.items() if outcome.startswith("failed")]:
        lines.append(f"{len(failed)} run(s) failed, the first at {failed[0]:g}{suffix}: {found.outcomes[failed[0]]}")
    return lines


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
