"""`aerodima firmware`: the Teensy's sketch with the numbers of the parameter files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def firmware(
    folder: Annotated[Path, typer.Argument(help="New folder for the sketch; its last name is the sketch's.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can.")] = "teensy_bridge",
    profile: Annotated[str, typer.Option(help="Firmware profile of the tail motors.")] = "ak70_10_v1_0_8",
    motor_ids: Annotated[tuple[int, int], typer.Option(help="Ids of the pitch and the roll motor.")] = (1, 2),
    encoder: Annotated[str, typer.Option(help="Part that reads the sail: aeat_6012 or aeat_6010.")] = "aeat_6012",
    ports: Annotated[
        Path | None, typer.Option(help="Ports file (JSON): ids, zeros and profile of the motors from there.")
    ] = None,
    scenario: Annotated[str, typer.Option(help="Scenario whose tail the limits of the motors are of.")] = "auto_turn",
    published_strings: Annotated[
        bool, typer.Option("--published-strings", help="Strings as printed in the thesis, without checksum.")
    ] = False,
) -> None:
    """Write the Teensy's sketch with a config.h made of the parameters, ready for the Arduino IDE.

    Example: aerodima firmware aerodima_teensy --ports car.json
    """
    from aerodima.hardware.car.car_ports import bare_ports, ports_from_dict, read_ports
    from aerodima.hardware.car.safety_settings import load_teensy_timing
    from aerodima.hardware.firmware.firmware_settings import FirmwareSettings, firmware_limits
    from aerodima.hardware.firmware.firmware_sketch import export_sketch, firmware_hash
    from aerodima.hardware.protocol.sail_encoder import encoder_profile
    from aerodima.hardware.protocol.teensy import StringForm
    from aerodima.workbench.config.scenario import load_scenario

    car = ports_from_dict(bare_ports(profile, motor_ids), "firmware") if ports is None else read_ports(ports)
    settings = FirmwareSettings(
        wiring,
        car.profile,
        load_teensy_timing(),
        car.motor_ids,
        encoder_profile(encoder),
        StringForm.PUBLISHED if published_strings else StringForm.CHECKED,
        firmware_limits(load_scenario(scenario), car),
    )
    sketch = export_sketch(settings, folder)
    typer.echo(f"sketch: {sketch}")
    typer.echo(f"firmware: {firmware_hash()[:12]}, {wiring}, {car.firmware_profile}")
