"""`aerodima report`: which claims of the thesis this car reproduces."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import THESIS
from aerodima.workbench.cli.options import Ensemble, WorkOptions, grouped


def register(app: typer.Typer) -> None:
    """Adds the command `report`."""
    app.command(rich_help_panel=THESIS)(report)


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
    from aerodima.optimisation.studies.reproduction_report import write_report
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import terminal
    from aerodima.workbench.config.ensemble import load_ensemble

    chosen = load_ensemble(ensemble)
    say = terminal()
    with open_engine(work.workers, work.scheduler, say=say, record=out / WORKER_RECORD) as engine:
        page = write_report(chosen, members, out, engine, say, replays=replays, force=work.force, survival=survival)
        typer.echo(page)
