"""The commands of this package, heavy imports inside the functions."""

from __future__ import annotations

import typer

from aerodima.hardware.commands.car_commands import console, drive, emulate, firmware
from aerodima.workbench.cli.options import CAR


def register(app: typer.Typer) -> None:
    """Adds the commands in the order of the help page (entry point of the group `aerodima.commands`)."""
    for command in (console, drive, emulate, firmware):
        app.command(rich_help_panel=CAR)(command)
