"""The firmware's sources: compiled for this computer, once per content, and as a folder for the Arduino IDE."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

from aerodima.hardware.firmware.firmware_settings import FirmwareSettings, milliseconds
from aerodima.hardware.protocol.teensy import StringForm
from aerodima.workbench.atomic_write import make_folder
from aerodima.workbench.errors import HardwareError

SKETCH = Path(__file__).resolve().parent / "aerodima_teensy"
"""The Arduino sketch; its folder `src` is the core."""
COMPILERS = ("g++", "c++", "clang++")
_FLAGS = ("-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC")
_BUILD_TIME = 120.0


def core_sources() -> list[Path]:
    """Headers and sources of the core, in a fixed order."""
    return sorted(path for path in (SKETCH / "src").iterdir() if path.suffix in (".h", ".cpp"))


def firmware_hash() -> str:
    """SHA-256 over core and sketch: which firmware a watchdog test was made with. 64 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in (*core_sources(), SKETCH / "aerodima_teensy.ino"):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def build_core(cache: Path | None = None) -> Path:
    """The shared library of the core, compiled if it is not in the cache.

    Args:
        cache: folder of the libraries; `aerodima` in the user's cache folder (`XDG_CACHE_HOME`) when None.

    Raises:
        HardwareError: no compiler on the path, the folder cannot be used, or the core does not compile.
    """
    folder = cache or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "aerodima"
    key = hashlib.sha256((firmware_hash() + " ".join(_FLAGS)).encode()).hexdigest()[:16]
    library = folder / f"teensy_core_{key}.so"
    if library.exists():
        return library
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        raise HardwareError(
            f"the firmware's core needs a C++17 compiler on the path; looked for {', '.join(COMPILERS)}"
        )
    unfinished = folder / f".{library.name}.{os.getpid()}"
    make_folder(folder, HardwareError)
    try:
        _compile(compiler, unfinished)
        os.replace(unfinished, library)
    except OSError as error:
        raise HardwareError(f"{folder}: cannot be used to build the firmware: {error.strerror}") from None
    finally:
        unfinished.unlink(missing_ok=True)
    return library


def _compile(compiler: str, target: Path) -> None:
    sources = [str(path) for path in core_sources() if path.suffix == ".cpp"]
    try:
        result = subprocess.run(
            [compiler, *_FLAGS, *sources, "-o", str(target)], capture_output=True, text=True, timeout=_BUILD_TIME
        )
    except subprocess.TimeoutExpired:
        raise HardwareError(f"{compiler}: the firmware's core was not compiled within {_BUILD_TIME:g} s") from None
    if result.returncode:
        reason = " ".join(result.stderr.split())[:500]
        raise HardwareError(f"{compiler}: the firmware's core does not compile: {reason}")


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
