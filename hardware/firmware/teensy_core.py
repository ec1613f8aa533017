"""The firmware's C++ core on this computer, called by ctypes."""

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
from functools import cache
from typing import Any

from aerodima.hardware.firmware.teensy_firmware import FirmwareSettings, build_core, profile_fields
from aerodima.hardware.protocol.can_frame import CanFrame

_WRAP = 1 << 32
"""Number of milliseconds after which the Teensy's clock starts again from 0."""
_MAX_REPLY = 512
"""Room for the text frame of a reply, bytes."""


def fields(kind: Any, names: str) -> tuple[tuple[str, Any], ...]:
    """Returns fields of one type for a structure of `c_interface.h`; blanks separate the names."""
    return tuple((name, kind) for name in names.split())


class Frame(Structure):
    """CAN frame as the structure `ad_frame`."""

    _fields_ = (("id", c_uint32), ("extended", c_int32), ("length", c_int32), ("data", c_uint8 * 8))


class Profile(Structure):
    """Firmware profile as the structure `ad_profile`."""

    _fields_ = (
        *fields(c_double, "position speed torque kp kd"),
        *fields(c_int32, "temperature_offset short_replies long_replies"),
    )


class Limits(Structure):
    """Limits of one motor as the structure `ad_limits`."""

    _fields_ = fields(c_double, "low high speed torque kp kd rated_torque budget")


class _Config(Structure):
    _fields_ = (
        ("profile", Profile),
        ("limits", Limits * 2),
        *fields(c_double, "attitude_limit throttle_start throttle_rate least_yaw_rate"),
        ("owns_can", c_int32),
        *fields(
            c_uint32, "watchdog_ms exit_burst exit_cycles exit_cycle_ms reminder_ms reply_wait_ms"
        ),
        *fields(c_uint32, "attitude_ms attitude_age_ms straight_ms"),
        ("sail_bits", c_int32),
        ("motor_ids", c_int32 * 2),
        *fields(c_int32, "throttle_least throttle_most full_servo driving_throttle"),
    )


class CoreState(Structure):
    """Outputs of the Teensy as the structure `ad_state`.

    Attributes:
        servo: pulse of the servo, us.
        throttle: pulse of the throttle, us.
        status: value of `TeensyStatus`, which says whether the watchdog has acted.
        rejected: number of text frames that could not be obeyed.
    """

    _fields_ = (*fields(c_int32, "servo throttle status"), ("rejected", c_uint32))


_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "ad_core_new": (c_void_p, [POINTER(_Config), c_uint32]),
    "ad_core_free": (None, [c_void_p]),
    "ad_core_feed": (None, [c_void_p, c_char_p, c_size_t, c_uint32]),
    "ad_core_receive": (None, [c_void_p, POINTER(Frame)]),
    "ad_core_set_sail_word": (None, [c_void_p, c_uint32]),
    "ad_core_step": (None, [c_void_p, c_uint32]),
    "ad_core_next_frame": (c_int, [c_void_p, POINTER(Frame)]),
    "ad_core_take_reply": (c_size_t, [c_void_p, c_char_p, c_size_t]),
    "ad_core_state": (None, [c_void_p, POINTER(CoreState)]),
}


@cache
def library() -> Any:
    """Loads the core, compiled if need be. Raises `HardwareError` as `build_core` does."""
    loaded = ctypes.CDLL(str(build_core()))
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(loaded, name)
        function.restype = result
        function.argtypes = arguments
    return loaded


class TeensyCore:
    """One Teensy without its pins; see `aerodima_teensy/src/core.h`.

    Args:
        settings: settings for which the Teensy is built.
        now: time on any clock that does not go back, s; the core counts its milliseconds modulo
            2^32.

    Raises:
        HardwareError: the core cannot be compiled here.
    """

    def __init__(self, settings: FirmwareSettings, now: float) -> None:
        self._library = library()
        config = _Config(
            profile=Profile(**profile_fields(settings.profile)),
            limits=(Limits * 2)(*(Limits(**limits) for limits in settings.last_limits)),
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
        self._library.ad_core_receive(self._core, ctypes.byref(to_core(frame)))

    def set_sail_word(self, word: int) -> None:
        """Takes a reading of the sail encoder."""
        self._library.ad_core_set_sail_word(self._core, word)

    def step(self, now: float) -> None:
        """Lets the watchdog look at the clock; call it about every millisecond."""
        self._library.ad_core_step(self._core, _clock(now))

    def frames(self) -> list[CanFrame]:
        """Returns frames for the bus since the last call, oldest first."""
        frames = []
        frame = Frame()
        while self._library.ad_core_next_frame(self._core, ctypes.byref(frame)):
            frames.append(to_plain(frame))
        return frames

    def reply(self) -> bytes:
        """Returns the text frame for the computer; empty when there is none."""
        text = ctypes.create_string_buffer(_MAX_REPLY)
        size = self._library.ad_core_take_reply(self._core, text, _MAX_REPLY)
        return text.raw[:size]

    @property
    def state(self) -> CoreState:
        """Pulses and status as they are now."""
        state = CoreState()
        self._library.ad_core_state(self._core, ctypes.byref(state))
        return state


def _clock(now: float) -> int:
    return int(now * 1000.0) % _WRAP


def to_core(frame: CanFrame) -> Frame:
    """Converts a frame to what the core takes."""
    return Frame(frame.arbitration_id, frame.extended, len(frame.data), (c_uint8 * 8)(*frame.data))


def to_plain(frame: Frame) -> CanFrame:
    """Converts a frame that the core has made."""
    return CanFrame(frame.id, bytes(frame.data[: frame.length]), bool(frame.extended))
