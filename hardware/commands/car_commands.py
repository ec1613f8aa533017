"""`aerodima drive`, `console` and `emulate`: the car, its operator's page, the emulated car."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import hardware, workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import make_folder, refuse_existing
from aerodima.workbench.core.errors import HardwareError, LogError

if TYPE_CHECKING:
    from aerodima.hardware.car.car_ports import CarPorts, ConsoleDevice
    from aerodima.hardware.car.wiring import WiringName
    from aerodima.workbench.scenario.scenario import Scenario
Ports = Annotated[
    Path,
    typer.Option(help="Ports file (JSON): which device is where, ids and zeros of the motors."),
]


def _wirings() -> list[str]:
    from aerodima.hardware.car.wiring import WIRINGS

    return list(WIRINGS)


Wiring = Annotated[
    str,
    typer.Option(
        metavar="teensy_bridge|watched_can",
        help="How the motors are wired.",
        autocompletion=_wirings,
    ),
]


def console(
    scenario: cli.OtherScenario = None,
    ports: Annotated[
        Path | None, typer.Option(help="Ports file (JSON) with an entry `console`.")
    ] = None,
    radio: Annotated[
        str | None,
        typer.Option(help="Serial port of the operator's XBee module; more of it in a ports file."),
    ] = None,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 8470,
    out: Annotated[
        Path, cli.written("Folder of the emulated car; of a later one, one in it.")
    ] = Path("console_car"),
    wiring: Wiring = "teensy_bridge",
    view: Annotated[bool, typer.Option(help="Show the emulated car in Meshcat.")] = True,
    record: Annotated[
        Path | None,
        typer.Option(
            help="New file (JSON lines) of the record; by default the next console.jsonl."
        ),
    ] = None,
    settings: cli.Settings = None,
) -> None:
    """Operate the car from a page: modes, sliders, gamepad, plots.

    With a scenario an emulated car is started, and driven. Open the printed address; it works once.
    The page must stay visible: its heartbeat keeps the car alive.

    Example: aerodima console auto_turn --out emulated
    """
    if sum(given is not None for given in (scenario, ports, radio)) != 1:
        raise HardwareError("console: give one of SCENARIO, --ports and --radio")
    missing = [
        name for name in ("starlette", "uvicorn", "websockets", "serial") if find_spec(name) is None
    ]
    if missing:
        raise HardwareError(
            f"console: {missing[0]} is missing: pip install 'aerodima-workbench[console,hardware]'"
        )
    from aerodima.hardware.car.car_ports import ConsoleDevice
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.console.console import Console, ConsoleRecord, Limits
    from aerodima.hardware.console.console_server import open_socket, run_server
    from aerodima.hardware.console.emulated_car import EmulatedCarProcess
    from aerodima.hardware.console.operator_radio import OperatorRadio
    from aerodima.hardware.console.page_access import Access
    from aerodima.hardware.transport.device_lock import lock_devices
    from aerodima.hardware.transport.serial_link import SerialLink

    chosen = wiring_name(wiring)
    words = settings or []
    loaded = workbench.load_scenario(scenario or "auto_turn", words)
    limits = Limits(loaded.servo.limit, loaded.tail.pitch_limit, loaded.tail.roll_limit)
    listener = open_socket(port)
    recording = ConsoleRecord(record or _next_record())
    car = None
    if scenario is not None:
        car = EmulatedCarProcess(scenario, words, loaded.tail.mode != "none", chosen, out, view)
    with listener:
        try:
            if car is not None:
                # Otherwise nobody would end the car.
                signal.signal(signal.SIGTERM, signal.default_int_handler)
                car.start(typer.echo)
                ports = car.ports
            if ports:
                device, number = _device(ports)
            else:
                device, number = (ConsoleDevice.model_validate({"path": radio}), 0)
            with lock_devices([device.path], "a console"), closing(SerialLink.open(device)) as link:
                served = Console(
                    OperatorRadio(link, device.receiver, number), recording, limits, car
                )
                access = Access(listener.getsockname()[1])
                typer.echo(f"open once: {access.url}")
                run_server(listener, served, access, typer.echo)
        finally:
            if car is not None:
                car.close()


def _next_record() -> Path:
    """console.jsonl, or console_2.jsonl and so on where that is there already."""
    names = ("console.jsonl", *(f"console_{number}.jsonl" for number in range(2, 10_000)))
    return next(path for path in map(Path, names) if not path.exists())


def _device(ports: Path) -> tuple[ConsoleDevice, int]:
    """The console's module and the number of the car."""
    from aerodima.hardware.car.car_ports import read_ports

    read = read_ports(ports)
    if read.console is None:
        raise HardwareError(
            f"{ports}: console: missing; an emulator writes it with `aerodima emulate --console`"
        )
    return read.console, read.car


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
    ports.json for `aerodima drive --ports`, ready.json once everything answers, the CAN traffic,
    the events and the truth. Ctrl-C ends it in order.

    Example: aerodima emulate turn_swing --out emulated --wiring watched_can
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
    facts = run_emulator(emulated, lambda: typer.echo(f"ports: {out / PORTS_FILE}"))
    delay = 1000.0 * facts["largest_delay_s"]
    typer.echo(f"simulated {facts['simulated_s']:.1f} s, largest delay {delay:.1f} ms")


def drive(
    scenario: Annotated[str, cli.named("Scenario, or its bundle (JSON)", "scenarios")],
    ports: Ports,
    wiring: Wiring = "teensy_bridge",
    swing: cli.SwingOption = None,
    other_car: cli.OtherCar = False,
    law: cli.Law = None,
    diagram: cli.Build = None,
    out: cli.LogOut = Path("drive.parquet"),
    traffic: Annotated[
        Path | None,
        typer.Option(
            help="Every frame on the CAN bus into this file (.blf).", callback=cli.endings(".blf")
        ),
    ] = None,
    firmware: Annotated[
        Path | None,
        typer.Option(help="Write the Teensy's sketch for this car into this new folder, and end."),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Never arm: checks, then the sequence switched off.")
    ] = False,
    no_drake: Annotated[
        bool, typer.Option("--no-drake", help="Plain loop, for computers without Drake.")
    ] = False,
    watchdog_test: Annotated[
        bool, typer.Option("--watchdog-test", help="Cut the link, see the motors off, record it.")
    ] = False,
    motor_test: Annotated[
        str | None,
        cli.chosen(
            "Move a joint by 5 degrees and back, judge it, and end.", "tail_pitch", "tail_roll"
        ),
    ] = None,
    zero: Annotated[
        bool,
        typer.Option(
            "--zero",
            help="Tail held upright by hand: write its angles as zeros into the ports file.",
        ),
    ] = False,
    arm: Annotated[bool, typer.Option("--arm", help="Arm without asking on the terminal.")] = False,
    settings: cli.Settings = None,
    force: cli.Force = False,
) -> None:
    """Drive a scenario on the real or the emulated car.

    Check, arm, run the sequence (AUTO) or obey the radio (MANUAL), disarm, write a log. The
    operator's radio chooses AUTO or MANUAL and must stay alive. Ctrl-C switches the motors off at
    once.

    Example: aerodima drive auto_turn --ports car.json --out run.parquet
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.driving.drive_session import DriveOptions, run_drive
    from aerodima.workbench.control.controller_bundle import load_drive
    from aerodima.workbench.control.user_law import load_build, load_law

    name = wiring_name(wiring)
    overrides = [*([f"controller.swing_file={swing}"] if swing else []), *(settings or [])]
    if law is not None and swing is not None:
        raise HardwareError("--law: allowed without --swing; each says what the tail does")
    if diagram is not None and (law is not None or swing is not None or no_drake):
        raise HardwareError(
            "--diagram: allowed without --law, --swing and --no-drake; it says what the tail does"
        )
    chosen, tail_law = load_drive(scenario, overrides)
    if diagram is None:
        build = None
    else:
        build = load_build(diagram)
    if law is not None:
        tail_law = load_law(law, chosen)
    elif not other_car and build is None:
        from aerodima.workbench.control.swing_library import refuse_other_car

        refuse_other_car(chosen)
    car_ports = read_ports(ports)
    if traffic is not None and name == "teensy_bridge":
        raise HardwareError(
            f"--traffic {traffic}: the frames are on the Teensy's bus; allowed with watched_can"
        )
    if firmware is not None:
        _write_sketch(chosen, car_ports, name, firmware)
        return
    if zero:
        _set_zero(scenario, ports, car_ports, name, arm)
        return
    if motor_test is not None:
        _motor_test(chosen, car_ports, name, motor_test, arm)
        return
    if watchdog_test:
        _watchdog_test(chosen, car_ports, name, arm)
        return
    refuse_existing(out, force, LogError)
    make_folder(out.parent, LogError)
    if law is None:
        law_name = ""
    else:
        law_name = type(tail_law).__name__
    options = DriveOptions(
        out, force, dry_run, not no_drake, None if arm else _confirm, law_name=law_name
    )
    car = hardware.connect(car_ports, chosen, name, traffic)
    result = run_drive(car, chosen, car_ports, options, typer.echo, law=tail_law, build=build)
    if result.log is not None:
        typer.echo(f"log: {result.log}")
    typer.echo(f"ended: {result.reason}", err=not result.orderly)
    if result.traffic_error:
        typer.echo(f"error: {traffic}: {result.traffic_error}", err=True)
    if result.signal:
        raise typer.Exit(128 + result.signal)
    if not result.orderly:
        typer.echo(f"error: the car was stopped: {result.reason}", err=True)
        raise typer.Exit(cli.Status.NO)
    if result.traffic_error or result.log not in (None, out):
        raise typer.Exit(cli.Status.LEFT_OUT)


def _write_sketch(scenario: Scenario, ports: CarPorts, wiring: WiringName, folder: Path) -> None:
    from aerodima.hardware.firmware.teensy_firmware import (
        export_sketch,
        firmware_hash,
        firmware_settings,
    )

    typer.echo(f"sketch: {export_sketch(firmware_settings(wiring, ports, scenario), folder)}")
    typer.echo(f"firmware: {firmware_hash()[:12]}, {wiring}, {ports.firmware_profile}")


def _motor_test(
    scenario: Scenario, ports: CarPorts, wiring: WiringName, joint: str, arm: bool
) -> None:
    from aerodima.hardware.car.car_ports import JOINTS
    from aerodima.hardware.driving.held_car import run_motor_test

    chosen = next((name for name in JOINTS if name == joint), None)
    if chosen is None or scenario.tail.mode == "none":
        raise HardwareError(
            f"--motor-test {joint}: allowed: {', '.join(JOINTS)}, with a scenario that has a tail"
        )
    _ask_to_arm(arm)
    car = hardware.connect(ports, scenario, wiring)
    found = run_motor_test(car, chosen, typer.echo, _eyes(ports, wiring)[0])
    if found.temperature is None:
        warm = "not reported"
    else:
        warm = f"{found.temperature:g} degC"
    torque = f"torque {found.torque:+.2f} N m where {found.wanted:+.2f} is asked for"
    typer.echo(
        f"{chosen}: well: moved by {math.degrees(found.moved):+.1f} degrees, {torque}, "
        f"temperature {warm}"
    )


def _set_zero(scenario: str, path: Path, ports: CarPorts, wiring: WiringName, arm: bool) -> None:
    from aerodima.hardware.driving.held_car import joint_angles, read_motor_angles, write_zeros

    question = "hold the tail exactly upright, it is let go; type zero to read its angles"
    if not arm and _typed(question) != "zero":
        raise HardwareError("zero: nobody said that the tail is held upright; nothing was written")
    angles = read_motor_angles(ports, wiring)
    for joint, angle in joint_angles(ports, angles).items():
        typer.echo(f"{joint}: {math.degrees(angle):+.1f} degrees by the zero of before")
    write_zeros(path, angles)
    typer.echo(
        f"zeros: {', '.join(f'{joint} {angle:.4f} rad' for joint, angle in angles.items())} in "
        f"{path}"
    )
    if wiring == "teensy_bridge":
        again = f"aerodima drive {scenario} --ports {path} --firmware FOLDER"
        typer.echo(f"the firmware limits motor angles: write it anew with `{again}`")


def _watchdog_test(scenario: Scenario, ports: CarPorts, wiring: WiringName, arm: bool) -> None:
    from aerodima.hardware.driving.held_car import run_watchdog_test

    typer.echo("once you have typed arm, the motors hold the tail where it is")
    confirm, seen_by = _eyes(ports, wiring)
    _ask_to_arm(arm or seen_by == "emulator")
    record, path = run_watchdog_test(scenario, ports, wiring, confirm, seen_by)
    typer.echo(f"{record.cut}: exit frames after {record.time_to_exit * 1000:.0f} ms")
    typer.echo(f"record: {path}")


def _eyes(ports: CarPorts, wiring: WiringName) -> tuple[Callable[[str], bool], str]:
    """Who answers what is seen of the tail: the operator, or nobody where nothing is to be seen."""
    from aerodima.hardware.driving.watchdog_test import is_emulated

    if is_emulated(wiring, ports):
        return ((lambda _: True), "emulator")
    return (typer.confirm, "operator")


def _ask_to_arm(arm: bool) -> None:

    if not arm and not _confirm():
        raise HardwareError("not armed: nobody said that the motors may be switched on")


def _confirm() -> bool:
    return _typed("keep clear of the tail; type arm to switch the motors on") == "arm"


def _typed(question: str) -> str:
    try:
        return str(typer.prompt(question, default="", show_default=False))
    except typer.Abort:  # nobody is there to answer
        return ""
