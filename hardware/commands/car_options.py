"""Options that the commands of the car share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli import options as cli

Ports = Annotated[
    Path,
    typer.Option(help="Ports file (JSON): which device is where, ids and zeros of the motors."),
]
Wiring = Annotated[str, cli.chosen("How the motors are wired.", "teensy_bridge", "watched_can")]
Arm = Annotated[bool, typer.Option("--arm", help="Arm without asking on the terminal.")]


@dataclass(frozen=True)
class CarOptions:
    """Options of a car: its devices, its wiring, changes of its scenario."""

    ports: Ports
    wiring: Wiring = "teensy_bridge"
    settings: cli.Settings = None
