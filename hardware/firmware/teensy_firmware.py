"""The Teensy's firmware: its numbers, the sketch that is exported, its core as a library."""

import hashlib
import os
import shutil
import subprocess
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from aerodima.hardware.car.car_ports import CarPorts
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import (
    DriveSafety,
    TeensyTiming,
    load_drive_safety,
    load_teensy_timing,
)
from aerodima.hardware.car.wiring import WiringName
from aerodima.hardware.car.wirings import tail_motors
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.protocol.ak70 import FirmwareProfile
from aerodima.hardware.protocol.teensy import SERVO_PULSES, THROTTLE_PULSES
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import Scenario

Fields = dict[str, float]
"""Fields of a structure of the core, by name."""
SKETCH = Path(__file__).resolve().parent / "aerodima_teensy"
"""Folder of the Arduino sketch; its subfolder `src` is the core."""
COMPILERS = ("g++", "c++", "clang++")
_FLAGS = (
    "-std=c++17",
    "-O2",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-ffp-contract=off",
    "-shared",
    "-fPIC",
)
_BUILD_TIME = 120.0
"""Longest time that the compiler may take, s."""
_HOST_ONLY = ("c_interface.h", "c_interface.cpp")


def motor_limits(settings: MotorSettings) -> Fields:
    """Returns the fields of the core's `MotorLimits` (`src/motor_guard.h`) by name: what it lets
    through to this motor.

    They are the limits of the computer in the motor's own angle: rad, rad/s, N m, N m/rad, N m
    s/rad, N m, (N m)^2 s.
    """
    ends = settings.motor_angle(settings.low), settings.motor_angle(settings.high)
    return {
        "low": min(ends),
        "high": max(ends),
        "speed": settings.safety.speed_limit,
        "torque": settings.torque_limit,
        "kp": settings.kp_max,
        "kd": settings.kd_max,
        "rated_torque": settings.safety.rated_torque,
        "budget": settings.safety.overload,
    }


@dataclass(frozen=True)
class FirmwareSettings:
    """Settings for which one Teensy is built.

    Attributes:
        wiring: wiring of the car; in `teensy_bridge` the Teensy drives the motors, in `watched_can`
            it sends exit frames only.
        profile: firmware profile of the motors.
        motor_ids: ids of the pitch and the roll motor, which are switched off when the Teensy
            starts.
        sail_bits: number of bits in a word of the sail's encoder. The thesis reads 12; the part
            that it names has 10 (ERRATA E30).
        limits: limits of the two motors by `motor_limits`; None: all that the profile allows.
        timing: timing of the watchdog and of the replies.
        safety: limits of attitude, steering and throttle.
    """

    wiring: WiringName
    profile: FirmwareProfile
    motor_ids: tuple[int, int] = (1, 2)
    sail_bits: int = 12
    limits: tuple[Fields, ...] | None = None
    timing: TeensyTiming = field(default_factory=load_teensy_timing)
    safety: DriveSafety = field(default_factory=load_drive_safety)

    @property
    def last_limits(self) -> tuple[Fields, ...]:
        """Limits of the two motors in the firmware."""
        p = self.profile
        wide = {
            "low": -p.position,
            "high": p.position,
            "speed": p.speed,
            "torque": p.torque,
            "kp": p.kp,
            "kd": p.kd,
        }
        return self.limits or (wide | {"rated_torque": p.torque, "budget": 1e9},) * 2

    @property
    def config(self) -> Fields:
        """Fields of the core's `Config` (`src/core.h`) by name, without profile, limits and ids."""
        lowest, idle, highest = THROTTLE_PULSES
        timing = self.timing
        safety = self.safety
        half = (highest - lowest) / 2
        full = min(1.0, safety.full_steering / load_mounting().steering_range)
        times = {
            "watchdog": timing.watchdog_timeout,
            "exit_cycle": timing.exit_cycle,
            "reminder": timing.reminder,
            "reply_wait": timing.reply_wait,
            "attitude": timing.attitude_time,
            "attitude_age": timing.attitude_age,
            "straight": timing.straight_time,
        }
        return {
            **{f"{name}_ms": round(seconds * 1000.0) for name, seconds in times.items()},
            "owns_can": self.wiring == "teensy_bridge",
            "exit_burst": timing.exit_burst,
            "exit_cycles": timing.exit_cycles,
            "attitude_limit": safety.attitude_limit,
            "full_servo": round(full * (SERVO_PULSES[2] - SERVO_PULSES[1])),
            "driving_throttle": round(safety.driving_throttle * half),
            "least_yaw_rate": safety.least_yaw_rate,
            "throttle_least": round(idle - safety.throttle_limit * (idle - lowest)),
            "throttle_most": round(idle + safety.throttle_limit * (highest - idle)),
            "throttle_start": safety.throttle_start * half,
            "throttle_rate": safety.throttle_rate * half / 1000.0,
            "sail_bits": self.sail_bits,
        }


def profile_fields(profile: FirmwareProfile) -> Fields:
    """Returns the fields of the core's `Profile` (`src/ak70.h`) by name."""
    return {
        **{name: getattr(profile, name) for name in ("position", "speed", "torque", "kp", "kd")},
        "temperature_offset": round(profile.temperature_offset),
        "short_replies": 6 in profile.reply_lengths,
        "long_replies": 8 in profile.reply_lengths,
    }


def firmware_settings(wiring: WiringName, ports: CarPorts, scenario: Scenario) -> FirmwareSettings:
    """Returns the settings for the Teensy of a car, with the limits of the scenario's tail on these
    ports and the bits of its encoder.
    """
    limits = tuple(map(motor_limits, tail_motors(scenario, ports, load_mounting()))) or None
    return FirmwareSettings(
        wiring, ports.profile, ports.motor_ids, scenario.sail_encoder.bits, limits
    )


def core_sources() -> list[Path]:
    """Returns the headers and sources of the core, in a fixed order."""
    return sorted(path for path in (SKETCH / "src").iterdir() if path.suffix in (".h", ".cpp"))


def firmware_hash() -> str:
    """Returns the SHA-256 over core and sketch, 64 hexadecimal digits, which identifies the
    firmware of a test.
    """
    digest = hashlib.sha256()
    for path in (*core_sources(), SKETCH / "aerodima_teensy.ino"):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def build_core(cache: Path | None = None) -> Path:
    """Returns the shared library of the core, compiled if it is not in the cache.

    Args:
        cache: folder of the compiled libraries; `aerodima` in the user's cache folder
            (`XDG_CACHE_HOME`) when None.

    Raises:
        HardwareError: no compiler on the path, the folder cannot be used, or the core does not
            compile.
    """
    folder = cache or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aerodima"
    key = hashlib.sha256((firmware_hash() + " ".join(_FLAGS)).encode()).hexdigest()[:16]
    library = folder / f"teensy_core_{key}.so"
    if library.exists():
        return library
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise HardwareError(
            "the firmware's core needs a C++17 compiler on the path; looked for "
            f"{', '.join(COMPILERS)}"
        )
    return write_atomically(library, partial(_compile, compiler), True, HardwareError)


def _compile(compiler: str, target: Path) -> None:
    sources = [str(path) for path in core_sources() if path.suffix == ".cpp"]
    try:
        result = subprocess.run(
            [compiler, *_FLAGS, *sources, "-o", str(target)],
            capture_output=True,
            text=True,
            timeout=_BUILD_TIME,
        )
    except subprocess.TimeoutExpired:
        raise HardwareError(
            f"{compiler}: the firmware's core was not compiled within {_BUILD_TIME:g} s"
        ) from None
    if result.returncode:
        reason = " ".join(result.stderr.split())[:500]
        raise HardwareError(f"{compiler}: the firmware's core does not compile: {reason}")


def export_sketch(settings: FirmwareSettings, folder: Path) -> Path:
    """Writes core, sketch and `config.h` into a new folder; returns the sketch, which bears the
    folder's name.

    Raises:
        HardwareError: the folder exists with something in it, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise HardwareError(
            f"{folder}: exists already and is not overwritten; choose another folder"
        )
    sketch = folder / f"{folder.resolve().name}.ino"
    try:
        (folder / "src").mkdir(parents=True, exist_ok=True)
        shutil.copy(SKETCH / "aerodima_teensy.ino", sketch)
        for path in core_sources():
            if path.name not in _HOST_ONLY:
                shutil.copy(path, folder / "src" / path.name)
        (folder / "config.h").write_text(config_header(settings), encoding="ascii")
    except OSError as error:
        raise HardwareError(
            f"{error.filename or folder}: cannot be written: {error.strerror}"
        ) from None
    return sketch


def config_header(settings: FirmwareSettings) -> str:
    """Returns the content of `config.h`: the settings as the sketch's configuration."""
    fields = {f"profile.{name}": value for name, value in profile_fields(settings.profile).items()}
    fields |= settings.config
    for index, (motor_id, limits) in enumerate(
        zip(settings.motor_ids, settings.last_limits, strict=True)
    ):
        fields[f"motor_ids[{index}]"] = motor_id
        fields |= {f"limits[{index}].{name}": value for name, value in limits.items()}
    lines = "\n".join(f"  config.{name} = {repr(value).lower()};" for name, value in fields.items())
    made_of = f"{settings.wiring}, {settings.profile.name}, firmware {firmware_hash()[:12]}"
    return (
        f"// Written by `aerodima drive firmware`: {made_of}.\n"
        '#pragma once\n#include "src/core.h"\n\n'
        f"#define AERODIMA_SAIL_BITS {settings.sail_bits}\n\n"
        f"inline aerodima::Config aerodima_config() {{\n  aerodima::Config config;\n{lines}\n  "
        "return config;\n}\n"
    )
