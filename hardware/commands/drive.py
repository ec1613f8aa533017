"""`aerodima drive`: a scenario on the real car, or on the emulated one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from workbench.help_sections import CAR

if TYPE_CHECKING:
    from hardware.wiring.base import WiringName
    from hardware.wiring.car_ports import CarPorts
    from hardware.wiring.wired_car import WiredCar
    from workbench.scenario import Scenario


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=CAR)(drive)


def drive(
    scenario: Annotated[
        str, typer.Argument(help="Scenario file (YAML), the name of one that ships, or a bundle (.json) of `export`.")
    ],
    ports: Annotated[Path, typer.Option(help="Ports file (JSON): which device is where, see docs/deployment.md.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge or direct_can.")] = "teensy_bridge",
    swing: Annotated[str | None, typer.Option(help="Swing file (YAML) to play, or the name of one that ships.")] = None,
    other_car: Annotated[bool, typer.Option("--other-car", help="Play a swing that was made for another car.")] = False,
    law: Annotated[str | None, typer.Option(help="Tail law of your own, such as my_law.py:MyLaw.")] = None,
    log: Annotated[Path, typer.Option(help="Run log (Parquet) to write.")] = Path("drive.parquet"),
    traffic: Annotated[
        Path | None, typer.Option(help="Every frame on the CAN bus into this BLF file (direct_can).")
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Never arm: checks, then the sequence switched off.")
    ] = False,
    no_drake: Annotated[bool, typer.Option("--no-drake", help="Plain loop, for computers without Drake.")] = False,
    watchdog_test: Annotated[
        bool, typer.Option("--watchdog-test", help="Cut the link, see the motors off, record it.")
    ] = False,
    arm: Annotated[bool, typer.Option("--arm", help="Arm without asking on the terminal.")] = False,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="Override such as manoeuvre.speed=3; may be repeated.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing log.")] = False,
) -> None:
    """Drive a scenario on the car: check, arm, run the sequence (AUTO) or obey the radio (MANUAL), disarm, write a log.

    The operator's radio chooses AUTO or MANUAL and must stay alive. Ctrl-C switches the motors off at once.

    Example: aerodima drive auto_turn --ports car.json --wiring direct_can --log run.parquet
    """
    from hardware.drive.session import DriveOptions, run_drive
    from hardware.wiring.car_ports import read_ports
    from workbench.atomic_write import make_folder, refuse_existing
    from workbench.bundle import load_drive
    from workbench.controllers.law_file import load_law
    from workbench.errors import HardwareError, LogError

    name = _wiring_name(wiring)
    overrides = [*([f"controller.swing_file={swing}"] if swing else []), *(settings or [])]
    if law is not None and swing is not None:
        raise HardwareError("--law: allowed without --swing; each says what the tail does")
    chosen, tail_law = load_drive(scenario, overrides)
    if law is not None:
        tail_law = load_law(law)
    elif not other_car:
        from workbench.controllers.law_of_scenario import refuse_other_car

        refuse_other_car(chosen)
    car_ports = read_ports(ports)
    if traffic is not None and name != "direct_can":
        raise HardwareError(f"--traffic {traffic}: the frames are on the Teensy's bus; allowed with direct_can")
    if watchdog_test:
        _watchdog_test(chosen, car_ports, name, arm)
        return
    refuse_existing(log, force, LogError)
    make_folder(log.parent, LogError)
    law_name = "" if law is None else type(tail_law).__name__
    options = DriveOptions(log, force, dry_run, not no_drake, None if arm else _confirm, tail_law=law_name)
    result = run_drive(_car(chosen, car_ports, name, traffic), chosen, tail_law, car_ports, options, typer.echo)
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


def _wiring_name(wiring: str) -> WiringName:
    from hardware.wiring.base import WIRINGS
    from workbench.errors import HardwareError

    for name in WIRINGS:
        if name == wiring:
            return name
    raise HardwareError(f"--wiring {wiring}: allowed: {', '.join(WIRINGS)}")


def _car(scenario: Scenario, ports: CarPorts, wiring: WiringName, traffic: Path | None) -> WiredCar:
    from hardware.watchdog.process import WatchdogProcess
    from hardware.watchdog.record import require_watchdog_test
    from hardware.wiring.direct_can import direct_can
    from hardware.wiring.teensy_bridge import teensy_bridge

    def authorise() -> None:
        require_watchdog_test(wiring, ports)

    if wiring == "teensy_bridge":
        return teensy_bridge(scenario, ports, authorise)
    return direct_can(scenario, ports, authorise, lambda can: WatchdogProcess(can, ports.motor_ids), traffic)


def _watchdog_test(scenario: Scenario, ports: CarPorts, wiring: WiringName, arm: bool) -> None:
    from hardware.watchdog.record import is_emulated
    from hardware.watchdog.trial import run_watchdog_test
    from workbench.errors import HardwareError

    typer.echo("the motors are switched on and hold the tail where it is")
    confirm: Callable[[str], bool] = typer.confirm
    seen_by = "operator"
    if is_emulated(wiring, ports):  # there is nothing to be moved by hand
        confirm, seen_by = (lambda _: True), "emulator"
    elif not arm and not _confirm():
        raise HardwareError("not armed: nobody said that the motors may be switched on")
    record, path = run_watchdog_test(scenario, ports, wiring, confirm, seen_by)
    typer.echo(f"{record.cut}: exit frames after {record.time_to_exit * 1000:.0f} ms")
    typer.echo(f"record: {path}")


def _confirm() -> bool:
    question = "keep clear of the tail; type arm to switch the motors on"
    try:
        return bool(typer.prompt(question, default="", show_default=False) == "arm")
    except typer.Abort:  # nobody is there to answer
        return False
