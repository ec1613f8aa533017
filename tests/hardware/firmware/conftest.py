"""The core is compiled once; without a compiler its tests are skipped."""

import shutil

import pytest

from aerodima.hardware.firmware.teensy_firmware import COMPILERS


def pytest_collection_modifyitems(items):
    if any(shutil.which(name) for name in COMPILERS):
        return
    for item in items:
        if "tests/hardware/firmware/" in item.path.as_posix():
            item.add_marker(pytest.mark.skip(reason="no C++ compiler on the path"))
