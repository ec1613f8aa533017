"""`aerodima console`: the operator's page."""

from __future__ import annotations

import signal
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from socket import socket
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import workbench
from aerodima.hardware.commands.car_options import Wiring
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.extras import require
from aerodima.workbench.core.terminal import say

if TYPE_CHECKING:
    from aerodima.hardware.car.car_ports import ConsoleDevice
    from aerodima.hardware.console.console import ConsoleRecord
    from aerodima.hardware.console.emulated_car import EmulatedCarProcess
    from aerodima.workbench.scenario.scenario import Scenario


def register(app: typer.Typer) -> None:
    """Adds the command `console`."""
    app.command(rich_help_panel=cli.CAR)(console)


@dataclass(frozen=True)
class ConsoleOptions:
    """Options of the console: its car, its page, its record."""

    ports: Annotated[
        Path | None, typer.Option(help="Ports file (JSON) with an entry `console`.")
    ] = None
    radio: Annotated[
        str | None,
        typer.Option(help="Serial port of the operator's XBee module; more of it in a ports file."),
    ] = None
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 8470
    out: Annotated[Path, cli.written("Folder of the emulated car; of a later one, one in it.")] = (
        Path("console_car")
    )
    wiring: Wiring = "teensy_bridge"
    view: Annotated[bool, typer.Option(help="Show the emulated car in Meshcat.")] = True
    record: Annotated[
        Path | None,
        typer.Option(
            help="New file (JSON lines) of the record; by default the next console.jsonl."
        ),
    ] = None
    settings: cli.Settings = None


@cli.grouped
def console(scenario: cli.OtherScenario = None, *, options: ConsoleOptions) -> None:
    """Operate the car from a page: modes, sliders, gamepad, plots.

    With a scenario an emulated car is started, and driven. Open the printed address; it works once.
    The page must stay visible: its heartbeat keeps the car alive.

    Example: aerodima console auto_turn --out emulated
    """
    if sum(given is not None for given in (scenario, options.ports, options.radio)) != 1:
        raise HardwareError("console: give one of SCENARIO, --ports and --radio")
    modules = ("starlette", "uvicorn", "websockets", "serial")
    require("console,hardware", "console", *modules, error=HardwareError)
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.console.console import ConsoleRecord
    from aerodima.hardware.console.console_server import open_socket
    from aerodima.hardware.console.emulated_car import EmulatedCarProcess

    wiring = wiring_name(options.wiring)
    settings = options.settings or []
    loaded = workbench.load_scenario(scenario or "auto_turn", settings)
    listener = open_socket(options.port)
    record = ConsoleRecord(options.record or _next_record())
    car = None
    if scenario is not None:
        has_tail = loaded.has_tail
        car = EmulatedCarProcess(scenario, settings, has_tail, wiring, options.out, options.view)
    with listener:
        try:
            if car is not None:
                # Otherwise nobody would end the car.
                signal.signal(signal.SIGTERM, signal.default_int_handler)
                car.start(say)
            _serve(listener, loaded, options, record, car)
        finally:
            if car is not None:
                car.close()


def _serve(
    listener: socket,
    scenario: Scenario,
    options: ConsoleOptions,
    record: ConsoleRecord,
    car: EmulatedCarProcess | None,
) -> None:
    """Serves the page on the open socket until it is interrupted."""
    from aerodima.hardware.console.console import Console
    from aerodima.hardware.console.console_server import run_server
    from aerodima.hardware.console.operator_radio import OperatorRadio
    from aerodima.hardware.console.page_access import Access
    from aerodima.hardware.transport.device_lock import lock_devices
    from aerodima.hardware.transport.serial_link import SerialLink

    device, number = _radio_device(options if car is None else replace(options, ports=car.ports))
    limits = {
        "steering": scenario.servo.limit,
        "pitch": scenario.tail.pitch_limit,
        "roll": scenario.tail.roll_limit,
    }
    with lock_devices([device.path], "a console"), closing(SerialLink.open(device)) as link:
        served = Console(OperatorRadio(link, device.receiver, number), record, limits, car)
        access = Access(listener.getsockname()[1])
        say(f"open once: {access.url}")
        run_server(listener, served, access, say)


def _next_record() -> Path:
    """Returns console.jsonl, or console_2.jsonl and so on where that exists."""
    names = ("console.jsonl", *(f"console_{number}.jsonl" for number in range(2, 10_000)))
    return next(path for path in map(Path, names) if not path.exists())


def _radio_device(options: ConsoleOptions) -> tuple[ConsoleDevice, int]:
    """Returns the operator's radio module and the number of its car."""
    from aerodima.hardware.car.car_ports import ConsoleDevice, read_operator_ports

    if options.ports is None:
        return ConsoleDevice.model_validate({"path": options.radio}), 0
    ports = read_operator_ports(options.ports)
    if ports.console is None:
        raise HardwareError(
            f"{options.ports}: console: missing; an emulator writes it: `aerodima emulate "
            "auto_turn --out emulated --console`"
        )
    return ports.console, ports.car
