"""Radio frames: packed to the byte, the other alignment refused, the heartbeat alive only while it
changes.
"""

import math
import struct

import pytest

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.radio import (
    FAULT_CODES,
    REPORT_CLASS,
    CarReport,
    EmergencyStop,
    Heartbeat,
    OperatorCommand,
    RadioMode,
    decode,
    make_command,
    make_emergency_stop,
    make_heartbeat,
    make_report,
)
from aerodima.workbench.scenario.signal_table import STATUS_SOURCES
from tests.refusals import assert_refused

COMMAND = OperatorCommand(
    RadioMode.MANUAL, throttle=0.5, steering=-0.25, pitch_tail=1.0, roll_tail=-1.5
)


def test_command_is_eighteen_bytes_little_endian():
    expected = "01 01 0000003F 000080BE 0000803F 0000C0BF"
    assert make_command(COMMAND) == bytes.fromhex(expected.replace(" ", ""))
    assert decode(make_command(COMMAND)) == COMMAND


def test_report_has_a_code_for_every_source_and_its_layout_is_that_of_its_class():
    report = make_report(CarReport(armed=False, stopped=False, mode=RadioMode.IDLE))
    assert (len(STATUS_SOURCES), REPORT_CLASS, len(report)) == (FAULT_CODES, 4, 43), (
        "another number of STATUS_SOURCES is another radio report: take the next REPORT_CLASS"
    )


def test_heartbeat_and_stop_have_their_own_class():
    assert make_heartbeat(7) == bytes([2, 7]) + bytes(16)
    assert make_heartbeat(256 + 7) == make_heartbeat(7)
    assert decode(make_heartbeat(255)) == Heartbeat(255)
    assert make_emergency_stop() == bytes([3]) + bytes(17)
    assert decode(make_emergency_stop()) == EmergencyStop()


def test_stop_is_obeyed_whatever_else_the_frame_says():
    assert decode(bytes([3]) + b"\xff" * 17) == EmergencyStop()


@pytest.mark.parametrize("field", range(4))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 4.0, -4.0])
def test_nan_and_out_of_range_are_refused_on_both_sides(field, value):
    values = [0.0] * 4
    values[field] = value
    command = OperatorCommand(RadioMode.MANUAL, *values)
    assert_refused(lambda: make_command(command), FrameError, str(value))
    assert_refused(lambda: decode(struct.pack("<BBffff", 1, 1, *values)), FrameError, str(value))


VALUES = (1, 1, 0.5, -0.25, 1.0, -1.5)
REFUSED = [
    (struct.pack("@BBffff", *VALUES), "20"),
    (struct.pack(">BBffff", *VALUES), ""),
    (struct.pack("<BBffff", 2, 1, 0.5, 0, 0, 0), ""),
    (bytes([1, 4]) + bytes(16), "4"),
    *((bytes([1]) * length, str(length)) for length in (0, 1, 17, 19, 21)),
    *((bytes([number]) + bytes(17), str(number)) for number in (0, 4, 255)),
]


@pytest.mark.parametrize(("data", "named"), REFUSED)
def test_what_is_no_radio_frame_is_refused(data, named):
    assert_refused(lambda: decode(data), FrameError, named)


def test_limits_survive_the_rounding_to_32_bits():
    limits = OperatorCommand(RadioMode.AUTO, 1.0, math.pi, -math.pi, math.pi)
    assert decode(make_command(limits)).steering == pytest.approx(math.pi, abs=1e-6)
