"""`aerodima play` and `replay`: drive by hand in a browser; show runs as page, strip or video."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.cli.log_commands import run_names
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.ranges import NO_UNIT, check_range

if TYPE_CHECKING:
    from aerodima.workbench.logs.schema import RunLog


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(rich_help_panel=cli.RUNS)(play)
    app.command(rich_help_panel=cli.RUNS)(replay)


def play(
    scenario: cli.ScenarioArgument = "turn_swing",
    settings: cli.Settings = None,
    pace: Annotated[
        float, typer.Option(help="Seconds of the run per second, 0.1 to 1; 0.5 is half speed.")
    ] = 1.0,
    length: Annotated[float, typer.Option(help="End after so many simulated seconds.")] = math.inf,
    out: cli.KeptLog = None,
    port: Annotated[int | None, typer.Option(help="Port of Meshcat on 127.0.0.1.")] = None,
    force: cli.Force = False,
) -> None:
    """Drive the simulated car by hand in the browser.

    Keyboard, sliders or gamepad steer; no device takes part.

    Example: aerodima play --out by_hand.parquet --pace 0.5
    """
    check_range("--pace", pace, 0.1, 1.0, NO_UNIT)
    if not length > 0.0:
        raise UserError(f"--length: {length:g} s must be > 0")
    refuse_existing(out, force, LogError)

    car = workbench.load_scenario(scenario, settings or ())
    from aerodima.workbench.cli.run_commands import live_view
    from aerodima.workbench.view.hand_drive import HELP, MeshcatControls, drive_by_hand

    meshcat = live_view(port)
    typer.echo(HELP, err=True)
    controls = MeshcatControls(meshcat, car, pace, typer.echo)
    for written in drive_by_hand(
        car, controls, log=out, meshcat=meshcat, length=length, force=force, say=typer.echo
    ):
        from aerodima.workbench.view.captions import run_caption

        typer.echo(f"log: {written}: {run_caption(workbench.read_run_log(written)).text}")


def replay(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Log of a run (Parquet); with --video up to six, in step.", metavar="RUN..."
        ),
    ],
    html: cli.Html = None,
    strip: Annotated[
        Path | None,
        typer.Option(
            help="Write five pictures of the run as one PNG file.", callback=cli.endings(".png")
        ),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Write a .mp4, .gif or .webp; several runs side by side.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(help="Show it in Meshcat on this port of 127.0.0.1.")
    ] = None,
    start: Annotated[
        float, typer.Option("--from", help="Begin the video so late in the run, s.")
    ] = 0.0,
    rate: Annotated[
        float, typer.Option(help="Seconds of the run per second; 0.25 is slow motion.")
    ] = 1.0,
    force: cli.Force = False,
) -> None:
    """Replay runs in Meshcat, as a page, pictures or a video.

    Without --html, --strip and --video it is Meshcat, until Ctrl-C. A real car's path is reckoned
    from its sensors. Example: aerodima replay run.parquet --html run.html --strip run.png --video
    run.webp
    """
    others = html is not None or strip is not None or port is not None
    if len(runs) > 1 and (video is None or others):
        raise UserError(
            f"{len(runs)} runs: must be with --video alone; `aerodima log compare` makes a page "
            "of them"
        )
    for path in (html, strip, video):
        refuse_existing(path, force, UserError)
    if video is not None:
        _write_video(runs, video, start, rate, force)
        if not others:
            return
    run_log = workbench.read_run_log(runs[0])
    if html is not None:
        from aerodima.workbench.view.replay_page import write_replay_html

        typer.echo(f"replay: {write_replay_html(run_log, html, force=force, rate=rate)}")
    if strip is not None:
        from aerodima.workbench.view.filmstrip import write_strip

        typer.echo(f"strip: {write_strip(run_log, strip, force=force)}")
    if port is not None or (html is None and strip is None):
        _show(run_log, port, rate)


def _write_video(runs: list[Path], video: Path, start: float, rate: float, force: bool) -> None:
    from aerodima.workbench.cli.run_commands import show_progress
    from aerodima.workbench.view.video import write_video

    names = [name.replace("_", " ") for name in run_names(runs)]
    filmed = {name: workbench.read_run_log(path) for name, path in zip(names, runs, strict=True)}
    progress = show_progress("frame", "")
    path = write_video(filmed, video, force=force, rate=rate, progress=progress, start=start)
    typer.echo(f"video: {path}")


def _show(run_log: RunLog, port: int | None, rate: float) -> None:
    """Play the run in Meshcat until Ctrl-C."""
    from aerodima.workbench.view.captions import run_caption
    from aerodima.workbench.view.recording import record_run
    from aerodima.workbench.view.viewer import open_meshcat

    meshcat = open_meshcat(port)
    record_run(run_log, meshcat, rate)
    typer.echo(run_caption(run_log).text)
    typer.echo(f"open {meshcat.web_url()} in a browser; Ctrl-C ends")
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        typer.echo("")
