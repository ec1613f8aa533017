"""The firmware's core on this computer: the C++ code of the Teensy behind ctypes."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import POINTER, Structure, c_char_p, c_double, c_int, c_int32, c_size_t, c_uint8, c_uint32, c_void_p
from dataclasses import astuple, dataclass
from functools import cache
from typing import Any

from aerodima.hardware.firmware.firmware_settings import FirmwareSettings, MotorLimits, build_core, profile_fields
from aerodima.hardware.protocol.ak70 import FirmwareProfile, MitCommand, MitReply
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorOrder,
    MotorRequest,
    StringForm,
    TeensyCommand,
    TeensyReply,
    TeensyStatus,
)

_WRAP = 1 << 32
_LONGEST = 512
_UNKNOWN_AGE = 65535


def _fields(kind: Any, names: str) -> tuple[tuple[str, Any], ...]:
    return tuple((name, kind) for name in names.split())


class _Frame(Structure):
    _fields_ = (("id", c_uint32), ("extended", c_int32), ("length", c_int32), ("data", c_uint8 * 8))


class _Profile(Structure):
    _fields_ = (
        *_fields(c_double, "position speed torque kp kd"),
        *_fields(c_int32, "temperature_offset short_replies long_replies"),
    )


class _Limits(Structure):
    _fields_ = _fields(c_double, "low high speed torque kp kd rated_torque budget")


class _Config(Structure):
    _fields_ = (
        ("profile", _Profile),
        ("limits", _Limits * 2),
        *_fields(c_double, "attitude_limit throttle_start throttle_rate"),
        *_fields(c_int32, "owns_can checked"),
        *_fields(c_uint32, "watchdog_ms exit_burst exit_cycles exit_cycle_ms reminder_ms reply_wait_ms"),
        *_fields(c_uint32, "attitude_ms attitude_age_ms"),
        ("sail_bits", c_int32),
        ("motor_ids", c_int32 * 2),
        *_fields(c_int32, "throttle_least throttle_most"),
    )


class _Order(Structure):
    _fields_ = (("values", c_double * 5), *_fields(c_int32, "motor_id request"))


class _Command(Structure):
    _fields_ = (
        ("orders", _Order * 2),
        *_fields(c_double, "roll pitch"),
        *_fields(c_int32, "servo throttle age"),
    )


class _Report(Structure):
    _fields_ = (
        *_fields(c_double, "position velocity torque"),
        *_fields(c_int32, "motor_id replies temperature fault"),
    )


class _Reply(Structure):
    _fields_ = (("reports", _Report * 2), ("sail", c_double), ("clock", c_uint32), ("status", c_int32))


class _State(Structure):
    _fields_ = (
        *_fields(c_int32, "servo throttle status"),
        ("rejected", c_uint32),
        ("load", c_double * 2),
    )


_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "ad_core_new": (c_void_p, [POINTER(_Config), c_uint32]),
    "ad_core_free": (None, [c_void_p]),
    "ad_core_feed": (None, [c_void_p, c_char_p, c_size_t, c_uint32]),
    "ad_core_receive": (None, [c_void_p, POINTER(_Frame)]),
    "ad_core_set_sail_word": (None, [c_void_p, c_uint32]),
    "ad_core_step": (None, [c_void_p, c_uint32]),
    "ad_core_next_frame": (c_int, [c_void_p, POINTER(_Frame)]),
    "ad_core_take_reply": (c_size_t, [c_void_p, c_char_p, c_size_t]),
    "ad_core_state": (None, [c_void_p, POINTER(_State)]),
    "ad_crc8": (c_uint8, [c_char_p, c_size_t]),
    "ad_decode_command": (c_int, [c_char_p, c_size_t, c_int, POINTER(_Command)]),
    "ad_make_reply": (c_size_t, [POINTER(_Reply), c_int, c_char_p, c_size_t]),
    "ad_make_command": (c_int, [c_int, POINTER(c_double), POINTER(_Profile), POINTER(_Frame)]),
    "ad_decode_reply": (c_int, [POINTER(_Frame), POINTER(_Profile), POINTER(_Report)]),
    "ad_limit": (c_int, [POINTER(_Limits), POINTER(c_double), c_size_t, POINTER(c_double), POINTER(c_double)]),
    "ad_reader_new": (c_void_p, [c_int]),
    "ad_reader_free": (None, [c_void_p]),
    "ad_reader_feed": (c_int, [c_void_p, c_char_p, c_size_t, POINTER(_Command), POINTER(c_uint32)]),
}


@cache
def library() -> Any:
    """The loaded core, compiled if need be. Raises `HardwareError` as `build_core` does."""
    loaded = ctypes.CDLL(str(build_core()))
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


@dataclass(frozen=True, slots=True)
class CoreState:
    """Outputs of the Teensy.

    Attributes:
        servo, throttle: pulses in us.
        status: whether its watchdog has acted.
        rejected: strings that could not be obeyed.
        load: I2t of the two motors, (N m)^2 s.
    """

    servo: int
    throttle: int
    status: TeensyStatus
    rejected: int
    load: tuple[float, float] = (0.0, 0.0)


class TeensyCore:
    """One Teensy without its pins; see `aerodima_teensy/src/core.h`.

    Args:
        settings: what it is built for.
        now: s on any clock that does not go back; the core counts milliseconds of it, modulo 2^32.

    Raises:
        HardwareError: the core cannot be compiled here.
    """

    def __init__(self, settings: FirmwareSettings, now: float) -> None:
        self._library = library()
        config = _Config(
            profile=_profile(settings.profile),
            limits=(_Limits * 2)(*(_Limits(*astuple(limits)) for limits in settings.last_limits)),
            motor_ids=(c_int32 * 2)(*settings.motor_ids),
            **settings.config,
        )
        self._core = self._library.ad_core_new(ctypes.byref(config), _clock(now))

    def __del__(self) -> None:
        if getattr(self, "_core", None):
            self._library.ad_core_free(self._core)

    def feed(self, data: bytes, now: float) -> None:
        """Takes bytes from the computer."""
        self._library.ad_core_feed(self._core, data, len(data), _clock(now))

    def receive(self, frame: CanFrame) -> None:
        """Takes a frame from the bus."""
        self._library.ad_core_receive(self._core, ctypes.byref(_frame(frame)))

    def set_sail_word(self, word: int) -> None:
        """Takes a reading of the sail encoder."""
        self._library.ad_core_set_sail_word(self._core, word)

    def step(self, now: float) -> None:
        """Lets the watchdog look at the clock; call it about every millisecond."""
        self._library.ad_core_step(self._core, _clock(now))

    def frames(self) -> list[CanFrame]:
        """Frames for the bus since the last call, oldest first."""
        found, frame = [], _Frame()
        while self._library.ad_core_next_frame(self._core, ctypes.byref(frame)):
            found.append(_plain(frame))
        return found

    def reply(self) -> bytes:
        """String for the computer; empty when there is none."""
        text = ctypes.create_string_buffer(_LONGEST)
        size = self._library.ad_core_take_reply(self._core, text, _LONGEST)
        return text.raw[:size]

    @property
    def state(self) -> CoreState:
        """Pulses and status as they are now."""
        state = _State()
        self._library.ad_core_state(self._core, ctypes.byref(state))
        return CoreState(
            state.servo, state.throttle, TeensyStatus(state.status), state.rejected, (state.load[0], state.load[1])
        )


class CommandReader:
    """The core's own stream of command strings, for comparison with `aerodima.hardware.devices.teensy_link`.

    Attributes:
        rejected: strings dropped since the start.
    """

    def __init__(self, form: StringForm) -> None:
        self._library = library()
        self._reader = self._library.ad_reader_new(form is StringForm.CHECKED)
        self.rejected = 0

    def __del__(self) -> None:
        if getattr(self, "_reader", None):
            self._library.ad_reader_free(self._reader)

    def feed(self, data: bytes) -> tuple[int, TeensyCommand | None]:
        """How many commands became complete with these bytes, and the newest of them."""
        command, rejected = _Command(), c_uint32()
        found = self._library.ad_reader_feed(
            self._reader, data, len(data), ctypes.byref(command), ctypes.byref(rejected)
        )
        self.rejected = rejected.value
        return found, _command(command) if found else None


def crc8(data: bytes) -> int:
    """The core's checksum; see `aerodima.hardware.protocol.teensy.crc8`."""
    return int(library().ad_crc8(data, len(data)))


def decode_command(text: bytes, form: StringForm) -> TeensyCommand:
    """The command in one whole string, read by the core; `FrameError` for anything else."""
    command = _Command()
    if not library().ad_decode_command(text, len(text), form is StringForm.CHECKED, ctypes.byref(command)):
        raise FrameError(f"the firmware refuses the Teensy command {text!r}")
    return _command(command)


def make_reply(reply: TeensyReply, form: StringForm) -> bytes:
    """The reply string as the core writes it; `FrameError` if it refuses."""
    reports = [
        _Report(
            report.position,
            report.velocity,
            report.torque,
            report.motor_id,
            report.replies or 0,
            report.temperature or 0,
            report.fault or 0,
        )
        for report in reply.motors
    ]
    status = int(reply.status or TeensyStatus.RUNNING)
    content = _Reply((_Report * 2)(*reports), reply.sail, reply.clock or 0, status)
    text = ctypes.create_string_buffer(_LONGEST)
    size = library().ad_make_reply(ctypes.byref(content), form is StringForm.CHECKED, text, _LONGEST)
    if not size:
        raise FrameError(f"the firmware refuses the reply {reply}")
    return text.raw[:size]


def make_command(motor_id: int, command: MitCommand, profile: FirmwareProfile) -> CanFrame:
    """The frame of a command as the core makes it; `FrameError` if it refuses."""
    frame, values = _Frame(), (c_double * 5)(*astuple(command))
    if not library().ad_make_command(motor_id, values, ctypes.byref(_profile(profile)), ctypes.byref(frame)):
        raise FrameError(f"the firmware refuses {command} for motor {motor_id}")
    return _plain(frame)


def decode_reply(frame: CanFrame, profile: FirmwareProfile) -> MitReply:
    """The state in a motor's reply as the core reads it; `FrameError` if it refuses."""
    report = _Report()
    if not library().ad_decode_reply(
        ctypes.byref(_frame(frame)), ctypes.byref(_profile(profile)), ctypes.byref(report)
    ):
        raise FrameError(f"the firmware refuses the reply {frame}")
    health = (float(report.temperature), report.fault) if report.replies else (None, None)
    return MitReply(report.motor_id, report.position, report.velocity, report.torque, *health)


def limit_command(
    command: MitCommand, replies: Sequence[tuple[float, float, float, float]], limits: MotorLimits
) -> MitCommand:
    """What the core leaves of a command after replies (position, velocity, torque, time in s)."""
    flat = [value for *state, when in replies for value in (*state, 1000.0 * when)]
    limited = (c_double * 5)()
    library().ad_limit(
        ctypes.byref(_Limits(*astuple(limits))),
        (c_double * len(flat))(*flat),
        len(replies),
        (c_double * 5)(*astuple(command)),
        limited,
    )
    return MitCommand(*limited)


def _clock(now: float) -> int:
    return int(now * 1000.0) % _WRAP


def _profile(profile: FirmwareProfile) -> _Profile:
    return _Profile(**profile_fields(profile))


def _frame(frame: CanFrame) -> _Frame:
    data = (c_uint8 * 8)(*frame.data)
    return _Frame(frame.arbitration_id, frame.extended, len(frame.data), data)


def _plain(frame: _Frame) -> CanFrame:
    return CanFrame(frame.id, bytes(frame.data[: frame.length]), bool(frame.extended))


def _command(command: _Command) -> TeensyCommand:
    first, second = (
        MotorOrder(order.motor_id, MotorRequest(order.request), MitCommand(*order.values)) for order in command.orders
    )
    known = command.age != _UNKNOWN_AGE
    attitude = Attitude(command.roll, command.pitch, command.age) if known else None
    return TeensyCommand((first, second), command.servo, command.throttle, attitude)
