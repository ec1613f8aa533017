"""`aerodima emulate`: the simulated car behind serial ports, for the drive command and its tests."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.options import ScenarioArgument, Settings

_IN_TIME = 0.02
"""s; two ticks of the drive. What is later than that is felt by it."""


def emulate(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="New folder for the ports and the logs.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can.")] = "teensy_bridge",
    faults: Annotated[Path | None, typer.Option(help="Script (YAML) of faults and of what the operator does.")] = None,
    profile: Annotated[str, typer.Option(help="Firmware profile of the tail motors.")] = "ak70_10_v1_0_8",
    motor_ids: Annotated[tuple[int, int], typer.Option(help="Ids of the pitch and the roll motor.")] = (1, 2),
    published_strings: Annotated[
        bool, typer.Option("--published-strings", help="Strings as printed in the thesis, without checksum.")
    ] = False,
    duration: Annotated[float | None, typer.Option(help="End by itself after that time, s.")] = None,
    console: Annotated[
        bool, typer.Option("--console", help="A port for `aerodima console`; the script's operator is silent.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the car in Meshcat.")] = False,
    parent: Annotated[
        int | None, typer.Option(help="End with the process of this id, which has started this one.")
    ] = None,
    settings: Settings = None,
) -> None:
    """Run the simulated car in real time behind pseudo-terminals: motors, Teensy, IMU, GPS and the operator's radio.

    The folder gets ports.json for `aerodima drive --ports`, ready.json once everything answers, the CAN traffic, the
    events and the truth. Ctrl-C ends it in order.

    Example: aerodima emulate turn_swing --out emulated --wiring watched_can
    """
    from aerodima.hardware.car.car_ports import PORTS_FILE
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.emulator.emulator import EmulatorSettings, run_emulator
    from aerodima.hardware.emulator.fault_script import no_faults, read_script
    from aerodima.hardware.protocol.ak70 import firmware_profile
    from aerodima.hardware.protocol.teensy import StringForm
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.errors import HardwareError

    chosen = wiring_name(wiring)
    if duration is not None and not duration > 0:
        raise HardwareError(f"--duration {duration:g} s: allowed is more than 0")
    emulated = EmulatorSettings(
        scenario=load_scenario(scenario, settings or []),
        wiring=chosen,
        folder=out,
        script=no_faults() if faults is None else read_script(faults),
        profile=firmware_profile(profile),
        motor_ids=motor_ids,
        form=StringForm.PUBLISHED if published_strings else StringForm.CHECKED,
        duration=duration,
        console=console,
        view=view,
        parent=parent,
    )
    facts = run_emulator(emulated, lambda: typer.echo(f"ports: {out / PORTS_FILE}"))
    typer.echo(f"simulated {facts['simulated_s']:.1f} s, {_delay_in_words(facts['largest_delay_s'])}")


def _delay_in_words(delay: float) -> str:
    """The largest delay, s, and what it means for whoever was driving the emulated car."""
    words = f"largest delay {1000 * delay:.1f} ms"
    if delay < _IN_TIME:
        return f"{words}: in time"
    return (
        f"{words}: this computer stood still or was too slow for that long, and the car with it (`late` in the events)"
    )
