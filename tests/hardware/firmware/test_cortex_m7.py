"""Core and sketch on the Teensy's instruction set: compiled without a warning, and the same bits as
on the host.
"""

import pytest

from tests.hardware.firmware import cortex_m7

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


@pytest.mark.nightly
def test_a_day_of_drives_over_the_end_of_the_clock(sketch):
    image = cortex_m7.build("day", sketch)
    line, longest = cortex_m7.emulate(image, "-icount", "shift=0").splitlines()
    assert line == cortex_m7.on_host("day", sketch).splitlines()[0]
    assert 0 < numbers(longest)["longest_step"] < LONGEST_STEP
    counted = numbers(line)
    drives = 24 * 6
    assert counted["enters"] == 2 * drives
    assert counted["exits"] > 100 * drives
    assert {
        name for name in ("wrong_order", "not_running", "not_stopped", "rejected") if counted[name]
    } == set()
    assert counted["heap"] == 1  # what was free at the start is free at the end


@pytest.mark.nightly
def test_the_sketch_does_on_the_processor_what_it_does_on_the_host(sketch):
    assert cortex_m7.emulate(cortex_m7.build("sketch_run", sketch)) == cortex_m7.on_host(
        "sketch_run", sketch
    )
