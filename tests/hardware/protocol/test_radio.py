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
from aerodima.workbench.config.signal_table import STATUS_SOURCES

COMMAND = OperatorCommand(
    RadioMode.MANUAL, throttle=0.5, steering=-0.25, pitch_tail=1.0, roll_tail=-1.5
)


def test_command_is_eighteen_bytes_little_endian():
    expected = "01 01 0000003F 000080BE 0000803F 0000C0BF"
    assert make_command(COMMAND) == bytes.fromhex(expected.replace(" ", ""))
    assert decode(make_command(COMMAND)) == COMMAND


def test_report_has_a_code_for_every_source_and_its_layout_is_that_of_its_class():
    message = (
        "another number of STATUS_SOURCES is another radio report: change FAULT_CODES and "
        "take the next REPORT_CLASS"
    )
    assert len(STATUS_SOURCES) == FAULT_CODES, message
    report = make_report(CarReport(armed=False, stopped=False, mode=RadioMode.IDLE))
    assert (REPORT_CLASS, len(report)) == (4, 43), message


def test_heartbeat_and_stop_have_their_own_class():
    assert make_heartbeat(7) == bytes([2, 7]) + bytes(16)
    assert make_heartbeat(256 + 7) == make_heartbeat(7)
    assert decode(make_heartbeat(255)) == Heartbeat(255)
    assert make_emergency_stop() == bytes([3]) + bytes(17)
    assert decode(make_emergency_stop()) == EmergencyStop()


def test_stop_is_obeyed_whatever_else_the_frame_says():
    assert decode(bytes([3]) + b"\xff" * 17) == EmergencyStop()


def test_native_alignment_is_refused_by_name():
    native = struct.pack("@BBffff", 1, 1, 0.5, -0.25, 1.0, -1.5)
    assert len(native) == 20
    with pytest.raises(FrameError, match="native alignment"):
        decode(native)


@pytest.mark.parametrize("length", [0, 1, 17, 19, 21])
def test_other_lengths_are_refused(length):
    with pytest.raises(FrameError, match=f"{length} bytes"):
        decode(bytes([1]) * length)


@pytest.mark.parametrize("message_class", [0, 4, 255])
def test_unknown_class_is_refused(message_class):
    with pytest.raises(
        FrameError, match=f"radio class {message_class}; allowed: 1 .command., 2 .heartbeat."
    ):
        decode(bytes([message_class]) + bytes(17))


def test_unknown_mode_is_refused():
    with pytest.raises(FrameError, match="radio mode 4"):
        decode(bytes([1, 4]) + bytes(16))


@pytest.mark.parametrize("field", range(4))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 4.0, -4.0])
def test_nan_and_out_of_range_are_refused_on_both_sides(field, value):
    values = [0.0] * 4
    values[field] = value
    with pytest.raises(FrameError, match="allowed is"):
        make_command(OperatorCommand(RadioMode.MANUAL, *values))
    with pytest.raises(FrameError, match="allowed is"):
        decode(struct.pack("<BBffff", 1, 1, *values))


def test_other_byte_order_is_refused():
    with pytest.raises(FrameError):
        decode(struct.pack(">BBffff", 1, 1, 0.5, -0.25, 1.0, -1.5))


def test_limits_survive_the_rounding_to_32_bits():
    limits = OperatorCommand(RadioMode.AUTO, 1.0, math.pi, -math.pi, math.pi)
    assert decode(make_command(limits)).steering == pytest.approx(math.pi, abs=1e-6)


def test_heartbeat_with_values_is_refused():
    with pytest.raises(FrameError, match="heartbeat carries values"):
        decode(struct.pack("<BBffff", 2, 1, 0.5, 0, 0, 0))
