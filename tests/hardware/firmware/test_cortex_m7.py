"""Core and sketch on the Teensy's instruction set: compiled without a warning, and the same bits as
on the host.
"""

import sys

import pytest

from aerodima.hardware.firmware.teensy_firmware import SKETCH
from tests.hardware.firmware import cortex_m7
from tests.hardware.firmware.recorded import FUNCTIONS

LONGEST_STEP = 60_000
"""Instructions; 0.1 ms of the Teensy at 600 MHz when each takes one cycle. Its loop must pass in a
millisecond."""


@pytest.fixture(scope="module")
def sketch(tmp_path_factory):
    cortex_m7.need_tools()
    return cortex_m7.export(tmp_path_factory.mktemp("teensy") / "sketch")


def numbers(line):
    """A printed line: name, value, name, value."""
    words = line.split()
    return dict(zip(words[::2], map(int, words[1::2]), strict=True))


@pytest.mark.slow
def test_every_call_that_the_tests_make_of_the_core_gives_the_same_bits(sketch):
    calls = sketch / "calls.bin"
    cortex_m7.run(sys.executable, "-m", "tests.hardware.firmware.recorded", calls)
    lines = cortex_m7.emulate(
        cortex_m7.build("replay", sketch, SKETCH / "src"), "-icount", "shift=0"
    ).splitlines()
    calls.unlink()
    assert numbers(lines[0])["equal"] > 100_000, lines[0]
    rows = {FUNCTIONS[row["function"]]: row for row in map(numbers, lines[1:])}
    assert all(row["calls"] for row in rows.values())
    print({name: row["longest"] for name, row in rows.items()})
    assert rows["ad_core_step"]["longest"] < LONGEST_STEP


@pytest.mark.slow
def test_a_day_of_drives_over_the_end_of_the_clock(sketch):
    line = cortex_m7.emulate(cortex_m7.build("day", sketch))
    assert line == cortex_m7.on_host("day", sketch)
    counted = numbers(line)
    drives = 24 * 6
    assert counted["enters"] == 2 * drives
    assert counted["exits"] > 100 * drives
    assert {
        name for name in ("wrong_order", "not_running", "not_stopped", "rejected") if counted[name]
    } == set()
    assert counted["heap"] == 1  # what was free at the start is free at the end


@pytest.mark.slow
def test_the_sketch_does_on_the_processor_what_it_does_on_the_host(sketch):
    assert cortex_m7.emulate(cortex_m7.build("sketch_run", sketch)) == cortex_m7.on_host(
        "sketch_run", sketch
    )
