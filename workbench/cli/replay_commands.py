"""`aerodima replay`: watch a run again, from its log alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.cli.help_sections import RUNS
from aerodima.workbench.cli.options import Force, Html

if TYPE_CHECKING:
    from aerodima.workbench.logs.schema import RunLog


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=RUNS)(replay)


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
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.errors import UserError
    from aerodima.workbench.logs.schema import read_run_log

    if strip is not None and strip.suffix.lower() != ".png":
        raise UserError(f"--strip {strip}: ending {strip.suffix!r}; allowed: .png")
    for path in (html, strip):
        if path is not None:
            refuse_existing(path, force, UserError)
    run_log = read_run_log(run)
    from aerodima.workbench.replay.reckoned_motion import replayable  # imports Drake

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
    from aerodima.workbench.replay.caption import caption_of
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
