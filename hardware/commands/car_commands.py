"""`aerodima console`, `emulate` and `firmware`: the operator's page, the emulated car, and the Teensy's sketch."""

from __future__ import annotations

import signal
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.cli.options import ScenarioArgument, Settings

if TYPE_CHECKING:
    import socket

    from aerodima.hardware.car.car_ports import ConsoleDevice
    from aerodima.hardware.console.console import ConsoleRecord
    from aerodima.hardware.console.emulated_car import EmulatedCarProcess
    from aerodima.workbench.config.scenario import Scenario


def console(
    ports: Annotated[Path | None, typer.Option(help="Ports file (JSON) with an entry `console`.")] = None,
    emulate: Annotated[str | None, typer.Option(help="Scenario: start an emulated car and drive that.")] = None,
    radio: Annotated[str | None, typer.Option(help="Serial port of the operator's XBee module.")] = None,
    receiver: Annotated[
        int | None, typer.Option(help="64-bit serial number of the car's module; with --radio. Default: all.")
    ] = None,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 8470,
    out: Annotated[Path, typer.Option(help="Folder of the emulated car; of a later one, one in it.")] = Path(
        "console_car"
    ),
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can; with --emulate.")] = "teensy_bridge",
    view: Annotated[bool, typer.Option(help="Show the emulated car in Meshcat.")] = True,
    car_number: Annotated[
        int, typer.Option("--car", min=0, max=255, help="Number of the car (its ports file); with --radio.")
    ] = 0,
    record: Annotated[
        Path | None,
        typer.Option(help="New file (JSON lines) of the record; by default the next console.jsonl."),
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Override such as manoeuvre.speed=2; with --emulate.")
    ] = None,
) -> None:
    """Operate the car from a page on this computer: modes, sliders, gamepad, plots, emergency stop.

    Open the printed address; it works once. The page must stay visible: its heartbeat keeps the car alive.

    Example: aerodima console --emulate auto_turn --out emulated
    """
    from aerodima.workbench.errors import HardwareError

    if sum(given is not None for given in (ports, emulate, radio)) != 1:
        raise HardwareError("console: give one of --ports, --emulate and --radio")
    missing = [name for name in ("starlette", "uvicorn", "websockets", "serial") if find_spec(name) is None]
    if missing:
        raise HardwareError(f"console: {missing[0]} is missing: pip install 'aerodima-workbench[console,hardware]'")
    from aerodima.hardware.car.car_ports import ConsoleDevice
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.console.console import ConsoleRecord
    from aerodima.hardware.console.console_server import open_socket
    from aerodima.hardware.console.emulated_car import EmulatedCarProcess
    from aerodima.workbench.config.scenario import load_scenario

    chosen = wiring_name(wiring)
    words = settings or []
    scenario = load_scenario(emulate or "auto_turn", words)
    listener, recording, car = open_socket(port), ConsoleRecord(record or _next_record()), None
    if emulate is not None:
        car = EmulatedCarProcess(emulate, words, scenario.tail.mode != "none", chosen, out, view)
    with listener:
        try:
            if car is not None:
                signal.signal(signal.SIGTERM, signal.default_int_handler)  # or nobody would end the car
                car.start(typer.echo)
                ports = car.ports
            device, number = (
                _device(ports) if ports else (ConsoleDevice.model_validate(_radio(radio, receiver)), car_number)
            )
            _serve(listener, device, recording, car, scenario, number)
        finally:
            if car is not None:
                car.close()


def _next_record() -> Path:
    """console.jsonl, or console_2.jsonl and so on where that is there already."""
    names = ("console.jsonl", *(f"console_{number}.jsonl" for number in range(2, 10_000)))
    return next(path for path in map(Path, names) if not path.exists())


def _radio(radio: str | None, receiver: int | None) -> dict[str, object]:
    return {"path": radio, **({} if receiver is None else {"receiver": receiver})}


def _device(ports: Path) -> tuple[ConsoleDevice, int]:
    """The console's module and the number of the car."""
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.workbench.errors import HardwareError

    read = read_ports(ports)
    if read.console is None:
        raise HardwareError(f"{ports}: console: missing; an emulator writes it with `aerodima emulate --console`")
    return read.console, read.car


def _serve(
    listener: socket.socket,
    device: ConsoleDevice,
    recording: ConsoleRecord,
    car: EmulatedCarProcess | None,
    scenario: Scenario,
    number: int,
) -> None:
    from aerodima.hardware.console.console import Console, Limits
    from aerodima.hardware.console.console_server import run_server
    from aerodima.hardware.console.operator_radio import OperatorRadio
    from aerodima.hardware.console.page_access import Access
    from aerodima.hardware.transport.device_lock import lock_devices
    from aerodima.hardware.transport.serial_link import SerialLink

    limits = Limits(scenario.servo.limit, scenario.tail.pitch_limit, scenario.tail.roll_limit)
    with closing(lock_devices([device.path], "a console")), closing(SerialLink.open(device)) as link:
        served = Console(OperatorRadio(link, device.receiver, number), recording, limits, car)
        access = Access(listener.getsockname()[1])
        typer.echo(f"open once: {access.url}")
        run_server(listener, served, access, typer.echo)


_IN_TIME = 0.02
"""s; two ticks of the drive. What is later than that is felt by it."""


def emulate(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="New folder for the ports and the logs.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can.")] = "teensy_bridge",
    faults: Annotated[Path | None, typer.Option(help="Script (YAML) of faults and of what the operator does.")] = None,
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


def firmware(
    folder: Annotated[Path, typer.Argument(help="New folder for the sketch; its last name is the sketch's.")],
    ports: Annotated[Path, typer.Option(help="Ports file (JSON): ids, zeros and profile of the motors.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can.")] = "teensy_bridge",
    scenario: Annotated[
        str, typer.Option(help="Scenario whose tail the limits of the motors, and whose sail_encoder the bits are of.")
    ] = "auto_turn",
    settings: Settings = None,
) -> None:
    """Write the Teensy's sketch with a config.h made of the parameters, ready for the Arduino IDE.

    Example: aerodima firmware aerodima_teensy --ports car.json
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.firmware.firmware_settings import export_sketch, firmware_hash, firmware_settings
    from aerodima.workbench.config.scenario import load_scenario

    car = read_ports(ports)
    sketch = export_sketch(firmware_settings(wiring, car, load_scenario(scenario, settings or [])), folder)
    typer.echo(f"sketch: {sketch}")
    typer.echo(f"firmware: {firmware_hash()[:12]}, {wiring}, {car.firmware_profile}")
