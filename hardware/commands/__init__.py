"""The commands of this package, heavy imports inside the functions."""

from __future__ import annotations

from importlib import import_module

import typer

from aerodima.workbench.cli.options import CAR

COMMANDS = {
    "console": "car_commands",
    "drive": "drive_command",
    "emulate": "car_commands",
    "firmware": "car_commands",
}
"""Command and the module of this package that has it as a function, in the order of the help page."""


def register(app: typer.Typer) -> None:
    """Adds all of `COMMANDS` (entry point of the group `aerodima.commands`)."""
    for name, module in COMMANDS.items():
        function = getattr(import_module(f"{__name__}.{module}"), name)
        app.command(name, rich_help_panel=CAR)(function)
