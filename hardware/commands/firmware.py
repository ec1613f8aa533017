"""`aerodima firmware`: the Arduino sketch of the Teensy with its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workbench.help_sections import CAR


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=CAR)(firmware)


def firmware(
    folder: Annotated[Path, typer.Argument(help="New folder for the sketch; its last name is the sketch's.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or direct_can.")] = "teensy_bridge",
    profile: Annotated[str, typer.Option(help="Firmware profile of the tail motors.")] = "ak70_10_v1_0_8",
    motor_ids: Annotated[tuple[int, int], typer.Option(help="Ids of the pitch and the roll motor.")] = (1, 2),
    encoder: Annotated[str, typer.Option(help="Part that reads the sail: aeat_6012 or aeat_6010.")] = "aeat_6012",
    published_strings: Annotated[
        bool, typer.Option("--published-strings", help="Strings as printed in the thesis, without checksum.")
    ] = False,
) -> None:
    """Write the Teensy's sketch with a config.h made of the parameters, ready for the Arduino IDE.

    Example: aerodima firmware aerodima_teensy --wiring direct_can
    """
    from hardware.firmware.build import firmware_hash
    from hardware.firmware.export import export_sketch
    from hardware.firmware.settings import FirmwareSettings, load_teensy_timing
    from hardware.protocol.ak70_profiles import firmware_profile
    from hardware.protocol.sail_encoder import encoder_profile
    from hardware.protocol.teensy import StringForm

    settings = FirmwareSettings(
        wiring,
        firmware_profile(profile),
        load_teensy_timing(),
        motor_ids,
        encoder_profile(encoder),
        StringForm.PUBLISHED if published_strings else StringForm.CHECKED,
    )
    sketch = export_sketch(settings, folder)
    typer.echo(f"sketch: {sketch}")
    typer.echo(f"firmware: {firmware_hash()[:12]}, {wiring}, {profile}")
