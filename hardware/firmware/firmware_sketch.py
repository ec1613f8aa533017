"""The firmware's sources: compiled for this computer, once per content, and as a folder for the Arduino IDE."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

from aerodima.hardware.firmware.firmware_settings import FirmwareSettings, profile_fields
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
    fields = {f"profile.{name}": value for name, value in profile_fields(settings.profile).items()}
    fields |= settings.config
    for index, (motor_id, limits) in enumerate(zip(settings.motor_ids, settings.last_limits, strict=True)):
        fields[f"motor_ids[{index}]"] = motor_id
        fields |= {f"limits[{index}].{name}": value for name, value in asdict(limits).items()}
    lines = "\n".join(f"  config.{name} = {repr(value).lower()};" for name, value in fields.items())
    made_of = f"{settings.wiring}, {settings.profile.name}, firmware {firmware_hash()[:12]}"
    return (
        f"// Written by `aerodima firmware`: {made_of}.\n"
        '#pragma once\n#include "src/core.h"\n\n'
        f"#define AERODIMA_SAIL_BITS {settings.encoder.bits}\n\n"
        f"inline aerodima::Config aerodima_config() {{\n  aerodima::Config config;\n{lines}\n  return config;\n}}\n"
    )
