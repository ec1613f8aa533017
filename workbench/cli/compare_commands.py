"""`aerodima compare`: runs beside one another, as a table and as a page with the replays in step."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import RUNS
from aerodima.workbench.cli.options import Force


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=RUNS)(compare)


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two to five run logs (Parquet).")],
    html: Annotated[Path | None, typer.Option(help="Write the page: table, signals, replays in step.")] = None,
    force: Force = False,
) -> None:
    """Compare runs: what was set differently, the metrics side by side, and with --html signals and replays.

    Example: aerodima compare none.parquet swing.parquet --html compare.html
    """
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.errors import LogError, UserError
    from aerodima.workbench.logs.schema import read_run_log
    from aerodima.workbench.text_table import shown_value, text_table

    names = _names(runs)
    if html is not None:
        refuse_existing(html, force, UserError)
    run_logs = [read_run_log(path) for path in runs]
    from aerodima.workbench.metrics.turn_metrics import jolt_line, metrics_of
    from aerodima.workbench.report.comparison_page import (
        MOST_RUNS,
        comparison_page,
        different_cars,
        metrics_rows,
        scenario_differences,
    )
    from aerodima.workbench.report.report_page import write_files

    if not 2 <= len(runs) <= MOST_RUNS:
        raise LogError(f"{len(runs)} run(s) to compare; allowed: 2 to {MOST_RUNS}")
    differences = scenario_differences(run_logs)
    for group in (differences, metrics_rows(run_logs)):
        table = text_table(["", *names], [[key, *map(shown_value, values)] for key, values in group.items()])
        typer.echo("\n".join([*table, ""]))
    for name, run_log in zip(names, run_logs, strict=True):
        line = jolt_line(metrics_of(run_log))
        if line:
            typer.echo(f"note: {name}: {line}")
    other = different_cars(differences)
    if other:
        typer.echo(f"note: these are different cars: {', '.join(other)}")
    if html is not None:
        (written,) = write_files(html.parent, {html.name: comparison_page(run_logs, names)}, force=force)
        typer.echo(f"page: {written}")


def _names(runs: list[Path]) -> list[str]:
    """File names without ending; whole paths where these are not enough."""
    from aerodima.workbench.errors import LogError

    if len(set(runs)) < len(runs):
        twice = next(path for path in runs if runs.count(path) > 1)
        raise LogError(f"{twice}: named twice")
    stems = [path.stem for path in runs]
    return stems if len(set(stems)) == len(stems) else [str(path) for path in runs]
