"""The pure functions of the firmware's core behind ctypes, for comparison with Python and for the
fake Teensy.
"""

import ctypes
from ctypes import (
    POINTER,
    Structure,
    c_char_p,
    c_double,
    c_int,
    c_int32,
    c_size_t,
    c_uint8,
    c_uint32,
    c_void_p,
)
from dataclasses import astuple
from functools import cache

from aerodima.hardware.firmware import teensy_core
from aerodima.hardware.firmware.teensy_core import Frame, Limits, Profile, fields, to_core, to_plain
from aerodima.hardware.firmware.teensy_firmware import profile_fields
from aerodima.hardware.protocol.ak70 import MitCommand, MitReply
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorOrder,
    MotorRequest,
    TeensyCommand,
)

_LONGEST = 512
_UNKNOWN_AGE = 65535


class _Order(Structure):
    _fields_ = (("values", c_double * 5), *fields(c_int32, "motor_id request"))


class _Command(Structure):
    _fields_ = (
        ("orders", _Order * 2),
        *fields(c_double, "roll pitch lean yaw_rate"),
        *fields(c_int32, "servo throttle age"),
    )


class _Report(Structure):
    _fields_ = (
        *fields(c_double, "position velocity torque"),
        *fields(c_int32, "motor_id replies temperature fault"),
    )


class _Reply(Structure):
    _fields_ = (
        ("reports", _Report * 2),
        ("sail", c_double),
        ("clock", c_uint32),
        ("status", c_int32),
    )


_FUNCTIONS = {
    "ad_crc8": (c_uint8, [c_char_p, c_size_t]),
    "ad_decode_command": (c_int, [c_char_p, c_size_t, POINTER(_Command)]),
    "ad_make_reply": (c_size_t, [POINTER(_Reply), c_char_p, c_size_t]),
    "ad_make_command": (c_int, [c_int, POINTER(c_double), POINTER(Profile), POINTER(Frame)]),
    "ad_decode_reply": (c_int, [POINTER(Frame), POINTER(Profile), POINTER(_Report)]),
    "ad_limit": (
        c_int,
        [POINTER(Limits), POINTER(c_double), c_size_t, POINTER(c_double), POINTER(c_double)],
    ),
    "ad_reader_new": (c_void_p, []),
    "ad_reader_free": (None, [c_void_p]),
    "ad_reader_feed": (c_int, [c_void_p, c_char_p, c_size_t, POINTER(_Command), POINTER(c_uint32)]),
}


@cache
def library():
    loaded = teensy_core.library()
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(loaded, name)
        function.restype = result
        function.argtypes = arguments
    return loaded


class CommandReader:
    """The core's own stream of command strings, for the fake Teensy and its own tests.

    Attributes:
        rejected: strings dropped since the start.
    """

    def __init__(self):
        self._library = library()
        self._reader = self._library.ad_reader_new()
        self.rejected = 0

    def __del__(self):
        if getattr(self, "_reader", None):
            self._library.ad_reader_free(self._reader)

    def feed(self, data):
        """How many commands became complete with these bytes, and the newest of them."""
        command = _Command()
        rejected = c_uint32()
        found = self._library.ad_reader_feed(
            self._reader, data, len(data), ctypes.byref(command), ctypes.byref(rejected)
        )
        self.rejected = rejected.value
        return found, _command(command) if found else None


def crc8(data):
    """The core's checksum; see `aerodima.hardware.protocol.teensy.crc8`."""
    return int(library().ad_crc8(data, len(data)))


def decode_command(text):
    """The command in one whole string, read by the core; `FrameError` for anything else."""
    command = _Command()
    if not library().ad_decode_command(text, len(text), ctypes.byref(command)):
        raise FrameError(f"the firmware refuses the Teensy command {text!r}")
    return _command(command)


def make_reply(reply):
    """The reply string as the core writes it; `FrameError` if it refuses."""
    reports = [
        _Report(
            state.position,
            state.velocity,
            state.torque,
            state.motor_id,
            report.replies,
            int(state.temperature or 0),
            -1 if state.fault is None else state.fault,
        )
        for report in reply.motors
        for state in (report.state,)
    ]
    content = _Reply((_Report * 2)(*reports), reply.sail, reply.clock, int(reply.status))
    text = ctypes.create_string_buffer(_LONGEST)
    size = library().ad_make_reply(ctypes.byref(content), text, _LONGEST)
    if not size:
        raise FrameError(f"the firmware refuses the reply {reply}")
    return text.raw[:size]


def make_command(motor_id, command, profile):
    """The frame of a command as the core makes it; `FrameError` if it refuses."""
    frame = Frame()
    values = (c_double * 5)(*astuple(command))
    if not library().ad_make_command(
        motor_id, values, ctypes.byref(Profile(**profile_fields(profile))), ctypes.byref(frame)
    ):
        raise FrameError(f"the firmware refuses {command} for motor {motor_id}")
    return to_plain(frame)


def decode_reply(frame, profile):
    """The state in a motor's reply as the core reads it; `FrameError` if it refuses."""
    report = _Report()
    if not library().ad_decode_reply(
        ctypes.byref(to_core(frame)),
        ctypes.byref(Profile(**profile_fields(profile))),
        ctypes.byref(report),
    ):
        raise FrameError(f"the firmware refuses the reply {frame}")
    health = (float(report.temperature), report.fault) if report.replies else (None, None)
    return MitReply(report.motor_id, report.position, report.velocity, report.torque, *health)


def limit_command(
    command,
    replies,
    limits,
):
    """What the core leaves of a command after replies (position, velocity, torque, time in s)."""
    flat = [value for *state, when in replies for value in (*state, 1000.0 * when)]
    limited = (c_double * 5)()
    library().ad_limit(
        ctypes.byref(Limits(**limits)),
        (c_double * len(flat))(*flat),
        len(replies),
        (c_double * 5)(*astuple(command)),
        limited,
    )
    return MitCommand(*limited)


def _command(command):
    first, second = (
        MotorOrder(order.motor_id, MotorRequest(order.request), MitCommand(*order.values))
        for order in command.orders
    )
    known = command.age != _UNKNOWN_AGE
    values = (command.roll, command.pitch, command.age, command.lean, command.yaw_rate)
    attitude = Attitude(*values) if known else None
    return TeensyCommand((first, second), command.servo, command.throttle, attitude)
