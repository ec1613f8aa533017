"""The files that set up a car: the Teensy's sketch with its numbers, and what the computer needs of the system.

What a car's computer needs of the system (names, limits, a service) are files to look at and to install by hand: they
are written into a folder, and the commands that install them are printed. Nothing here touches the system.
"""

from __future__ import annotations

import getpass
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.hardware.car.latency import WATCHDOG_PRIORITY
from aerodima.workbench.errors import HardwareError

if TYPE_CHECKING:
    from aerodima.hardware.car.car_ports import CarPorts


def firmware(
    folder: Annotated[Path, typer.Argument(help="New folder for the sketch; its last name is the sketch's.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge, watched_can or direct_can.")] = "teensy_bridge",
    profile: Annotated[str, typer.Option(help="Firmware profile of the tail motors.")] = "ak70_10_v1_0_8",
    motor_ids: Annotated[tuple[int, int], typer.Option(help="Ids of the pitch and the roll motor.")] = (1, 2),
    encoder: Annotated[str, typer.Option(help="Part that reads the sail: aeat_6012 or aeat_6010.")] = "aeat_6012",
    ports: Annotated[
        Path | None, typer.Option(help="Ports file (JSON): ids, zeros and profile of the motors from there.")
    ] = None,
    scenario: Annotated[str, typer.Option(help="Scenario whose tail the limits of the motors are of.")] = "auto_turn",
    published_strings: Annotated[
        bool, typer.Option("--published-strings", help="Strings as printed in the thesis, without checksum.")
    ] = False,
) -> None:
    """Write the Teensy's sketch with a config.h made of the parameters, ready for the Arduino IDE.

    Example: aerodima firmware aerodima_teensy --ports car.json
    """
    from aerodima.hardware.car.car_ports import bare_ports, ports_from_dict, read_ports
    from aerodima.hardware.car.safety_settings import load_teensy_timing
    from aerodima.hardware.firmware.firmware_settings import FirmwareSettings, firmware_limits
    from aerodima.hardware.firmware.firmware_sketch import export_sketch, firmware_hash
    from aerodima.hardware.protocol.sail_encoder import encoder_profile
    from aerodima.hardware.protocol.teensy import StringForm
    from aerodima.workbench.config.scenario import load_scenario

    car = ports_from_dict(bare_ports(profile, motor_ids), "firmware") if ports is None else read_ports(ports)
    settings = FirmwareSettings(
        wiring,
        car.profile,
        load_teensy_timing(),
        car.motor_ids,
        encoder_profile(encoder),
        StringForm.PUBLISHED if published_strings else StringForm.CHECKED,
        firmware_limits(load_scenario(scenario), car),
    )
    sketch = export_sketch(settings, folder)
    typer.echo(f"sketch: {sketch}")
    typer.echo(f"firmware: {firmware_hash()[:12]}, {wiring}, {car.firmware_profile}")


def install_files(
    folder: Annotated[Path, typer.Argument(help="Folder for the files.")],
    ports: Annotated[Path, typer.Option(help="Ports file (JSON) of the car.")],
    wiring: Annotated[str, typer.Option(help="teensy_bridge, watched_can or direct_can.")] = "teensy_bridge",
    scenario: Annotated[str, typer.Option(help="What the service drives.")] = "auto_turn",
    user: Annotated[str, typer.Option(help="Who drives; the present user when not given.")] = "",
) -> None:
    """Write fixed device names (udev), real-time limits and a systemd service; says how to install them.

    Nothing is installed. The service's kill mode spares the watchdog.

    Example: aerodima install-files system --ports car.json
    """
    from aerodima.hardware.car.car_ports import read_ports
    from aerodima.hardware.car.wiring import wiring_name

    name = wiring_name(wiring)
    for file in write_system_files(folder, read_ports(ports), ports, name, scenario, user):
        typer.echo(f"sudo install -m 644 {folder / file.name} {file.place}/")
    typer.echo("sudo udevadm control --reload && sudo udevadm trigger && sudo systemctl daemon-reload")


RULES, LIMITS, UNIT = "70-aerodima.rules", "95-aerodima.conf", "aerodima-drive.service"
_USB = Path("/sys/class/tty")
_PRIORITY = WATCHDOG_PRIORITY + 10
"""Largest real-time priority that the limits allow."""

_UNIT = """\
# One drive, started by hand beside the car: systemctl start aerodima-drive. Never enable it: it arms without asking
# on a terminal (the operator must still be heard in IDLE, and then choose).
[Unit]
Description=AeroDima drive

[Service]
User={user}
Environment=AERODIMA_UNIT=1
ExecStart={program} drive {scenario} --ports {ports} --wiring {wiring} --arm --force --log {folder}/drive.parquet
# Ends the drive alone: its watchdog, in a control group of its own below this one, must outlive it to switch the
# motors off.
KillMode=process
KillSignal=SIGTERM
Delegate=yes
OOMPolicy=continue
OOMScoreAdjust=-900
LimitRTPRIO={priority}
LimitMEMLOCK=infinity
Restart=no
"""


@dataclass(frozen=True)
class SystemFile:
    """A file and where it belongs."""

    name: str
    text: str
    place: str


def udev_rules(ports: CarPorts) -> str:
    """Fixed names for the serial devices of a car, by maker, product and serial number of what is plugged in now."""
    paths = ports.serial_paths
    if ports.can is not None and ports.can.interface == "slcan":
        paths["can"] = ports.can.channel.partition("@")[0]
    lines = ["# Devices of the car under names that stay: /dev/aerodima-teensy and so on, for the group dialout."]
    for name, path in paths.items():
        found = _usb_of(path)
        mark = "" if found else f"# {path} is no USB device that is plugged in; fill in and take the # away:\n# "
        vendor, product, serial = found or ("<vendor>", "<product>", "<serial>")
        rule = [
            'SUBSYSTEM=="tty"',
            f'ATTRS{{idVendor}}=="{vendor}"',
            f'ATTRS{{idProduct}}=="{product}"',
            *([f'ATTRS{{serial}}=="{serial}"'] if serial else []),
            f'SYMLINK+="aerodima-{name}"',
            'GROUP="dialout"',
            'MODE="0660"',
        ]
        lines.append(mark + ", ".join(rule))
    return "\n".join(lines) + "\n"


def limits_file(user: str) -> str:
    """Real-time priority and locked memory for a user (pam_limits)."""
    return (
        f"# Real-time priority for drive and watchdog, memory that stays in place; after the next login.\n"
        f"{user} - rtprio {_PRIORITY}\n{user} - memlock unlimited\n"
    )


def unit_file(user: str, ports: Path, wiring: str, scenario: str) -> str:
    """The service of a drive. Its kill mode spares the watchdog, which has a control group of its own."""
    program, folder = Path(sys.executable).with_name("aerodima"), Path.home() / "aerodima-logs"
    return _UNIT.format(
        user=user,
        program=program,
        scenario=scenario,
        ports=ports.resolve(),
        wiring=wiring,
        folder=folder,
        priority=_PRIORITY,
    )


def write_system_files(
    folder: Path, ports: CarPorts, ports_path: Path, wiring: str, scenario: str, user: str = ""
) -> list[SystemFile]:
    """Writes rules, limits and service into a folder.

    Raises:
        HardwareError: one of them exists there, or cannot be written.
    """
    user = user or getpass.getuser()
    files = [
        SystemFile(RULES, udev_rules(ports), "/etc/udev/rules.d"),
        SystemFile(LIMITS, limits_file(user), "/etc/security/limits.d"),
        SystemFile(UNIT, unit_file(user, ports_path, wiring, scenario), "/etc/systemd/system"),
    ]
    for file in files:
        if (folder / file.name).exists():
            raise HardwareError(f"{folder / file.name}: exists already and is not overwritten; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file in files:
            (folder / file.name).write_text(file.text, encoding="utf-8")
    except OSError as error:
        raise HardwareError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None
    return files


def _usb_of(path: str) -> tuple[str, str, str] | None:
    """Vendor, product and serial number (may be empty) of the USB device behind a terminal; None if there is none."""
    place = _USB / Path(path).resolve().name / "device"
    for folder in (place.resolve(), *place.resolve().parents):
        if (folder / "idVendor").is_file():
            names = ("idVendor", "idProduct", "serial")
            vendor, product, serial = (
                (folder / name).read_text().strip() if (folder / name).is_file() else "" for name in names
            )
            return vendor, product, serial
    return None
