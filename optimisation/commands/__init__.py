"""The commands of this package: one module each, heavy imports inside the functions."""

from __future__ import annotations

from importlib import import_module

import typer

COMMAND_MODULES: tuple[str, ...] = (
    "fit_command",
    "optimise_command",
    "coverage_command",
    "feedback_command",
    "verify_command",
    "sweep_command",
    "threshold_command",
    "leaderboard_command",
    "passivity_command",
    "calibrate_command",
    "report_command",
)
"""Modules of this package in the order of the help page; each has `register(app)`."""


def register(app: typer.Typer) -> None:
    """Add the commands of every module in `COMMAND_MODULES` (entry point of the group `aerodima.commands`)."""
    for name in COMMAND_MODULES:
        import_module(f"{__name__}.{name}").register(app)
