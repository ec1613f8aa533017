"""`aerodima replay` and `compare`: runs watched again, and beside one another, from their logs alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.atomic_write import refuse_existing
from aerodima.workbench.cli.options import RUNS, Force, Html
from aerodima.workbench.errors import LogError, UserError
from aerodima.workbench.text_table import shown_value, text_table

if TYPE_CHECKING:
    from aerodima.workbench.logs.schema import RunLog


def register(app: typer.Typer) -> None:
    """Adds the two commands."""
    app.command(rich_help_panel=RUNS)(replay)
    app.command(rich_help_panel=RUNS)(compare)


def replay(
    run: Annotated[Path, typer.Argument(help="Log of a run (Parquet); the path of a real car is reckoned.")],
    html: Html = None,
    strip: Annotated[Path | None, typer.Option(help="Write five pictures of the run as one PNG file.")] = None,
    port: Annotated[int | None, typer.Option(help="Show it in Meshcat on this port of 127.0.0.1.")] = None,
    rate: Annotated[float, typer.Option(help="Seconds of the run per second; 0.25 is slow motion.")] = 1.0,
    force: Force = False,
) -> None:
    """Replay a run: in Meshcat until Ctrl-C, or with --html and --strip as files.

    Example: aerodima replay run.parquet --html run.html --strip run.png
    """
    from aerodima.workbench.logs.schema import read_run_log

    if strip is not None and strip.suffix.lower() != ".png":
        raise UserError(f"--strip {strip}: ending {strip.suffix!r}; allowed: .png")
    for path in (html, strip):
        if path is not None:
            refuse_existing(path, force, UserError)
    run_log = read_run_log(run)
    from aerodima.workbench.replay.logged_car import replayable  # imports Drake

    run_log = replayable(run_log)
    if html is not None:
        from aerodima.workbench.report.replay_page import write_replay_html

        typer.echo(f"replay: {write_replay_html(run_log, html, force=force, rate=rate)}")
    if strip is not None:
        from aerodima.workbench.replay.strip import write_strip

        typer.echo(f"strip: {write_strip(run_log, strip, force=force)}")
    if port is not None or (html is None and strip is None):
        _show(run_log, port, rate)


def _show(run_log: RunLog, port: int | None, rate: float) -> None:
    """Plays the run in Meshcat until Ctrl-C."""
    from aerodima.workbench.replay.logged_car import caption_of
    from aerodima.workbench.replay.recording import record_run
    from aerodima.workbench.replay.viewer import open_meshcat

    meshcat = open_meshcat(port)
    record_run(run_log, meshcat, rate)
    typer.echo(caption_of(run_log).text)
    typer.echo(f"open {meshcat.web_url()} in a browser; Ctrl-C ends")
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        typer.echo("")


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two to five run logs (Parquet).")],
    html: Annotated[Path | None, typer.Option(help="Write the page: table, signals, replays in step.")] = None,
    force: Force = False,
) -> None:
    """Compare runs: what was set differently, the metrics side by side, and with --html signals and replays.

    Example: aerodima compare none.parquet swing.parquet --html compare.html
    """
    from aerodima.workbench.logs.schema import read_run_log

    names = _names(runs)
    if html is not None:
        refuse_existing(html, force, UserError)
    run_logs = [read_run_log(path) for path in runs]
    from aerodima.workbench.metrics.turn_metrics import jolt_line, metrics_of
    from aerodima.workbench.report.replay_page import (
        comparison_page,
        different_cars,
        metrics_rows,
        scenario_differences,
    )
    from aerodima.workbench.report.report_page import write_files

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
    if len(set(runs)) < len(runs):
        twice = next(path for path in runs if runs.count(path) > 1)
        raise LogError(f"{twice}: named twice")
    stems = [path.stem for path in runs]
    return stems if len(set(stems)) == len(stems) else [str(path) for path in runs]
