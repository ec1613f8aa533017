"""The calls that the tests make of the core, with every result, in a file that
`cortex_m7/replay.cpp` repeats.

`python -m tests.hardware.firmware.recorded FILE [pytest's words]`. The exit status is that of
pytest.
"""

import struct
import sys
from pathlib import Path

import pytest

from aerodima.hardware.firmware import teensy_firmware as build
from tests.hardware.firmware import core_functions

FUNCTIONS = (*build._FUNCTIONS, *core_functions._FUNCTIONS)
"""In the order of the numbers in `cortex_m7/replay.cpp`."""
_WRITE_TEXT = ("ad_core_take_reply", "ad_make_reply")


def _content(argument):
    if isinstance(argument, bytes):
        return argument
    if isinstance(argument, int):
        return struct.pack("<q", argument)
    return bytes(getattr(argument, "_obj", argument))


def _field(content):
    return struct.pack("<I", len(content)) + content


def recorded(function, name, stream):
    """The function, with one record in the stream per call."""

    def call(*arguments):
        stream.write(struct.pack("<BB", FUNCTIONS.index(name), len(arguments)))
        stream.write(b"".join(_field(_content(argument)) for argument in arguments))
        result = function(*arguments)
        written = [not isinstance(argument, bytes | int) for argument in arguments]
        stream.write(
            struct.pack("<qB", result or 0, sum(bit << index for index, bit in enumerate(written)))
        )
        for argument, may_be_written in zip(arguments, written, strict=True):
            if may_be_written:
                stream.write(_field(_content(argument)[: result if name in _WRITE_TEXT else None]))
        return result

    return call


class _Library:
    def __init__(self, stream):
        loaded = core_functions.library()
        for name in FUNCTIONS:
            setattr(self, name, recorded(getattr(loaded, name), name, stream))


def main():
    """Runs the tests of the core with the recorder between them and the core."""
    tests = sorted(str(path) for path in Path(__file__).parent.glob("test_core_*.py"))
    with open(sys.argv[1], "wb") as stream:
        library = _Library(stream)
        build.library = core_functions.library = lambda: library
        return int(
            pytest.main(
                ["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", *sys.argv[2:], *tests]
            )
        )


if __name__ == "__main__":
    sys.exit(main())
