"""BNO055 over its UART: registers, requests, answers, and the chip's side of them for emulators.

Bosch BST-BNO055-DS000, sections 4.3 (registers), 4.7 (UART: 115200 bit/s, 8N1) and 3.6.5 (units). A
request is `AA`, 01 to read or 00 to write, the register, a length and what is written. The answer
is `BB`, the length and the data, or `EE` and a code. There is no checksum: a sample is believed
only if its quaternion has the length that it must have, its gravity is the earth's and points where
the quaternion says, and its gyro is within its range; a damaged rate or acceleration of plausible
size is not recognised.

The attitude is taken from the quaternion: the sign of the chip's Euler angles depends on a setting.
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from aerodima.hardware.protocol.can_frame import FrameError, check_field
from aerodima.workbench.core.quantity import STANDARD_GRAVITY

RATE = 100.0
"""Rate of the fusion, Hz (data sheet table 3-14)."""
CHIP_ID = 0xA0
"""Content of register 0 (data sheet section 4.3.1)."""
_START = 0xAA
"""First byte of a request."""
_DATA = 0xBB
"""First byte of an answer with data."""
_STATUS = 0xEE
"""First byte of an answer with a status code."""
_WRITE = 0x00
"""Second byte of a request that writes."""
_READ = 0x01
"""Second byte of a request that reads."""
_MAX_DATA = 128
"""Largest number of bytes that one request reads or writes."""
RADIANS = 0x06
"""Content of the register UNITS for m/s2, rad/s, rad, degrees Celsius."""
WRITE_DONE = 0x01
"""Status code of a write that was carried out."""
_STATUS_CODES = range(0x01, 0x0B)
"""Codes behind `EE`: write done, then nine kinds of failure (data sheet table 4-2, UART
protocol)."""
_SAMPLE = struct.Struct("<3h6x4h3h3hxB")
"""Layout of a sample: gyro, Euler angles that nobody reads, quaternion, acceleration, gravity, a
temperature that nobody reads, calibration."""
_GYRO = 900.0
"""Counts of the gyro per rad/s."""
_QUATERNION = 16384.0
"""Counts of a component of the quaternion per 1."""
_ACCELERATION = 100.0
"""Counts of linear acceleration and gravity per m/s2."""
_NORM_TOLERANCE = 0.01
"""Largest distance of the length of a quaternion from 1."""
_GRAVITY_TOLERANCE = 0.5
"""Largest distance of the reported gravity from the standard one, m/s2."""
_DIRECTION_TOLERANCE = 2.0
"""Largest distance of the reported gravity from that of the quaternion, m/s2: 12 degrees, what a
car turns at 20 rad/s while the chip renews one of them."""
_GYRO_RANGE = 34.91
"""Largest rate that the chip measures about an axis, rad/s (2000 degrees/s)."""


class Register(IntEnum):
    """Registers of page 0 that are used."""

    CHIP_ID = 0x00
    PAGE_ID = 0x07
    GYRO = 0x14
    CALIBRATION = 0x35
    SYSTEM_STATUS = 0x39
    UNITS = 0x3B
    MODE = 0x3D


class Mode(IntEnum):
    """Operation modes that are used.

    IMU: fusion without magnetometer, which the motors would disturb.
    """

    CONFIG = 0x00
    IMU = 0x08


SAMPLE_BYTES = Register.CALIBRATION + 1 - Register.GYRO
"""Length of one burst, bytes: gyro, Euler angles, quaternion, acceleration, gravity, temperature,
calibration."""


@dataclass(frozen=True)
class Bno055Sample:
    """One sample in the chip's own axes.

    Attributes:
        quaternion: attitude (w, x, y, z), which turns chip axes into the world's, z up; unit
            length.
        gyro: angular rates about the chip's axes, rad/s.
        acceleration: linear acceleration along the chip's axes, m/s2, gravity removed.
        calibration: levels of system, gyro, accelerometer, magnetometer, 0 (none) to 3 (full).
    """

    quaternion: tuple[float, ...]
    gyro: tuple[float, ...]
    acceleration: tuple[float, ...]
    calibration: tuple[int, ...] = (3, 3, 3, 3)

    @cached_property
    def rotation(self) -> np.ndarray:
        """Rotation (3, 3) from chip axes to world axes."""
        return np.asarray(Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix())


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of the chip: data of a read, or a status code."""

    data: bytes = b""
    status: int | None = None


def make_read(register: int, length: int) -> bytes:
    """Makes the request for `length` bytes from a register on.

    Raises `FrameError` for a length that the chip refuses.
    """
    return _request(_READ, register, length)


def make_write(register: int, data: bytes) -> bytes:
    """Makes the request that writes bytes from a register on.

    Raises `FrameError` for a length that the chip refuses.
    """
    return _request(_WRITE, register, len(data)) + data


def _request(kind: int, register: int, length: int) -> bytes:
    """Returns the head of a request; `FrameError` for a length that the chip refuses."""
    check_field("BNO055 length", length, 1, _MAX_DATA, "bytes")
    return bytes([_START, kind, register, length])


def make_sample_request() -> bytes:
    """Makes the request for one sample."""
    return make_read(Register.GYRO, SAMPLE_BYTES)


def decode_sample(data: bytes) -> Bno055Sample:
    """Decodes the sample in the burst of `make_sample_request`.

    Raises:
        FrameError: another length, a quaternion that is none, a gravity that is not the earth's or
            points elsewhere than the quaternion says, or a rate beyond the range.
    """
    if len(data) != SAMPLE_BYTES:
        raise FrameError(f"BNO055 sample of {len(data)} bytes; allowed is {SAMPLE_BYTES}")
    *numbers, levels = _SAMPLE.unpack(data)
    gyro = tuple(value / _GYRO for value in numbers[0:3])
    quaternion = tuple(value / _QUATERNION for value in numbers[3:7])
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        raise FrameError(
            f"BNO055 quaternion of length {norm:.3g}: the fusion does not run, or bytes were "
            "damaged"
        )
    reported = tuple(value / _ACCELERATION for value in numbers[10:13])
    gravity = math.hypot(*reported)
    if abs(gravity - STANDARD_GRAVITY) > _GRAVITY_TOLERANCE:
        raise FrameError(
            f"BNO055 gravity of {gravity:.3g} m/s2; allowed is {STANDARD_GRAVITY:g} +- "
            f"{_GRAVITY_TOLERANCE:g}"
        )
    check_field("BNO055 rate", max(map(abs, gyro)), 0.0, _GYRO_RANGE, "rad/s")
    sample = Bno055Sample(
        quaternion=quaternion,
        gyro=gyro,
        acceleration=tuple(value / _ACCELERATION for value in numbers[7:10]),
        calibration=tuple(levels >> shift & 3 for shift in (6, 4, 2, 0)),
    )
    if math.dist(reported, STANDARD_GRAVITY * sample.rotation[2]) > _DIRECTION_TOLERANCE:
        raise FrameError("BNO055 gravity points elsewhere than its quaternion says")
    return sample


def encode_sample(sample: Bno055Sample) -> bytes:
    """Encodes a sample as the registers that hold it; for emulators.

    Values beyond their 16 bits are cut off as the chip does.
    """
    gyro = _words(sample.gyro, _GYRO)
    quaternion = _words(sample.quaternion, _QUATERNION)
    acceleration = _words(sample.acceleration, _ACCELERATION)
    gravity = _words(sample.rotation[2] * STANDARD_GRAVITY, _ACCELERATION)
    levels = 0
    for level in sample.calibration:
        levels = levels << 2 | level
    return _SAMPLE.pack(*gyro, *quaternion, *acceleration, *gravity, levels)


def _words(values: Iterable[float], counts: float) -> list[int]:
    """Returns values as words of 16 bits, with `counts` counts per unit."""
    return [max(-32768, min(32767, round(value * counts))) for value in values]


class AnswerStream:
    """Parser of the answers in a byte stream that may carry noise; what is no answer is dropped."""

    def __init__(self) -> None:
        self._open = b""

    def feed(self, data: bytes) -> list[Answer]:
        """Adds bytes; returns the answers that became complete, oldest first."""
        self._open += data
        answers: list[Answer] = []
        while len(self._open) >= 2:
            kind = self._open[0]
            second = self._open[1]
            if kind == _STATUS and second in _STATUS_CODES:
                answers.append(Answer(status=second))
                self._open = self._open[2:]
            elif kind == _DATA and 1 <= second <= _MAX_DATA:
                if len(self._open) < 2 + second:
                    break
                answers.append(Answer(data=self._open[2 : 2 + second]))
                self._open = self._open[2 + second :]
            else:
                self._open = self._open[1:]
        return answers


class Bno055Chip:
    """The chip's side of its UART, for emulators: registers, and an answer to every request.

    Samples read as zeros in the mode CONFIG, as on the chip.
    """

    def __init__(self) -> None:
        self._registers = bytearray(0x80)
        self._registers[Register.CHIP_ID] = CHIP_ID
        self._registers[Register.SYSTEM_STATUS] = 5  # fusion runs
        self._open = b""

    def set_sample(self, sample: Bno055Sample) -> None:
        """Sets what is read from now on."""
        self._registers[Register.GYRO : Register.GYRO + SAMPLE_BYTES] = encode_sample(sample)

    def feed(self, data: bytes) -> bytes:
        """Returns bytes that the chip sends in answer to these."""
        self._open += data
        answers = b""
        while self._open:
            if self._open[0] != _START:
                self._open = self._open[1:]
                answers += bytes([_STATUS, 0x06])
                continue
            if len(self._open) < 4:
                break
            kind = self._open[1]
            register = self._open[2]
            length = self._open[3]
            used = 4 + (length if kind == _WRITE else 0)
            if len(self._open) < used:
                break
            answers += self._answer(kind, register, length, self._open[4:used])
            self._open = self._open[used:]
        return answers

    def _answer(self, kind: int, register: int, length: int, data: bytes) -> bytes:
        if kind not in (_READ, _WRITE) or length == 0 or register + length > len(self._registers):
            return bytes([_STATUS, 0x04])
        if kind == _WRITE:
            self._registers[register : register + length] = data
            return bytes([_STATUS, WRITE_DONE])
        content = bytes(self._registers[register : register + length])
        if self._registers[Register.MODE] == Mode.CONFIG and register == Register.GYRO:
            content = bytes(length)
        return bytes([_DATA, length]) + content
