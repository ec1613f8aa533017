"""`aerodima feedback`: gives a swing the gains by which its tracker holds the car to it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import SWINGS
from aerodima.workbench.cli.options import Force, Settings, SwingArgument


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=SWINGS)(feedback)


def feedback(
    swing: SwingArgument,
    out: Annotated[Path, typer.Option(help="Swing file to write.")],
    scenario: Annotated[
        str | None, typer.Option(help="Turn to hold the car to; by default the file's own, else turn_swing.")
    ] = None,
    settings: Settings = None,
    other_car: Annotated[bool, typer.Option("--other-car", help="Use another car than it was made for.")] = False,
    force: Force = False,
) -> None:
    """Run a swing on the full car, linearise the planar model along that run, and store finite-horizon LQR gains.

    Make them at the highest friction or speed that the swing survives by itself: there they know a car on two wheels.
    Example: aerodima feedback thesis_8_rad_per_s --set manoeuvre.speed=3.61 --out tracked.yaml
    """
    from aerodima.optimisation.swing.feedback_gains import with_feedback
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.config.swing_file import write_swing
    from aerodima.workbench.controllers.law_of_scenario import find_swing, refuse_other_car
    from aerodima.workbench.errors import SwingFileError

    refuse_existing(out, force, SwingFileError)
    plain = find_swing(swing)
    turn = scenario or plain.provenance.scenario or "turn_swing"
    resolved = load_scenario(turn, ["tail.mode=swing", *(settings or []), f"controller.swing_file={swing}"])
    if not other_car:
        refuse_other_car(resolved)
    tracked = with_feedback(plain, resolved)
    write_swing(tracked, out, force=force)
    gains = tracked.gains.feedback
    assert gains is not None
    typer.echo(f"feedback on {', '.join(gains.states)} at {len(gains.time_s)} times over {gains.time_s[-1]:.2f} s")
    typer.echo(f"swing: {out}")
