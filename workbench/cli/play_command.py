"""`aerodima play`: the simulated car driven by hand in the browser."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.atomic_write import refuse_existing
from aerodima.workbench.cli.options import RUNS, Force, ScenarioOption, Settings
from aerodima.workbench.errors import LogError, UserError


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=RUNS)(play)


def play(
    scenario: ScenarioOption = "turn_swing",
    settings: Settings = None,
    pace: Annotated[float, typer.Option(help="Seconds of the run per second, 0.1 to 1; 0.5 is half speed.")] = 1.0,
    length: Annotated[float, typer.Option(help="End after so many simulated seconds.")] = math.inf,
    log: Annotated[Path | None, typer.Option(help="Keep the run log as this Parquet file.")] = None,
    port: Annotated[int | None, typer.Option(help="Port of Meshcat on 127.0.0.1.")] = None,
    force: Force = False,
) -> None:
    """Drive the simulated car by hand in the browser: keyboard, sliders or gamepad; no device takes part.

    Example: aerodima play --log by_hand.parquet --pace 0.5
    """
    if not 0.1 <= pace <= 1.0:
        raise UserError(f"--pace: {pace:g}; allowed: 0.1 to 1")
    if not length > 0.0:
        raise UserError(f"--length: {length:g} s; allowed: > 0")
    if log is not None:
        refuse_existing(log, force, LogError)
    from aerodima.workbench.config.scenario import load_scenario

    car = load_scenario(scenario, settings or ())
    from aerodima.workbench.cli.turn_commands import live_view
    from aerodima.workbench.replay.hand_drive import drive_by_hand
    from aerodima.workbench.replay.meshcat_controls import HELP, MeshcatControls

    meshcat = live_view(port)
    typer.echo(HELP, err=True)
    controls = MeshcatControls(meshcat, car, pace, typer.echo)
    for written in drive_by_hand(car, controls, log=log, meshcat=meshcat, length=length, force=force, say=typer.echo):
        from aerodima.workbench.logs.schema import read_run_log
        from aerodima.workbench.replay.captions import caption_of

        typer.echo(f"log: {written}: {caption_of(read_run_log(written)).text}")
