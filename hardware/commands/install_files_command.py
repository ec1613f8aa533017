"""`aerodima install-files`: udev rules, limits and service of the car's computer, to be installed by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.options import CAR


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command("install-files", rich_help_panel=CAR)(install_files)


def install_files(
    folder: Annotated[Path, typer.Argument(help="Folder for the files.")],
    ports: Annotated[Path, typer.Option(help="Ports file (JSON) of the car.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge, watched_can or direct_can.")] = "teensy_bridge",
    scenario: Annotated[str, typer.Option(help="What the service drives.")] = "auto_turn",
    user: Annotated[str, typer.Option(help="Who drives; the present user when not given.")] = "",
) -> None:
    """Write fixed device names (udev), real-time limits and a systemd service; says how to install them.

    Nothing is installed. The service's kill mode spares the watchdog.

    Example: aerodima install-files system --ports car.json
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.commands.system_files import write_system_files

    name = wiring_name(wiring)
    for file in write_system_files(folder, read_ports(ports), ports, name, scenario, user):
        typer.echo(f"sudo install -m 644 {folder / file.name} {file.place}/")
    typer.echo("sudo udevadm control --reload && sudo udevadm trigger && sudo systemctl daemon-reload")
