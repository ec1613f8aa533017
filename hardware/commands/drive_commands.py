"""`aerodima drive run`, `check`, `zero`, `motor-test`, `watchdog-test` and `firmware`: the real or
the emulated car.
"""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from aerodima import hardware
from aerodima.hardware.commands.car_options import Arm, CarOptions
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.errors import HardwareError, UserError
from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.core.terminal import say

if TYPE_CHECKING:
    from aerodima.hardware.car.car_ports import CarPorts
    from aerodima.hardware.car.wiring import WiringName
    from aerodima.hardware.driving.drive_result import DriveResult
    from aerodima.workbench.control.tail_law import TailLaw
    from aerodima.workbench.scenario.scenario import Scenario

Words = list[str]
"""Words of a command line."""
OLD_FLAGS = {
    "--firmware": ("firmware", "--out"),
    "--zero": ("zero", ""),
    "--motor-test": ("motor-test", "--joint"),
    "--watchdog-test": ("watchdog-test", ""),
    "--dry-run": ("check", ""),
}
"""Flags of `aerodima drive SCENARIO` in version 0.3: the sub-command and the option that replace
them. To be dropped in 0.5."""
_RUN_FLAGS = ("--arm", "--force", "--no-drake", "--other-car")
"""Flags that only a drive takes; version 0.3 ignored them elsewhere."""
_RUN_OPTIONS = ("--swing", "--law", "--diagram", "--out", "-o", "--traffic")
"""Options with a value that only a drive takes."""
DriveScenario = Annotated[str, cli.named("Scenario, or its bundle (JSON)", "scenarios")]


class DriveGroup(TyperGroup):
    """The group `drive`; takes the flags of version 0.3 too, with a deprecation notice."""

    def parse_args(self, ctx: Any, args: Words) -> Words:  # Typer's context is private
        """Parses the words; those of version 0.3 as the sub-command that replaces them."""
        if args and args[0] not in self.commands and not ctx.resilient_parsing and _is_old(args[0]):
            args = current_words(args)
            print(f"deprecated: use `aerodima drive {shlex.join(args)}`", file=sys.stderr)
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: Words) -> Any:
        """Returns the sub-command; for an unknown one, raises a `UserError` that lists them all."""
        if args[0] not in self.commands and not ctx.resilient_parsing:
            raise UserError(f"drive {args[0]}: must be one of {', '.join(self.commands)}")
        return super().resolve_command(ctx, args)


def _is_old(word: str) -> bool:
    """Returns whether the first word after `drive` is of version 0.3: an option or a scenario."""
    if word.startswith("-"):
        return word not in ("-h", "--help")
    return bool(Path(word).suffix) or (models_dir() / "scenarios" / f"{word}.yaml").exists()


def current_words(words: Words) -> Words:
    """Translates the words after `aerodima drive` of version 0.3 to a sub-command and its words."""
    for flag, (command, option) in OLD_FLAGS.items():
        for index, word in enumerate(words):
            if word.partition("=")[0] == flag:
                before = _without_run_options(words[:index], command)
                after = _without_run_options(words[index + 1 :], command)
                replacement = []
                if option:
                    value = word.partition("=")[2] or "".join(after[:1])
                    after = after if "=" in word else after[1:]
                    replacement = [f"{option}={value}"]
                return [command, *before, *replacement, *after]
    return ["run", *words]


def _without_run_options(words: Words, command: str) -> Words:
    """Returns the words without those that a sub-command lacks and version 0.3 ignored."""
    if command == "check":  # it takes what a drive takes, and never arms
        return [word for word in words if word != "--arm"]
    kept = []
    rest = iter(words)
    for word in rest:
        name, _, value = word.partition("=")
        if name in _RUN_OPTIONS and not value:
            next(rest, None)
        elif name not in (*_RUN_FLAGS, *_RUN_OPTIONS):
            kept.append(word)
    return kept


def register(app: typer.Typer) -> None:
    """Adds the group `drive`."""
    words = "Drive the real or the emulated car: first tests, checks, the drive itself."
    group = cli.command_group(app, "drive", words, cli.CAR, DriveGroup)
    for command in (run, check, zero, motor_test, watchdog_test, firmware):
        group.command(no_args_is_help=True)(command)


@dataclass(frozen=True)
class PlanOptions:
    """Options of a drive: what drives the car, and what is recorded of it."""

    swing: cli.SwingOption = None
    other_car: cli.OtherCar = False
    law: cli.Law = None
    diagram: cli.Build = None
    no_drake: Annotated[
        bool, typer.Option("--no-drake", help="Plain loop, for computers without Drake.")
    ] = False
    out: cli.LogOut = Path("drive.parquet")
    traffic: Annotated[
        Path | None,
        typer.Option(
            help="Every frame on the CAN bus into this file (.blf).", callback=cli.endings(".blf")
        ),
    ] = None
    force: cli.Force = False


@cli.grouped
def run(scenario: DriveScenario, car: CarOptions, plan: PlanOptions, arm: Arm = False) -> None:
    """Drive a scenario and write its log.

    Check, arm, run the sequence (AUTO) or obey the radio (MANUAL, CONTROL), disarm. The operator's
    radio chooses the mode and must stay alive. Ctrl-C switches the motors off at once.

    Example: aerodima drive run auto_turn --ports car.json --out run.parquet
    """
    from aerodima.hardware.driving.arming import may_arm

    _drive(scenario, car, plan, confirm=None if arm else may_arm)


@cli.grouped
def check(scenario: DriveScenario, car: CarOptions, plan: PlanOptions) -> None:
    """Check every device, motors never armed.

    The sequence runs with the motors off. What fails is listed, and the rest is checked too. The
    log shows what the sensors read.

    Example: aerodima drive check auto_turn --ports car.json --out check.parquet
    """
    _drive(scenario, car, plan, dry_run=True)


def _drive(
    name: str,
    car: CarOptions,
    plan: PlanOptions,
    *,
    confirm: Callable[[], bool] | None = None,
    dry_run: bool = False,
) -> None:
    """Drives with the systems that the options name; raises `typer.Exit` unless the drive ended in
    order.
    """
    from aerodima.hardware.driving.drive_result import DriveOptions
    from aerodima.hardware.driving.drive_session import DriveSession
    from aerodima.workbench.control.swing_library import refuse_other_car
    from aerodima.workbench.control.user_law import load_build, load_law

    if plan.law is not None and plan.swing is not None:
        raise HardwareError("--law: allowed without --swing; each says what the tail does")
    if plan.diagram is not None and (
        plan.law is not None or plan.swing is not None or plan.no_drake
    ):
        raise HardwareError(
            "--diagram: allowed without --law, --swing and --no-drake; it says what the tail does"
        )
    scenario, ports, wiring, law = _load(name, car, plan.swing)
    build = None if plan.diagram is None else load_build(plan.diagram)
    law_name = ""
    if plan.law is not None:
        law = load_law(plan.law, scenario)
        law_name = type(law).__name__
    elif not plan.other_car and build is None:
        refuse_other_car(scenario)
    if plan.traffic is not None and wiring == "teensy_bridge":
        raise HardwareError(
            f"--traffic {plan.traffic}: the frames are on the Teensy's bus; allowed with "
            "watched_can"
        )
    out = plan.out.absolute()
    options = DriveOptions(out, plan.force, dry_run, not plan.no_drake, confirm, law_name=law_name)
    wired = hardware.connect(ports, scenario, wiring, plan.traffic, name)
    session = DriveSession(wired, scenario, ports, options, say, law=law, build=build)
    _report(session.complete(), out, plan.traffic)


def _report(result: DriveResult, out: Path, traffic: Path | None) -> None:
    """Prints how a drive ended; raises `typer.Exit` unless it did so in order, with all its files
    in their places.
    """
    if result.log is not None:
        say(f"log: {result.log}")
    say(f"ended: {result.reason}; {result.ending}".rstrip("; "), err=not result.orderly)
    if result.traffic_error:
        say(f"error: {traffic}: {result.traffic_error}", err=True)
    if result.signal:
        raise typer.Exit(128 + result.signal)
    if not result.orderly:
        say(f"error: the car was stopped: {result.reason}", err=True)
        raise typer.Exit(cli.Status.NO)
    if result.traffic_error or result.log not in (None, out):
        raise typer.Exit(cli.Status.LEFT_OUT)


@cli.grouped
def zero(scenario: DriveScenario, car: CarOptions, arm: Arm = False) -> None:
    """Write the motors' zeros into the ports file.

    Hold the tail exactly upright by hand: the motors make no torque while their angles are read.

    Example: aerodima drive zero auto_turn --ports car.json
    """
    from aerodima.hardware.driving.arming import typed
    from aerodima.hardware.driving.motor_zero import joint_angles, read_motor_angles, write_zeros

    _, ports, wiring, _ = _load(scenario, car)
    question = "hold the tail exactly upright, its motors are off; type zero to read its angles"
    if not arm and typed(question) != "zero":
        raise HardwareError("zero: nobody said that the tail is held upright; nothing was written")
    angles = read_motor_angles(ports, wiring)
    for joint, angle in joint_angles(ports, angles).items():
        say(f"{joint}: {math.degrees(angle):+.1f} degrees by the zero of before")
    write_zeros(car.ports, angles)
    values = ", ".join(f"{joint} {angle:.4f} rad" for joint, angle in angles.items())
    say(f"zeros: {values} in {car.ports}")
    if wiring == "teensy_bridge":
        changes = [word for setting in car.settings or () for word in ("--set", setting)]
        words = [scenario, "--ports", str(car.ports), *changes, "--out", "teensy_sketch"]
        again = f"aerodima drive firmware {shlex.join(words)}"
        say(f"the firmware limits motor angles: write it anew with `{again}`")


@cli.grouped
def motor_test(
    scenario: DriveScenario,
    car: CarOptions,
    joint: Annotated[str, cli.chosen("Joint to move.", "tail_pitch", "tail_roll")],
    arm: Arm = False,
) -> None:
    """Move a joint by five degrees and back, and judge it.

    The other joint is held. Angle, torque, temperature and direction must be right.

    Example: aerodima drive motor-test auto_turn --ports car.json --joint tail_pitch
    """
    from aerodima.hardware.car.car_ports import JOINTS
    from aerodima.hardware.driving.motor_test import run_motor_test

    loaded, ports, wiring, _ = _load(scenario, car)
    if joint not in JOINTS or not loaded.has_tail:
        raise HardwareError(
            f"--joint {joint}: must be {' or '.join(JOINTS)}, with a scenario that has a tail"
        )
    _ask_to_arm(arm)
    wired = hardware.connect(ports, loaded, wiring, scenario_name=scenario)
    confirm, _ = _confirmation_prompt(ports, wiring)
    result = run_motor_test(wired, joint, say, confirm)
    moved = f"moved by {math.degrees(result.moved):+.1f} degrees"
    torque = f"torque {result.torque:+.2f} N m where {result.wanted:+.2f} is asked for"
    degrees = "not reported" if result.temperature is None else f"{result.temperature:g} degC"
    say(f"{joint}: well: {moved}, {torque}, temperature {degrees}")


@cli.grouped
def watchdog_test(scenario: DriveScenario, car: CarOptions, arm: Arm = False) -> None:
    """Cut the link, see the motors off, and record it.

    Motors of a wiring are armed only after this test. They hold the tail where it is, the link is
    cut, and somebody beside the car says whether the tail moves freely.

    Example: aerodima drive watchdog-test auto_turn --ports car.json
    """
    from aerodima.hardware.driving.watchdog_test import run_watchdog_test

    loaded, ports, wiring, _ = _load(scenario, car)
    say("once you have typed arm, the motors hold the tail where it is")
    confirm, seen_by = _confirmation_prompt(ports, wiring)
    _ask_to_arm(arm or seen_by == "emulator")
    record, path = run_watchdog_test(loaded, ports, wiring, confirm, seen_by)
    say(f"{record.cut}: exit frames after {record.time_to_exit * 1000:.0f} ms")
    say(f"record: {path}")


@cli.grouped
def firmware(
    scenario: DriveScenario,
    car: CarOptions,
    out: Annotated[Path, cli.written("New folder for the sketch.")],
) -> None:
    """Write the Teensy's sketch for a car and its scenario.

    Example: aerodima drive firmware auto_turn --ports car.json --out teensy
    """
    from aerodima.hardware.firmware.teensy_firmware import (
        export_sketch,
        firmware_hash,
        firmware_settings,
    )

    loaded, ports, wiring, _ = _load(scenario, car)
    say(f"sketch: {export_sketch(firmware_settings(wiring, ports, loaded), out)}")
    say(f"firmware: {firmware_hash()[:12]}, {wiring}, {ports.firmware_profile}")


def _load(
    name: str, car: CarOptions, swing: str | None = None
) -> tuple[Scenario, CarPorts, WiringName, TailLaw]:
    """Returns scenario, ports, wiring and tail law that the options name.

    A swing of another car is refused by `_drive` alone: first tests and the sketch play none.
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.car.wiring import wiring_name
    from aerodima.workbench.control.controller_bundle import load_drive

    wiring = wiring_name(car.wiring)
    chosen_swing = [f"controller.swing_file={swing}"] if swing else []
    scenario, law = load_drive(name, [*chosen_swing, *(car.settings or [])])
    return scenario, read_ports(car.ports), wiring, law


def _confirmation_prompt(ports: CarPorts, wiring: WiringName) -> tuple[Callable[[str], bool], str]:
    """Returns the function that confirms what is seen of the tail, and who answers: the operator,
    or the emulator, which always confirms.
    """
    from aerodima.hardware.driving.arming import typed
    from aerodima.hardware.driving.watchdog_record import is_emulated

    if is_emulated(wiring, ports):
        return (lambda _: True), "emulator"
    return (lambda question: typed(f"{question} [y/N]").lower() in ("y", "yes")), "operator"


def _ask_to_arm(arm: bool) -> None:
    from aerodima.hardware.driving.arming import may_arm

    if not arm and not may_arm():
        raise HardwareError("not armed: nobody said that the motors may be switched on")
