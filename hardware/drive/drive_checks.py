"""What is looked at before the car drives: on the desk, with the devices open, and with the motors holding."""

from __future__ import annotations

import math
import shutil
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.drive_safety import DriveSafety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.bno055 import RATE as IMU_RATE
from aerodima.hardware.devices.profile_check import check_profile
from aerodima.hardware.drive.plain_loop import PERIOD
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import STATUS, TAIL_STATE
from aerodima.workbench.errors import HardwareError

_MB = 1e6
_SLEEPS = 20
_COARSE_SLEEP = 0.002
"""s; a computer whose sleeps end later than that cannot keep 10 ms."""
_FIRST_YEAR = 2024
_CLOCK_DIFFERENCE = 2.0


@dataclass(frozen=True)
class Check:
    """One line of the list.

    Attributes:
        name: what was looked at.
        passed: True, False, or None where it could not be told.
        text: what was found and what is allowed.
    """

    name: str
    passed: bool | None
    text: str

    def __str__(self) -> str:
        mark = {True: "ok", False: "FAILED", None: "note"}[self.passed]
        return f"{mark:6}  {self.name}: {self.text}"


def refuse_failed(checks: list[Check]) -> None:
    """Raises `HardwareError` with every check that failed."""
    failed = [f"{check.name}: {check.text}" for check in checks if check.passed is False]
    if failed:
        raise HardwareError("; ".join(failed))


def desk_checks(scenario: Scenario, folder: Path, safety: DriveSafety) -> list[Check]:
    """Rates of the scenario, space for the log, clocks of this computer."""
    return [*_rates(scenario), _disk(folder, safety), _sleep(), _calendar()]


def device_checks(reading: CarReading, gps_time: float | None, safety: DriveSafety) -> list[Check]:
    """What every device says of itself, and what nobody says: the battery."""
    status = STATUS.read(reading.status)._asdict()
    checks = []
    for source in ("sail", "imu", "speed", "operator"):
        fault, age = status[f"{source}_fault"], status[f"{source}_age"]
        text = f"answers, {age * 1000:.0f} ms old" if fault == 0.0 else reading.fault_text or f"fault {fault:g}"
        checks.append(Check(source, fault == 0.0 or (None if source == "speed" else False), text))
    checks.append(
        Check(
            "battery",
            None,
            f"replies of the MIT mode carry no voltage; measure {safety.least_voltage:g} to {safety.most_voltage:g} V, "
            f"fuse {safety.fuse:g} A",
        )
    )
    return [*checks, _gps_clock(gps_time)]


_WATCHES = {
    "teensy_bridge": "the Teensy, on the motors' bus",
    "watched_can": "a process of this computer, and the Teensy on the motors' bus",
    "direct_can": "a process of this computer only: if both die together the motors hold their last command",
}


def watchdog_check(wiring: str, unwatched: str) -> Check:
    """Who switches the motors off when this program dies, and whether it answers."""
    passed = False if unwatched else None if wiring == "direct_can" else True
    return Check("watchdog", passed, unwatched or _WATCHES[wiring])


def motor_checks(car: WiredCar, scenario: Scenario, ports: CarPorts, safety: DriveSafety) -> list[Check]:
    """Firmware profile by the replies, and the zero by where the tail is held; with the motors holding."""
    checks = []
    for name, motor_id in zip(("tail pitch", "tail roll"), ports.motor_ids, strict=True):
        try:
            evidence = check_profile(ports.profile, car.replies(motor_id))
        except HardwareError as error:
            checks.append(Check(f"{name} profile", False, str(error)))
            continue
        ratio = evidence.speed_ratio
        moved = "not turned: its ranges are not proven" if ratio is None else f"speed ratio {ratio:.2f}"
        text = f"{ports.profile.name}, {evidence.replies} replies of {evidence.reply_length} bytes, {moved}"
        checks.append(Check(f"{name} profile", None if ratio is None else True, text))
    return [*checks, *_zeros(car.reading, scenario, safety)]


def _rates(scenario: Scenario) -> list[Check]:
    rates = {"controller.rate": (scenario.controller.rate, 1.0 / PERIOD), "imu.rate": (scenario.imu.rate, IMU_RATE)}
    return [
        Check(key, math.isclose(rate, allowed), f"{rate:g} Hz; allowed on the car: {allowed:g} Hz")
        for key, (rate, allowed) in rates.items()
    ]


def _disk(folder: Path, safety: DriveSafety) -> Check:
    existing = next(parent for parent in (folder.resolve(), *folder.resolve().parents) if parent.is_dir())
    free = shutil.disk_usage(existing).free / _MB
    text = f"{free:.0f} MB free in {existing}; needed: {safety.least_disk:g} MB"
    return Check("log disk", free >= safety.least_disk, text)


def _sleep() -> Check:
    late = []
    for _ in range(_SLEEPS):
        before = time.monotonic()
        time.sleep(0.001)
        late.append(time.monotonic() - before - 0.001)
    median, worst = float(np.median(late)), max(late)
    text = (
        f"a sleep ends {median * 1000:.2f} ms late (at most {worst * 1000:.2f}); allowed: {_COARSE_SLEEP * 1000:g} ms"
    )
    return Check("loop clock", median <= _COARSE_SLEEP, text)


def _calendar() -> Check:
    year = time.gmtime().tm_year
    return Check(
        "calendar", True if year >= _FIRST_YEAR else None, time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime())
    )


def _gps_clock(gps_time: float | None) -> Check:
    if gps_time is None:
        return Check("GPS clock", None, "the receiver does not know the time yet")
    difference = (time.time() - gps_time + 43_200) % 86_400 - 43_200
    close = abs(difference) <= _CLOCK_DIFFERENCE
    return Check("GPS clock", True if close else None, f"this computer is {difference:+.1f} s off the receiver's time")


def _zeros(reading: CarReading, scenario: Scenario, safety: DriveSafety) -> list[Check]:
    hold, pitch = scenario.controller.hold_angle, scenario.controller.pitch_angle
    checks = []
    for name, marks in (("pitch_angle", (pitch,)), ("roll_angle", (-hold, 0.0, hold))):
        angle = float(reading.tail_state[TAIL_STATE.index(name)])
        off = min(abs(angle - mark) for mark in marks)
        allowed = " or ".join(f"{np.degrees(mark):.0f}" for mark in marks)
        text = f"at {np.degrees(angle):.1f} degrees; marks: {allowed}, +-{np.degrees(safety.zero_tolerance):.0f}"
        checks.append(Check(f"tail {name.partition('_')[0]} zero", off <= safety.zero_tolerance, text))
    return checks
