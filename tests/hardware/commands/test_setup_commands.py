"""Files for the system of the car's computer: rules that name devices, limits, a service that spares the watchdog."""

import configparser
import json
import os
import subprocess
import sys

import pytest

from aerodima.hardware.car.car_ports import ports_from_dict
from aerodima.hardware.car.latency import DRIVE_PRIORITY, WATCHDOG_PRIORITY
from aerodima.hardware.commands import setup_commands as system_files
from aerodima.hardware.commands.setup_commands import LIMITS, RULES, UNIT, udev_rules, write_system_files
from aerodima.hardware.watchdog.__main__ import leave_control_group
from aerodima.workbench.errors import HardwareError

PORTS = {
    "schema": "aerodima/ports/1",
    "teensy": {"path": "/dev/ttyACM7"},
    "imu": {"path": "/dev/ttyUSB9"},
    "can": {"interface": "slcan", "channel": "/dev/ttyACM8@1000000"},
}


def unit_of(folder, tmp_path):
    write_system_files(folder, ports_from_dict(PORTS), tmp_path / "car.json", "teensy_bridge", "auto_turn", "driver")
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read_string((folder / UNIT).read_text())
    return parser["Service"]


def test_the_service_ends_the_drive_alone_and_gives_what_real_time_needs(tmp_path):
    service = unit_of(tmp_path / "system", tmp_path)
    assert service["KillMode"] == "process"
    assert service["Delegate"] == "yes"
    assert service["Environment"] == "AERODIMA_UNIT=1"
    assert service["Restart"] == "no"
    assert int(service["LimitRTPRIO"]) >= WATCHDOG_PRIORITY > DRIVE_PRIORITY
    assert service["LimitMEMLOCK"] == "infinity"
    assert f"--ports {tmp_path / 'car.json'} --wiring teensy_bridge" in service["ExecStart"]


def test_the_limits_are_those_of_the_user(tmp_path):
    unit_of(tmp_path / "system", tmp_path)
    lines = (tmp_path / "system" / LIMITS).read_text().splitlines()[1:]
    assert lines == [f"driver - rtprio {WATCHDOG_PRIORITY + 10}", "driver - memlock unlimited"]


def test_rules_carry_the_numbers_of_what_is_plugged_in(tmp_path, monkeypatch):
    usb = tmp_path / "devices" / "1-1"
    (usb / "1-1:1.0" / "tty" / "ttyACM7").mkdir(parents=True)
    for name, value in {"idVendor": "16c0", "idProduct": "0483", "serial": "12345"}.items():
        (usb / name).write_text(value + "\n")
    classes = tmp_path / "class"
    (classes / "ttyACM7").mkdir(parents=True)
    (classes / "ttyACM7" / "device").symlink_to(usb / "1-1:1.0")
    monkeypatch.setattr(system_files, "_USB", classes)
    rules = udev_rules(ports_from_dict(PORTS)).splitlines()
    assert (
        'SUBSYSTEM=="tty", ATTRS{idVendor}=="16c0", ATTRS{idProduct}=="0483", ATTRS{serial}=="12345", '
        'SYMLINK+="aerodima-teensy", GROUP="dialout", MODE="0660"'
    ) in rules
    missing = [line for line in rules if "/dev/ttyUSB9" in line or "/dev/ttyACM8" in line]
    assert len(missing) == 2
    assert all(line.startswith("#") for line in missing)


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / RULES).touch()
    with pytest.raises(HardwareError, match="not overwritten"):
        write_system_files(tmp_path, ports_from_dict(PORTS), tmp_path / "car.json", "direct_can", "auto_turn")
    assert not (tmp_path / UNIT).exists()


def test_the_watchdog_moves_into_a_group_of_its_own_below_that_of_the_service(tmp_path):
    own = tmp_path / "cgroup"
    own.write_text("1:name=systemd:/old\n0::/system.slice/aerodima-drive.service\n")
    (tmp_path / "system.slice" / "aerodima-drive.service").mkdir(parents=True)
    group = leave_control_group(tmp_path, own, asked=True)
    assert group == str(tmp_path / "system.slice" / "aerodima-drive.service" / "watchdog")
    procs = tmp_path / "system.slice" / "aerodima-drive.service" / "watchdog" / "cgroup.procs"
    assert procs.read_text() == f"{os.getpid()}\n"


def test_it_stays_where_it_is_without_the_service_or_the_right(tmp_path):
    own = tmp_path / "cgroup"
    own.write_text("0::/user.slice\n")
    assert leave_control_group(tmp_path, own, asked=False) == ""
    assert leave_control_group(tmp_path / "nowhere", own, asked=True) == ""
    assert leave_control_group(tmp_path, tmp_path / "none", asked=True) == ""


def test_the_command_says_how_to_install(tmp_path):
    ports = tmp_path / "car.json"
    ports.write_text(json.dumps(PORTS))
    command = [
        sys.executable,
        "-m",
        "aerodima.workbench.cli.program",
        "install-files",
        str(tmp_path / "system"),
        "--ports",
        str(ports),
    ]
    found = subprocess.run(command, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert f"sudo install -m 644 {tmp_path / 'system' / UNIT} /etc/systemd/system/" in found.stdout
