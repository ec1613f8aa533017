"""The files in `hardware/deploy`: fixed names for every device of a ports file, limits that the
drive needs.
"""

import configparser
from pathlib import Path

from aerodima.hardware.car.car_ports import SERIAL_DEVICES
from aerodima.workbench.core.realtime import DRIVE_PRIORITY

DEPLOY = Path(__file__).resolve().parents[2] / "hardware" / "deploy"


def test_the_rules_name_every_device_of_a_ports_file():
    rules = (DEPLOY / "70-aerodima.rules").read_text()
    for name in (*SERIAL_DEVICES, "can"):
        assert f'SYMLINK+="aerodima-{name}"' in rules


def test_user_and_service_may_take_the_priority_of_a_drive():
    limit = (DEPLOY / "95-aerodima.conf").read_text().splitlines()[1].split()
    assert limit[:3] == ["<user>", "-", "rtprio"]
    service = configparser.ConfigParser(strict=False, interpolation=None)
    service.optionxform = str
    service.read_string((DEPLOY / "aerodima-drive.service").read_text())
    assert int(limit[3]) == int(service["Service"]["LimitRTPRIO"]) >= DRIVE_PRIORITY
    assert service["Service"]["LimitMEMLOCK"] == "infinity"
    assert service["Service"]["Restart"] == "no"
