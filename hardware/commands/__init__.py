"""The commands of this package, heavy imports inside the functions."""

from __future__ import annotations

import typer

from aerodima.hardware.commands.car_commands import console, drive, emulate
from aerodima.workbench.cli import options as cli


def register(app: typer.Typer) -> None:
    """Adds the commands in the order of the help page (entry point group `aerodima.commands`)."""
    for command in (drive, console, emulate):
        app.command(rich_help_panel=cli.CAR)(command)
