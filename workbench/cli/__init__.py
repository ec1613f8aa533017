"""The program `aerodima` and the workbench's commands; heavy imports are inside the functions."""

from importlib import import_module

import typer

COMMAND_MODULES: tuple[str, ...] = (
    "run_commands",
    "replay_commands",
    "log_commands",
    "model_commands",
    "rig_commands",
    "doctor_commands",
)
"""Modules of this package in the order of the help page; each has `register(app)`."""


def register(app: typer.Typer) -> None:
    """Add the commands of every module in `COMMAND_MODULES` (entry point of the group
    `aerodima.commands`).
    """
    for name in COMMAND_MODULES:
        import_module(f"{__name__}.{name}").register(app)
