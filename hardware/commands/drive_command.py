"""`aerodima drive`: a scenario on the real car, or on the emulated one."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.cli.options import Force, Law, LogOut, OtherCar, Settings, SwingOption

if TYPE_CHECKING:
    from aerodima.hardware.car.car_ports import CarPorts
    from aerodima.hardware.car.wiring import WiringName
    from aerodima.workbench.config.scenario import Scenario


def drive(
    scenario: Annotated[
        str,
        typer.Argument(
            help="Scenario file (YAML), the name of one that ships, or a bundle (.json) of `models export`."
        ),
    ],
    ports: Annotated[Path, typer.Option(help="Ports file (JSON): which device is where, see docs/deployment.md.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or watched_can.")] = "teensy_bridge",
    swing: SwingOption = None,
    other_car: OtherCar = False,
    law: Law = None,
    log: LogOut = Path("drive.parquet"),
    traffic: Annotated[
        Path | None, typer.Option(help="Every frame on the CAN bus into this BLF file (watched_can).")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Never arm: checks, then the sequence switched off.")
    ] = False,
    no_drake: Annotated[bool, typer.Option("--no-drake", help="Plain loop, for computers without Drake.")] = False,
    watchdog_test: Annotated[
        bool, typer.Option("--watchdog-test", help="Cut the link, see the motors off, record it.")
    ] = False,
    motor_test: Annotated[
        str | None, typer.Option(help="Move tail_pitch or tail_roll by 5 degrees and back, judge it, and end.")
    ] = None,
    zero: Annotated[
        bool, typer.Option("--zero", help="Tail held upright by hand: write its angles as zeros into the ports file.")
    ] = False,
    arm: Annotated[bool, typer.Option("--arm", help="Arm without asking on the terminal.")] = False,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """Drive a scenario on the car: check, arm, run the sequence (AUTO) or obey the radio (MANUAL), disarm, write a log.

    The operator's radio chooses AUTO or MANUAL and must stay alive. Ctrl-C switches the motors off at once.

    Example: aerodima drive auto_turn --ports car.json --log run.parquet
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.hardware.drive.drive_session import DriveOptions, run_drive
    from aerodima.hardware.drive.held_car import connect
    from aerodima.workbench.atomic_write import make_folder, refuse_existing
    from aerodima.workbench.controllers.law_of_scenario import load_drive, load_law
    from aerodima.workbench.errors import HardwareError, LogError

    name = wiring_name(wiring)
    overrides = [*([f"controller.swing_file={swing}"] if swing else []), *(settings or [])]
    if law is not None and swing is not None:
        raise HardwareError("--law: allowed without --swing; each says what the tail does")
    chosen, tail_law = load_drive(scenario, overrides)
    if law is not None:
        tail_law = load_law(law)
    elif not other_car:
        from aerodima.workbench.controllers.law_of_scenario import refuse_other_car

        refuse_other_car(chosen)
    car_ports = read_ports(ports)
    if traffic is not None and name == "teensy_bridge":
        raise HardwareError(f"--traffic {traffic}: the frames are on the Teensy's bus; allowed with watched_can")
    if zero:
        _set_zero(ports, car_ports, name, arm)
        return
    if motor_test is not None:
        _motor_test(chosen, car_ports, name, motor_test, arm)
        return
    if watchdog_test:
        _watchdog_test(chosen, car_ports, name, arm)
        return
    refuse_existing(log, force, LogError)
    make_folder(log.parent, LogError)
    law_name = "" if law is None else type(tail_law).__name__
    options = DriveOptions(log, force, dry_run, not no_drake, None if arm else _confirm, law_name=law_name)
    car = connect(car_ports, chosen, name, traffic)
    result = run_drive(car, chosen, car_ports, options, typer.echo, law=tail_law)
    if result.log is not None:
        typer.echo(f"log: {result.log}")
    typer.echo(f"ended: {result.reason}", err=not result.orderly)
    if result.traffic_error:
        typer.echo(f"error: {traffic}: {result.traffic_error}", err=True)
    if result.signal:
        raise typer.Exit(128 + result.signal)
    if not result.orderly:
        raise HardwareError(f"the car was stopped: {result.reason}")
    if result.traffic_error:
        raise typer.Exit(2)


def _motor_test(scenario: Scenario, ports: CarPorts, wiring: WiringName, joint: str, arm: bool) -> None:
    from aerodima.hardware.car.car_ports import JOINTS
    from aerodima.hardware.drive.held_car import connect, run_motor_test
    from aerodima.workbench.errors import HardwareError

    chosen = next((name for name in JOINTS if name == joint), None)
    if chosen is None or scenario.tail.mode == "none":
        raise HardwareError(f"--motor-test {joint}: allowed: {', '.join(JOINTS)}, with a scenario that has a tail")
    _ask_to_arm(arm)
    car = connect(ports, scenario, wiring)
    found = run_motor_test(car, chosen, typer.echo, _eyes(ports, wiring)[0])
    warm = "not reported" if found.temperature is None else f"{found.temperature:g} degC"
    torque = f"torque {found.torque:+.2f} N m where {found.wanted:+.2f} is asked for"
    typer.echo(f"{chosen}: well: moved by {math.degrees(found.moved):+.1f} degrees, {torque}, temperature {warm}")


def _set_zero(path: Path, ports: CarPorts, wiring: WiringName, arm: bool) -> None:
    from aerodima.hardware.drive.held_car import joint_angles, read_motor_angles, write_zeros
    from aerodima.workbench.errors import HardwareError

    question = "hold the tail exactly upright, it is let go; type zero to read its angles"
    if not arm and _typed(question) != "zero":
        raise HardwareError("zero: nobody said that the tail is held upright; nothing was written")
    angles = read_motor_angles(ports, wiring)
    for joint, angle in joint_angles(ports, angles).items():
        typer.echo(f"{joint}: {math.degrees(angle):+.1f} degrees by the zero of before")
    write_zeros(path, angles)
    typer.echo(f"zeros: {', '.join(f'{joint} {angle:.4f} rad' for joint, angle in angles.items())} in {path}")
    if wiring == "teensy_bridge":
        typer.echo(f"the firmware limits motor angles: write it anew with `aerodima firmware FOLDER --ports {path}`")


def _watchdog_test(scenario: Scenario, ports: CarPorts, wiring: WiringName, arm: bool) -> None:
    from aerodima.hardware.drive.held_car import run_watchdog_test

    typer.echo("the motors are switched on and hold the tail where it is")
    confirm, seen_by = _eyes(ports, wiring)
    _ask_to_arm(arm or seen_by == "emulator")
    record, path = run_watchdog_test(scenario, ports, wiring, confirm, seen_by)
    typer.echo(f"{record.cut}: exit frames after {record.time_to_exit * 1000:.0f} ms")
    typer.echo(f"record: {path}")


def _eyes(ports: CarPorts, wiring: WiringName) -> tuple[Callable[[str], bool], str]:
    """Who answers what is seen of the tail: the operator, or nobody where there is nothing to be seen."""
    from aerodima.hardware.drive.watchdog_test import is_emulated

    return ((lambda _: True), "emulator") if is_emulated(wiring, ports) else (typer.confirm, "operator")


def _ask_to_arm(arm: bool) -> None:
    from aerodima.workbench.errors import HardwareError

    if not arm and not _confirm():
        raise HardwareError("not armed: nobody said that the motors may be switched on")


def _confirm() -> bool:
    return _typed("keep clear of the tail; type arm to switch the motors on") == "arm"


def _typed(question: str) -> str:
    try:
        return str(typer.prompt(question, default="", show_default=False))
    except typer.Abort:  # nobody is there to answer
        return ""
