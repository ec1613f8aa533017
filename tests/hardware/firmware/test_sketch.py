"""The sketch on a model of the Teensy: a bus that is late, does not acknowledge or is off, and a
clock that stands.
"""

import shutil

import pytest

from tests.hardware.firmware import cortex_m7

STOPPED = ("orders_exit", "enters_again", "dies")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    if shutil.which("g++") is None:
        pytest.skip("no g++ on the path")
    folder = cortex_m7.export(tmp_path_factory.mktemp("sketch") / "sketch")
    rows = (line.split() for line in cortex_m7.on_host("sketch_run", folder).splitlines())
    return {name: dict(zip(words[::2], words[1::2], strict=True)) for name, *words in rows}


@pytest.mark.slow
def test_no_old_order_reaches_the_bus_and_no_exit_is_overtaken(runs):
    assert len(runs) == 16
    for name, row in runs.items():
        assert int(row["oldest_ms"]) < 20, name
        assert (row["late_enters"], row["overtaken"]) == ("0", "0"), name
        assert int(row["enters"]) == 2, name


def test_exit_frames_go_out_first_when_the_bus_is_back(runs):
    back = [
        row
        for name, row in runs.items()
        if name.startswith(("others", "unack", "bus_off")) and name.endswith(STOPPED)
    ]
    assert len(back) == 7
    for row in back:
        assert 0 <= int(row["exits_after_end_ms"]) <= 2
    for name in ("others_goes_on", "unacknowledged_goes_on", "bus_off_goes_on"):
        assert int(runs[name]["frames"]) > 200  # the young ones go on


def test_the_end_of_millis_and_micros_changes_nothing(runs):
    assert runs["millis_over"]["hash"] == runs["micros_over"]["hash"] == runs["nothing"]["hash"]
    assert runs["dies_millis_over"]["hash"] == runs["dies"]["hash"]
    assert 150 <= int(runs["dies"]["exits_ms"]) - 10 < 155
    for row in ("millis_over", "micros_over"):
        assert abs(int(runs[row]["encoder_reads"]) - 1400) <= 1  # at 1 kHz


def test_a_clock_that_stands_restarts_the_teensy(runs):
    row = runs["clock_stands"]
    assert int(row["resets"]) >= 2
    assert int(row["exits_ms"]) <= 505
    assert int(row["neutral_ms"]) <= 505
