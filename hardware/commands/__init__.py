"""The commands of this package; heavy imports are inside the functions."""

from importlib import import_module

import typer

COMMAND_MODULES = ("drive_commands", "console_command", "emulate_command")
"""Modules of this package in the order of the help page; each has `register(app)`."""


def register(app: typer.Typer) -> None:
    """Adds the commands of every module in `COMMAND_MODULES` (entry point of the group
    `aerodima.commands`).
    """
    for name in COMMAND_MODULES:
        import_module(f"{__name__}.{name}").register(app)
