"""Checks before a drive: on the desk, with the devices open, with the car at rest, and with the
motors holding.

Firmware profile: the frames carry no version, but their numbers reveal it. The ratio between the
change of position and the reported velocity depends on the ranges of both: turned by hand, a motor
whose profile is right reports the speed at which its position changes. The range of the torque
cannot be checked like that: 24 and 25 N m differ by 4 %, and profiles that differ in nothing else
stay undecided.
"""

import math
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import PERIOD, CarReading
from aerodima.hardware.devices.bno055 import RATE as IMU_RATE
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.driving.speaker import Say
from aerodima.hardware.protocol.ak70 import PROFILES, FirmwareProfile, decode_reply
from aerodima.hardware.protocol.can_frame import TimedFrames
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import IMU, TAIL_STATE, UNARMED_SOURCES

_MB = 1e6
"""Bytes in a megabyte."""
_SLEEPS = 20
"""Number of sleeps of 1 ms that are timed."""
_COARSE_SLEEP = 0.002
"""Lateness of sleeps beyond which a computer cannot keep cycles of 10 ms, s."""
_FIRST_YEAR = 2024
"""First year that can be right: a calendar that shows an earlier one has not been set."""
_CLOCK_DIFFERENCE = 2.0
"""Largest difference from the receiver's time that is not reported, s."""
_WATCHES = {
    "teensy_bridge": "the Teensy, by the text frames of the computer",
    "watched_can": "the Teensy, by the heartbeat on the motors' bus",
}
_RATIO_TOLERANCE = 0.2
"""Largest distance of `_speed_ratio` from 1 with the right profile."""
_MAX_TEMPERATURE = 120.0
"""Highest plausible temperature of a motor, degrees Celsius."""
_MIN_TEMPERATURE = -30.0
"""Lowest plausible temperature of a motor, degrees Celsius."""
_MIN_SAMPLES = 10
"""Least number of samples that show a living IMU."""


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Attributes:
        name: what was checked.
        passed: True or False; None for a note, such as where it could not be checked.
        text: what was found and what is allowed.
    """

    name: str
    passed: bool | None
    text: str

    def __str__(self) -> str:
        mark = {True: "ok", False: "FAILED", None: "note"}[self.passed]
        return f"{mark:6}  {self.name}: {self.text}"


Checks = list[Check]


def report(checks: Checks, say: Say, refuse: bool = True) -> None:
    """Says every check; with `refuse`, raises a `HardwareError` that names the checks that
    failed.
    """
    for check in checks:
        say(str(check))
    if not refuse:
        return
    failed = [f"{check.name}: {check.text}" for check in checks if check.passed is False]
    if failed:
        raise HardwareError("; ".join(failed))


def preflight_checks(scenario: Scenario, folder: Path, safety: DriveSafety) -> Checks:
    """Checks the rates of the scenario, the space for the log and this computer's clocks."""
    return [*_rates(scenario), _disk(folder, safety), _sleep(), _calendar()]


def device_checks(car: WiredCar, reading: CarReading, safety: DriveSafety) -> Checks:
    """Checks the state of every device, and whether the watchdog answers that switches the motors
    off when this program dies; adds a note on the battery, which nothing measures.

    A GPS may be missing; one that is fitted limits the speed, and must have a fix.
    """
    status = reading.named_status._asdict()
    checks = []
    for source in UNARMED_SOURCES:
        fault = status[f"{source}_fault"]
        age = status[f"{source}_age"]
        if fault == 0.0:
            text = f"answers, {age * 1000:.0f} ms old"
        else:
            text = reading.fault_texts.get(source) or SourceFault(fault).name.lower()
        if fault == SourceFault.NO_FIX:
            text += "; wait for it, or take gps out of the ports file"
        missing = source == "speed" and fault == SourceFault.NOT_FITTED
        checks.append(Check(source, None if missing else fault == 0.0, text))
    pack = f"measure {safety.least_voltage:g} to {safety.most_voltage:g} V, fuse {safety.fuse:g} A"
    battery = Check("battery", None, f"replies of the MIT mode carry no voltage; {pack}")
    watchdog = Check("watchdog", not car.unwatched, car.unwatched or _WATCHES[car.name])
    return [*checks, battery, _gps_clock(car.gps_time), watchdog]


def motor_checks(car: WiredCar, scenario: Scenario, ports: CarPorts, safety: DriveSafety) -> Checks:
    """Checks, while the motors hold, the firmware profile by their replies and the zeros by where
    the tail is held.
    """
    checks = []
    for name, motor_id in zip(("tail pitch", "tail roll"), ports.motor_ids, strict=True):
        replies = car.replies(motor_id)
        try:
            ratio = check_profile(ports.profile, replies)
        except HardwareError as error:
            checks.append(Check(f"{name} profile", False, str(error)))
            continue
        if ratio is None:
            moved = "not turned: its ranges are not proven"
        else:
            moved = f"speed ratio {ratio:.2f}"
        text = f"{ports.profile.name}, {len(replies)} replies, {moved}"
        checks.append(Check(f"{name} profile", None if ratio is None else True, text))
    return [*checks, *zero_checks(car.reading, scenario, safety)]


def _rates(scenario: Scenario) -> Checks:
    rates = (
        ("controller.rate", scenario.controller.rate, 1.0 / PERIOD),
        ("imu.rate", scenario.imu.rate, IMU_RATE),
    )
    return [
        Check(key, math.isclose(rate, allowed), f"{rate:g} Hz; allowed on the car: {allowed:g} Hz")
        for key, rate, allowed in rates
    ]


def _disk(folder: Path, safety: DriveSafety) -> Check:
    folder = folder.resolve()
    existing = next(place for place in (folder, *folder.parents) if place.is_dir())
    free = shutil.disk_usage(existing).free / _MB
    text = f"{free:.0f} MB free in {existing}; needed: {safety.least_disk:g} MB"
    return Check("log disk", free >= safety.least_disk, text)


def _sleep() -> Check:
    late = []
    for _ in range(_SLEEPS):
        before = time.monotonic()
        time.sleep(0.001)
        late.append(time.monotonic() - before - 0.001)
    return sleep_check(late)


def sleep_check(late: list[float]) -> Check:
    """Checks by how much sleeps ended late (s): their median must be within the limit; a single one
    beyond it is a note.
    """
    median, latest = 1000 * np.median(late), 1000 * max(late)
    limit = 1000 * _COARSE_SLEEP
    text = f"half of the sleeps end at most {median:.2f} ms late; allowed: {limit:g} ms"
    if latest > limit:
        text += f"; one ended {latest:.2f} ms late: the computer is busy"
    return Check("loop clock", False if median > limit else latest <= limit or None, text)


def _calendar() -> Check:
    now = time.gmtime()
    return Check(
        "calendar", now.tm_year >= _FIRST_YEAR or None, time.strftime("%Y-%m-%d %H:%M:%S UTC", now)
    )


def _gps_clock(gps_time: float | None) -> Check:
    if gps_time is None:
        return Check("GPS clock", None, "the receiver does not know the time yet")
    difference = (time.time() - gps_time + 43_200) % 86_400 - 43_200
    close = abs(difference) <= _CLOCK_DIFFERENCE or None
    return Check(
        "GPS clock", close, f"this computer is {difference:+.1f} s off the receiver's time"
    )


def zero_checks(reading: CarReading, scenario: Scenario, safety: DriveSafety) -> Checks:
    """Checks whether the tail is held at a mark: an angle at which its law waits, or the stop onto
    which it falls without power.
    """
    hold = scenario.controller.hold_angle
    pitch = [scenario.resting_pitch]
    if scenario.follows_state:
        pitch.append(-scenario.tail.pitch_limit)
    checks = []
    for name, marks in (("pitch_angle", pitch), ("roll_angle", (-hold, 0.0, hold))):
        angle = float(reading.tail_state[TAIL_STATE.index(name)])
        distance = min(abs(angle - mark) for mark in marks)
        allowed = " or ".join(f"{np.degrees(mark):.0f}" for mark in marks)
        tolerance = np.degrees(safety.zero_tolerance)
        text = f"at {np.degrees(angle):.1f} degrees; marks: {allowed}, +-{tolerance:.0f}"
        joint = name.partition("_")[0]
        checks.append(Check(f"tail {joint} zero", distance <= safety.zero_tolerance, text))
    return checks


def check_profile(profile: FirmwareProfile, replies: TimedFrames) -> float | None:
    """Checks a profile against replies of one motor to the neutral command; returns the change of
    position over the integral of the reported velocity: 1 if the profile is right, None if the
    motor was not turned enough to tell.

    Args:
        replies: replies as (arrival in s, frame), in order, at 20 Hz or more; best taken while the
            motor is turned by hand by half a radian.

    Raises:
        HardwareError: no replies, V3 firmware, replies of another length, an implausible
            temperature, or a speed that does not match the change of position; names the profiles
            that would fit.
    """
    if not replies:
        raise HardwareError(
            f"firmware profile {profile.name}: no reply of the motor to check it with"
        )
    lengths = {len(frame.data) for _, frame in replies}
    decoded = [decode_reply(frame, profile) for _, frame in replies]
    if len(lengths) > 1:
        raise HardwareError(
            f"firmware profile {profile.name}: replies of {sorted(lengths)} bytes: two motors on "
            "one id?"
        )
    warm = [reply.temperature for reply in decoded if reply.temperature is not None]
    if warm and not _MIN_TEMPERATURE <= np.median(warm) <= _MAX_TEMPERATURE:
        raise HardwareError(
            f"firmware profile {profile.name}: {np.median(warm):g} degC cannot be: wrong offset?"
        )
    ratio = _speed_ratio(profile, replies)
    if ratio is not None and abs(ratio - 1.0) > _RATIO_TOLERANCE:
        fitting = [name for name, other in PROFILES.items() if _fits(other, replies)]
        raise HardwareError(
            f"firmware profile {profile.name}: the position changes {ratio:.3g} times as fast as "
            "the reported speed; "
            f"profiles that fit: {', '.join(fitting) or 'none that is known'}"
        )
    return ratio


def _fits(profile: FirmwareProfile, replies: TimedFrames) -> bool:
    if not {len(frame.data) for _, frame in replies} <= set(profile.reply_lengths):
        return False
    ratio = _speed_ratio(profile, replies)
    return ratio is not None and abs(ratio - 1.0) <= _RATIO_TOLERANCE


def _speed_ratio(profile: FirmwareProfile, replies: TimedFrames) -> float | None:
    """Returns the least-squares slope of position over integrated velocity; None with too little
    motion.
    """
    decoded = [decode_reply(frame, profile) for _, frame in replies]
    times = np.array([time for time, _ in replies])
    velocity = np.array([reply.velocity for reply in decoded])
    wrapped = np.array([reply.position for reply in decoded])
    position = np.unwrap(wrapped, period=2 * profile.position)
    travelled = cumulative_trapezoid(velocity, times, initial=0.0)
    # A resting motor reports half a step of speed, which adds up to a slow false travel.
    false_travel = profile.speed / 4095 * (times[-1] - times[0])
    if np.ptp(travelled) < 4 * false_travel + 0.1 or np.ptp(position) < 1e-3:
        return None
    slope, _ = np.polyfit(travelled, position, 1)
    return float(slope)


def standstill_checks(
    samples: Sequence[Bno055Sample], reading: np.ndarray, safety: DriveSafety
) -> Checks:
    """Checks whether the car stood still in the last moment.

    Args:
        samples: all samples of the chip that came within that moment, in its own axes.
        reading: newest reading of the IMU, (9,) `aerodima.workbench.scenario.signal_table.IMU`, in
            body axes.
    """
    different = {(sample.quaternion, sample.gyro, sample.acceleration) for sample in samples}
    count = len(samples)
    alive = count >= _MIN_SAMPLES and len(different) > 1
    text = f"{count} samples, {len(different)} different ones"
    if not alive:
        text += "; it has frozen or is silent"
    checks = [Check("IMU", alive, text)]
    if not samples:
        return checks
    gyro = samples[-1].calibration[1]
    level = safety.gyro_calibration
    text = f"gyro {gyro} of 3; allowed is {level}: let the car stand for some seconds"
    checks.append(Check("IMU calibration", gyro >= level, text))
    turning = float(np.max(np.linalg.norm([sample.gyro for sample in samples], axis=1)))
    pushed = float(np.linalg.norm(np.mean([sample.acceleration for sample in samples], axis=0)))
    still = turning <= safety.still_rate and pushed <= safety.still_acceleration
    allowed = f"{safety.still_rate:g} and {safety.still_acceleration:g}"
    text = f"turns at {turning:.2f} rad/s, is pushed by {pushed:.2f} m/s2; allowed: {allowed}"
    checks.append(Check("car stands still", still, text))
    imu = IMU.read(reading)
    tilt = max(abs(imu.roll), abs(imu.pitch))
    limit = math.degrees(safety.upright)
    text = f"tilted by {math.degrees(tilt):.0f} degrees; allowed is {limit:.0f}"
    return [*checks, Check("car stands upright", tilt <= safety.upright, text)]
