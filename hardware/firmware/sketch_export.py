"""The sketch as a folder for the Arduino IDE, with `config.h` made of the project's parameters."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path

from aerodima.hardware.car.firmware_settings import FirmwareSettings, milliseconds
from aerodima.hardware.firmware.core_build import SKETCH, core_sources, firmware_hash
from aerodima.hardware.protocol.teensy import StringForm
from aerodima.workbench.errors import HardwareError

_HOST_ONLY = ("c_interface.h", "c_interface.cpp")


def export_sketch(settings: FirmwareSettings, folder: Path) -> Path:
    """Writes core, sketch and `config.h` into a new folder; returns the sketch, which bears the folder's name.

    Raises:
        HardwareError: the folder exists with something in it, or cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise HardwareError(f"{folder}: exists already and is not overwritten; choose another folder")
    sketch = folder / f"{folder.resolve().name}.ino"
    try:
        (folder / "src").mkdir(parents=True, exist_ok=True)
        shutil.copy(SKETCH / "aerodima_teensy.ino", sketch)
        for path in core_sources():
            if path.name not in _HOST_ONLY:
                shutil.copy(path, folder / "src" / path.name)
        (folder / "config.h").write_text(config_header(settings), encoding="ascii")
    except OSError as error:
        raise HardwareError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None
    return sketch


def config_header(settings: FirmwareSettings) -> str:
    """Content of `config.h`: the settings as the sketch's configuration."""
    timing, profile = settings.timing, settings.profile
    least, most, start, rate = settings.throttle_pulses
    assignments = {
        "owns_can": _flag(settings.owns_can),
        "watches_bus": _flag(settings.watches_bus),
        "checked": _flag(settings.form is StringForm.CHECKED),
        "profile.position": repr(profile.position),
        "profile.speed": repr(profile.speed),
        "profile.torque": repr(profile.torque),
        "profile.kp": repr(profile.kp),
        "profile.kd": repr(profile.kd),
        "profile.temperature_offset": round(profile.temperature_offset),
        "profile.short_replies": _flag(6 in profile.reply_lengths),
        "profile.long_replies": _flag(8 in profile.reply_lengths),
        "watchdog_ms": milliseconds(timing.watchdog_timeout),
        "exit_burst": timing.exit_burst,
        "exit_cycles": timing.exit_cycles,
        "exit_cycle_ms": milliseconds(timing.exit_cycle),
        "reminder_ms": milliseconds(timing.reminder),
        "reply_wait_ms": milliseconds(timing.reply_wait),
        "attitude_limit": repr(settings.safety.attitude_limit),
        "attitude_ms": milliseconds(timing.attitude_time),
        "attitude_age_ms": milliseconds(timing.attitude_age),
        "throttle_least": least,
        "throttle_most": most,
        "throttle_start": repr(start),
        "throttle_rate": repr(rate),
        "sail_bits": settings.encoder.bits,
        "motor_ids[0]": settings.motor_ids[0],
        "motor_ids[1]": settings.motor_ids[1],
    }
    for index, limits in enumerate(settings.last_limits):
        assignments |= {f"limits[{index}].{name}": repr(value) for name, value in asdict(limits).items()}
    lines = "\n".join(f"  config.{name} = {value};" for name, value in assignments.items())
    return (
        f"// Written by `aerodima firmware`: {settings.wiring}, {profile.name}, firmware {firmware_hash()[:12]}.\n"
        '#pragma once\n#include "src/core.h"\n\n'
        f"#define AERODIMA_ON_BUS {int(settings.owns_can or settings.watches_bus)}\n"
        f"#define AERODIMA_SAIL_BITS {settings.encoder.bits}\n\n"
        f"inline aerodima::Config aerodima_config() {{\n  aerodima::Config config;\n{lines}\n  return config;\n}}\n"
    )


def _flag(value: bool) -> str:
    return "true" if value else "false"
