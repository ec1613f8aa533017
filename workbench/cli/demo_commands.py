"""`aerodima demo`: the published turn over speed and tail mode, with report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import RUNS
from aerodima.workbench.cli.options import Anew, Workers


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=RUNS)(demo)


def demo(
    out: Annotated[Path, typer.Option(help="Folder for report, table, replays and logs.")] = Path("out/demo"),
    workers: Workers = 2,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 1,
    force: Anew = False,
) -> None:
    """Run the published turn at 7 speeds with no tail, tail held and tail swung, and write a report.

    Asked for again after Ctrl-C it keeps the finished runs and goes on. Example: aerodima demo --out out/demo
    """
    import time

    from aerodima.workbench.batch.progress import terminal
    from aerodima.workbench.report.demo import DemoPlan, make_demo

    start = time.monotonic()
    report = make_demo(out, DemoPlan(seed=seed), workers=workers, force=force, say=terminal())
    typer.echo(f"report: {report} ({time.monotonic() - start:.0f} s)")
