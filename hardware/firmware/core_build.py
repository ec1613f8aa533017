"""Compiles the firmware's core for this computer, once per content of its sources."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

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
