"""`aerodima range-of-motion`: where the tail can go without touching the car."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import CHECKS
from aerodima.workbench.cli.options import Force, ScenarioArgument, Settings


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("range-of-motion", rich_help_panel=CHECKS)(range_of_motion)


def range_of_motion(
    scenario: ScenarioArgument = "turn_swing",
    out: Annotated[Path, typer.Option(help="The map as CSV; its picture goes beside it as PNG.")] = Path(
        "range_of_motion.csv"
    ),
    pitch_nodes: Annotated[int, typer.Option(help="Nodes over the range of the pitch joint.")] = 37,
    roll_nodes: Annotated[int, typer.Option(help="Nodes over the range of the roll joint.")] = 37,
    margin: Annotated[float, typer.Option(help="Clearance to keep, m.", min=0.0, max=0.3)] = 0.01,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """Map the clearance of rod and sail to cage, deck, wheels and ground over pitch and roll of the tail.

    Example: aerodima range-of-motion --out range.csv
    """
    from math import degrees

    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.errors import UserError
    from aerodima.workbench.figures.clearance_figure import plot_range_of_motion
    from aerodima.workbench.figures.figure_style import png
    from aerodima.workbench.plants.clearance import PARTS, make_range_of_motion, write_range_of_motion
    from aerodima.workbench.report.report_page import write_files

    picture = out.with_suffix(".png")
    if picture == out:
        raise UserError(f"--out {out}: allowed: another ending than .png, which is the picture's")
    for path in (out, picture):
        refuse_existing(path, force, UserError)
    motion = make_range_of_motion(load_scenario(scenario, settings or []), pitch_nodes, roll_nodes)
    write_range_of_motion(motion, out, force=force)
    write_files(picture.parent, {picture.name: png(plot_range_of_motion(motion, margin))}, force=force)
    free = motion.clearance(motion.pitch[:, None], motion.roll[None, :]) >= margin
    low, high = motion.allowed_roll(0.0, margin)
    typer.echo(f"free by {1000 * margin:g} mm: {free.mean():.0%} of the range; upright pitch: roll "
               f"{degrees(low):.0f} to {degrees(high):.0f} deg")  # fmt: skip
    for number, part in enumerate(PARTS):
        least = motion.clearances[:, :, number]
        pitch, roll = divmod(int(least.argmin()), len(motion.roll))
        typer.echo(
            f"{part}: {1000 * least.min():.0f} mm at the least, pitch {degrees(motion.pitch[pitch]):.0f} deg, roll "
            f"{degrees(motion.roll[roll]):.0f} deg"
        )
    typer.echo(f"map: {out}, picture: {picture}")
