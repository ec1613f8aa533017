"""`aerodima console`: the operator's page."""

from __future__ import annotations

import signal
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
        served = Console(OperatorRadio(link, device.receiver, device.escaped, number), recording, limits, car)
        access = Access(listener.getsockname()[1])
        typer.echo(f"open once: {access.url}")
        run_server(listener, served, access, typer.echo)
