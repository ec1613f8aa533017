"""`aerodima leaderboard` and `passivity`: tail controllers on the same turns and cars, passive and active tails."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.study_commands import engine_for
from aerodima.workbench.cli.options import SWINGS, Ensemble, Scheduler, Workers


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    for command in (leaderboard, passivity):
        app.command(rich_help_panel=SWINGS)(command)


def leaderboard(
    out: Annotated[Path, typer.Option(help="Folder for tables, page, replays and runs.")] = Path("out/leaderboard"),
    swing: Annotated[
        list[str] | None, typer.Option(help="Swing file or name, may be repeated; by default all that ship.")
    ] = None,
    ensemble: Ensemble = "car",
    members: Annotated[
        int | None, typer.Option(help="Only that many members, drawn by weight; 0: the own car alone.", min=0)
    ] = None,
    speed: Annotated[
        list[float] | None, typer.Option(help="Speed of the turn, m/s; may be repeated.", min=1.0, max=8.0)
    ] = None,
    robustness: Annotated[bool, typer.Option(help="Also play the best swing with what was not planned.")] = True,
    quick: Annotated[bool, typer.Option("--quick", help="One speed, coarse searches, no robustness.")] = False,
    step: Annotated[float, typer.Option(help="Step of the plant, s.", min=1e-4, max=0.005)] = 0.002,
    replays: Annotated[bool, typer.Option(help="Write a replay of each controller.")] = True,
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Annotated[bool, typer.Option("--force", help="Drop runs of other parameters or versions.")] = False,
) -> None:
    """Compare no tail, held, 8 rad/s, the best fixed speed and optimised swings by what the car survives.

    Asked for again after Ctrl-C, or with more members, it keeps the runs that are there.
    Example: aerodima leaderboard --members 2 --quick --out out/leaderboard
    """
    from dataclasses import replace

    from aerodima.optimisation.studies.contestants import QUICK, Plan, shipped_swings, standard_contestants
    from aerodima.optimisation.studies.leaderboard import make_leaderboard
    from aerodima.workbench.config.ensemble import load_ensemble

    swings = swing if swing is not None else shipped_swings()
    standard_contestants(swings)
    cars = load_ensemble(ensemble)
    chosen = cars.members if members is None else cars.drawn(members) if members else ()
    plan = replace(QUICK if quick else Plan(perturbed=robustness), step=step)
    if speed:
        plan = replace(plan, speeds=tuple(speed), map_speeds=tuple(speed))
    with engine_for(out, workers, scheduler) as (engine, progress):
        board, files = make_leaderboard(
            out, plan, swings, chosen, engine, replays=replays, force=force, progress=progress
        )
    for row in board.claims.to_dict("records"):
        typer.echo(
            f"{row['controller']:42} {row['speed_m_per_s']:g} m/s: critical friction {row['critical_friction']:.4f} "
            f"({row['gain_over_8_rad_per_s']:+.1%}), heading {row['heading_ratio']:.1%} of that with 8 rad/s"
        )
    typer.echo(f"page: {files[-1]}")


def passivity(
    out: Annotated[Path, typer.Option(help="Folder for passivity.csv and passivity.png.")] = Path("out/passivity"),
    speed: Annotated[
        list[float] | None, typer.Option(help="Speed of the turn, m/s; may be repeated.", min=1.0, max=8.0)
    ] = None,
    workers: Annotated[int, typer.Option(help="Worker processes, one BLAS thread each.", min=1)] = 2,
) -> None:
    """Is a more passive tail better at higher speed? Highest friction survived clean, tail by tail.

    Asked for again after Ctrl-C it keeps the runs that are there.
    Example: aerodima passivity --speed 4.5 --speed 6 --out out/passivity
    """
    from aerodima.optimisation.studies.leaderboard import open_runs
    from aerodima.optimisation.studies.passivity_study import SPEEDS, measure_passivity, write_passivity
    from aerodima.optimisation.sweep.study_engine import RememberingEngine
    from aerodima.workbench.batch.row_store import saying_how_to_go_on

    with (
        engine_for(out, workers) as (engine, progress),
        open_runs(out) as store,
        saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs"),
    ):
        table = measure_passivity(
            RememberingEngine(engine, store, progress, "passive and active tails"), speed or SPEEDS
        )
    for row in table.to_dict("records"):
        typer.echo(f"{row['tail']:24} {row['speed_m_per_s']:g} m/s: critical friction {row['critical_friction']:.4f}")
    for path in write_passivity(table, out):
        typer.echo(f"written: {path}")
