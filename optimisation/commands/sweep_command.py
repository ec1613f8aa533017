"""`aerodima sweep ...`: studies of many runs, here or on a cluster."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.cli.help_sections import SWINGS

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.studies.study_report import Findings
    from aerodima.optimisation.sweep.study import Study

Out = Annotated[Path, typer.Option(help="Folder for tables, plots and index.html; a stopped study goes on in it.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="Override of every run, such as car.com_height=0.21; repeatable.")
]
Ensemble = Annotated[str | None, typer.Option(help="Run every case for the members of this ensemble, such as car.")]
Members = Annotated[int | None, typer.Option(help="Only that many members of the ensemble, drawn by weight.", min=1)]
Workers = Annotated[int, typer.Option(help="Worker processes, one BLAS thread each.")]
Scheduler = Annotated[str | None, typer.Option(help="Dask scheduler to use instead, such as tcp://127.0.0.1:8786.")]
Force = Annotated[bool, typer.Option("--force", help="Drop earlier results in the folder.")]


def register(app: typer.Typer) -> None:
    """Adds the group `sweep`."""
    group = typer.Typer(no_args_is_help=True, help="Run studies of many runs, on this computer or a cluster.")
    group.callback()(_group)
    group.command("run")(run)
    group.command()(turn)
    group.command()(tail)
    group.command()(mount)
    group.command()(trigger)
    group.command()(shapes)
    group.command("monte-carlo")(monte_carlo)
    app.add_typer(group, name="sweep", rich_help_panel=SWINGS)


def _group() -> None:
    """Run studies of many runs, on this computer or a cluster; each can be stopped and goes on when asked again."""


def run(
    study: Annotated[Path, typer.Argument(help="Study file (YAML): scenario with grid and sampled factors.")],
    out: Out,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """Run a study file; one row per run in table.parquet and table.csv.

    Example: aerodima sweep run study.yaml --out sweeps/study
    """
    from aerodima.optimisation.sweep.run_study import run_study
    from aerodima.optimisation.sweep.study import load_study, plan_runs
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.optimisation.sweep.study_store import TABLE
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.report.demo import terminal

    loaded = load_study(study)
    plan_runs(loaded)
    say = terminal()
    with open_engine(workers, scheduler, say=say, record=out / WORKER_RECORD) as engine:
        run_study(loaded, out, engine, force=force, say=say)
    print(f"table: {out / TABLE}")


def turn(
    out: Out,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """Speed x tail mode x tail speed: 20 runs without tail, 48 with it (thesis Figures 7.8 and 7.10 to 7.13).

    Example: aerodima sweep turn --out sweeps/turn
    """
    from aerodima.optimisation.studies.turn_study import read_turn, turn_study

    _report(turn_study(settings or (), ensemble, members), read_turn, out, workers, scheduler, force)


def tail(
    out: Out,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """What tail is worth building: critical friction over its length, width, mass and C_N; inertial tails beside.

    Example: aerodima sweep tail --out sweeps/tail
    """
    from aerodima.optimisation.studies.tail_study import read_tail, tail_study

    _report(tail_study(settings or (), ensemble, members), read_tail, out, workers, scheduler, force)


def mount(
    out: Out,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """The yaw penalty of a swing, and its remedies: place of the tail, ballast in front, longer steering (Figure 7.9).

    Example: aerodima sweep mount --out sweeps/mount
    """
    from aerodima.optimisation.studies.mount_study import mount_study, read_mount

    _report(mount_study(settings or (), ensemble, members), read_mount, out, workers, scheduler, force)


def trigger(
    out: Out,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """When the swing should begin: yaw rate, lateral acceleration or delayed steering; delay and travel (6.3.4).

    Example: aerodima sweep trigger --out sweeps/trigger
    """
    from aerodima.optimisation.studies.trigger_study import read_trigger, trigger_study

    _report(trigger_study(settings or (), ensemble, members), read_trigger, out, workers, scheduler, force)


def shapes(
    out: Out,
    goals: Annotated[
        Path | None, typer.Argument(help="CFD goal table (CSV): shape, speed, angle, and C_D and C_L, or forces.")
    ] = None,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """Sail shapes compared: drag and lift, the tunnel's coefficients beside, and what each does for the car.

    Without a table the drag coefficients of the thesis' Table 2.1 are taken.

    Example: aerodima sweep shapes goals.csv --out sweeps/shapes
    """
    from functools import partial

    from aerodima.optimisation.studies.shape_goals import load_goals, published_goals
    from aerodima.optimisation.studies.shape_study import read_shapes, shapes_study

    table = published_goals() if goals is None else load_goals(goals)
    study = shapes_study(table, settings or (), ensemble, members)
    _report(study, partial(read_shapes, table), out, workers, scheduler, force)


def monte_carlo(
    out: Out,
    samples: Annotated[int, typer.Option(help="Per tail mode; a power of 2 is best.", min=1)] = 32,
    seed: Annotated[int, typer.Option(help="Of the samples.", min=0)] = 1,
    settings: Settings = None,
    ensemble: Ensemble = None,
    members: Members = None,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Force = False,
) -> None:
    """Rollover probability under uncertain friction, speed and trigger noise, with its interval.

    Example: aerodima sweep monte-carlo --samples 32 --out sweeps/monte-carlo
    """
    from aerodima.optimisation.studies.monte_carlo_study import monte_carlo_study, read_monte_carlo

    study = monte_carlo_study(samples, seed, settings or (), ensemble, members)
    _report(study, read_monte_carlo, out, workers, scheduler, force)


def _report(
    study: Study,
    read: Callable[[pd.DataFrame], Findings],
    out: Path,
    workers: int,
    scheduler: str | None,
    force: bool,
) -> None:
    from aerodima.optimisation.studies.study_report import make_report
    from aerodima.optimisation.sweep.study import check_factors, plan_runs
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.report.demo import terminal

    check_factors(study, "--set")
    plan_runs(study)
    say = terminal()
    with open_engine(workers, scheduler, say=say, record=out / WORKER_RECORD) as engine:
        page = make_report(study, read, out, engine, force=force, say=say)
    print(f"report: {page}")
