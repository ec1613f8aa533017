"""The core under the sanitisers of addresses and undefined behaviour: its tests and fuzzed inputs
once more.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from aerodima.hardware.firmware import teensy_firmware as build


def address_sanitiser():
    """The library that must be loaded before Python; skips where this compiler has none."""
    if shutil.which("g++") is None:
        pytest.skip("no g++ on the path")
    name = ["g++", "-print-file-name=libasan.so"]
    path = Path(subprocess.run(name, capture_output=True, text=True, check=True).stdout.strip())
    if not path.is_absolute():
        pytest.skip("g++ has no address sanitiser (libasan)")
    return path.resolve()


def run_sanitised(sketch):
    environment = {
        **os.environ,
        "LD_PRELOAD": str(address_sanitiser()),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own are not ours
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    command = [sys.executable, "-m", "tests.hardware.firmware.sanitised", str(sketch)]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=550)
    return result.returncode, result.stdout + result.stderr


@pytest.mark.slow
def test_every_test_of_the_core_passes_under_the_sanitisers():
    status, output = run_sanitised(build.SKETCH)
    assert status == 0, output[-3000:]
