"""The core's tests on a core that ends the process at the first wrong access or undefined
operation.

`python -m tests.hardware.firmware.sanitised SKETCH [pytest's words]`, with the address sanitiser's
library in LD_PRELOAD, as `test_sanitised.py` starts it. The exit status is that of pytest, or the
sanitiser's.
"""

import sys
from pathlib import Path

import pytest

from aerodima.hardware.firmware import teensy_firmware as build

FLAGS = (
    "-g",
    "-fno-omit-frame-pointer",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
)


def main():
    """Points the build to the sketch and the sanitisers, and runs the tests of this folder."""
    build.SKETCH = Path(sys.argv[1])
    build._FLAGS = (*build._FLAGS, *FLAGS)
    tests = sorted(str(path) for path in Path(__file__).parent.glob("test_core_*.py"))
    return int(
        pytest.main(
            ["-q", "-x", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", *sys.argv[2:], *tests]
        )
    )


if __name__ == "__main__":
    sys.exit(main())
