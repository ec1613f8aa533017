"""`aerodima emulate`: the emulated car behind serial ports."""

from pathlib import Path
from typing import Annotated

import typer

from aerodima import workbench
from aerodima.hardware.commands.car_options import Wiring
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.terminal import say


def register(app: typer.Typer) -> None:
    """Adds the command `emulate`."""
    app.command(rich_help_panel=cli.CAR)(emulate)


def emulate(
    scenario: cli.ScenarioArgument,
    out: Annotated[Path, cli.written("New folder for the ports and the logs.")],
    wiring: Wiring = "teensy_bridge",
    faults: Annotated[
        Path | None, typer.Option(help="Script (YAML) of faults and of what the operator does.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="End by itself after that time, s.")
    ] = None,
    console: Annotated[
        bool,
        typer.Option(
            "--console", help="A port for `aerodima console`; the script's operator is silent."
        ),
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Show the car in Meshcat.")] = False,
    parent: Annotated[
        int | None,
        typer.Option(help="End with the process of this id, which has started this one."),
    ] = None,
    settings: cli.Settings = None,
) -> None:
    """Run an emulated car in real time behind serial ports.

    Motors, Teensy, IMU, GPS and the operator's radio are behind pseudo-terminals. The folder gets
    ports.json for `aerodima drive run --ports`, ready.json once everything answers, the CAN
    traffic, the events and the truth. Ctrl-C ends it in order.

    Example: aerodima emulate auto_turn --out emulated --wiring watched_can
    """
    from aerodima.hardware.car.car_ports import PORTS_FILE
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.emulator.emulator import EmulatorSettings, run_emulator
    from aerodima.hardware.emulator.fault_script import Script, read_script

    chosen = wiring_name(wiring)
    if duration is not None and not duration > 0:
        raise HardwareError(f"--duration {duration:g} s: allowed is more than 0")
    emulated = EmulatorSettings(
        scenario=workbench.load_scenario(scenario, settings or []),
        wiring=chosen,
        folder=out,
        script=Script.model_validate({}) if faults is None else read_script(faults),
        duration=duration,
        console=console,
        view=view,
        parent=parent,
    )
    facts = run_emulator(emulated, lambda: say(f"ports: {out / PORTS_FILE}"))
    delay = 1000.0 * facts["largest_delay_s"]
    say(f"simulated {facts['simulated_s']:.1f} s, largest delay {delay:.1f} ms")
