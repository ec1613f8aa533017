"""`aerodima passivity`: critical friction over speed for tails from passive to active."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import SWINGS


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=SWINGS)(passivity)


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
    from aerodima.optimisation.studies.leaderboard.leaderboard import open_runs
    from aerodima.optimisation.studies.leaderboard.passivity import SPEEDS, measure_passivity, write_passivity
    from aerodima.optimisation.sweep.study_engine import RememberingEngine, open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import saying_how_to_go_on, terminal

    say = terminal()
    record = out / WORKER_RECORD
    with (
        open_engine(workers, say=say, record=record) as engine,
        open_runs(out) as store,
        saying_how_to_go_on(say, lambda: f"{len(store.rows)} runs"),
    ):
        table = measure_passivity(RememberingEngine(engine, store, say, "passive and active tails"), speed or SPEEDS)
    for row in table.to_dict("records"):
        typer.echo(f"{row['tail']:24} {row['speed_m_per_s']:g} m/s: critical friction {row['critical_friction']:.4f}")
    for path in write_passivity(table, out):
        typer.echo(f"written: {path}")
