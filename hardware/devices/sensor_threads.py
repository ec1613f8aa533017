"""The two sensors of the car as threads: BNO055 at 100 Hz over its UART, u-blox GPS at its own
pace.

Each thread keeps one serial device open and its newest sample at hand.
"""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from serial import Serial

from aerodima.hardware.devices.attitude_monitor import AttitudeMonitor
from aerodima.hardware.devices.bno055 import (
    CHIP_ID,
    RADIANS,
    RATE,
    SAMPLE_BYTES,
    WRITE_DONE,
    Answer,
    AnswerStream,
    Bno055Sample,
    Mode,
    Register,
    decode_sample,
    make_read,
    make_sample_request,
    make_write,
)
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.ublox import GpsSample, GpsStream
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.transport.serial_link import RECONNECT
from aerodima.workbench.core.errors import HardwareError

_CLOSE = 0.5
"""Longest wait for the thread when a sensor is closed, s."""

T = TypeVar("T")
_PERIOD = 1.0 / RATE
"""Time between two samples of the IMU, s."""
_ANSWER_TIME = 0.05
"""Longest wait for an answer of the IMU, s."""
_MODE_CHANGE = 0.03
"""Wait between operation modes, s (data sheet table 3-6: 19 ms to CONFIG, 7 ms from it)."""
_LEAD = 0.006
"""Time from the request of a sample to the instant at which it is wanted, s: 40 bytes take 3.5 ms,
and the chip adds to that."""
_STATUS_EVERY = 100
"""Number of requests between two checks of the chip's own status."""
_STATUS_LENGTHS = 8
"""Number of lengths that the answer to such a check has in turn: the registers behind error and
status are other settings."""
_MAX_EQUAL = 10
"""Largest number of samples in a row, or of solutions of a moving car, that may be equal to the
last bit: noise of gyro and accelerometer is above their steps (data sheet table 0-2), and the speed
of a car that moves changes by more than 1 mm/s."""
_MOVES = 0.5
"""Speed above which the car moves, m/s; a receiver at rest may go on reporting 0."""
_TURNS = 0.1
"""Rate above which the car turns, rad/s; about any axis it changes the attitude by eight steps from
sample to sample. At rest the attitude may stay the same."""
_MAX_MISSED = 20
"""Number of requests in a row without an answer after which the chip is set up anew."""


class Session(Generic[T]):
    """Session with an open device: sets it up, then reads from it once per call.

    Attributes:
        fault_text: fault that the device itself reports, in words; empty while it is well.
    """

    fault_text = ""

    def begin(self, port: Serial) -> None:
        """Sets the device up, if there is something to set up; raises `HardwareError` if it is not
        the device that it should be.
        """

    def align(self, due: float) -> None:
        """Asks for a sample at `due` (s, monotonic) and every period after it, from devices that
        answer requests.
        """

    def read(self, port: Serial) -> tuple[float, T] | None:
        """Reads the next sample and its time (s, monotonic); None after a wait without one."""
        raise NotImplementedError


class FrozenSensorMonitor:
    """Counter of equal samples of a signal in a row.

    Args:
        name: name of the signal.

    Attributes:
        fault_text: message that the signal has frozen; empty while it lives.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._last: object = None
        self._alike = 0
        self.fault_text = ""

    def update(self, sample: object, moves: bool = True) -> None:
        """Takes a sample; an equal one does not count while the signal may stand (not `moves`)."""
        if sample != self._last:
            self._alike = 1
        elif moves:
            self._alike += 1
        self._last = sample
        self.fault_text = ""
        if self._alike > _MAX_EQUAL:
            self.fault_text = f"the {self._name} has frozen: {self._alike} samples alike"


class SensorThread(Generic[T]):
    """Thread that reads a sensor for ever; a device that was lost is opened and set up again.

    Args:
        name: name of the sensor, for messages.
        open_port: function that opens the device or raises `HardwareError`. The first call is made
            here, so that a wrong path is an error at once.
        session: session with the device.
        silent: age of a sample at which the sensor counts as silent, s.

    Attributes:
        newest: time of the newest sample (s, monotonic), and the sample; None before the first.
        error: reason of the last loss; empty before the first.
    """

    def __init__(
        self, name: str, open_port: Callable[[], Serial], session: Session[T], silent: float
    ) -> None:
        self.name = name
        self._open_port = open_port
        self._session = session
        self._silent = silent
        self._port: Serial | None = open_port()
        self.newest: tuple[float, T] | None = None
        self.error = ""
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def age(self, now: float) -> float:
        """Returns the seconds since the newest sample was taken; infinite before the first."""
        newest = self.newest
        if newest is None:
            return math.inf
        return max(0.0, now - newest[0])

    def align(self, due: float) -> None:
        """Asks for a sample at `due` (s, monotonic) and every period after it."""
        self._session.align(due)

    def fault(self, now: float) -> tuple[SourceFault, str]:
        """Returns why the sensor cannot be trusted at present, and the same in words."""
        if not self._thread.is_alive() and not self._closing.is_set():
            return SourceFault.LOST, f"the reading thread of the {self.name} ended: {self.error}"
        if self._port is None:
            return SourceFault.LOST, f"the port of the {self.name} is lost: {self.error}"
        if self._session.fault_text:
            return SourceFault.REPORTED, self._session.fault_text
        if self.newest is None:
            reason = f": {self.error}" if self.error else ""
            return SourceFault.NO_SAMPLE_YET, f"no sample of the {self.name} yet{reason}"
        age = self.age(now)
        if age > self._silent:
            return SourceFault.SILENT, f"the {self.name} is silent for {age:.2f} s"
        return SourceFault.NONE, ""

    def close(self) -> None:
        """Ends the thread and closes the device. Never raises."""
        self._closing.set()
        self._thread.join(_CLOSE)
        self._lose("closed")

    def _lose(self, reason: str) -> None:
        self.error = " ".join(reason.split())
        port = self._port
        self._port = None
        if port is not None:
            with contextlib.suppress(Exception):  # one that has gone cannot be closed properly
                port.close()

    def _run(self) -> None:
        ready = False
        while not self._closing.is_set():
            port = self._port
            try:
                if port is None:
                    self._port = self._open_port()
                    ready = False
                elif not ready:
                    self._session.begin(port)
                    ready = True
                elif (sample := self._session.read(port)) is not None:
                    self.newest = sample
            # pyserial raises OSError, TypeError and others on a lost device.
            except Exception as error:
                self._lose(str(error))
                self._closing.wait(RECONNECT)


class Bno055Session(Session[Bno055Sample]):
    """Session that requests one sample per period, and once a second the chip's own status."""

    def __init__(self) -> None:
        self._frozen = tuple(
            FrozenSensorMonitor(f"{name} of the IMU")
            for name in ("gyro", "acceleration", "attitude")
        )
        self._attitude = AttitudeMonitor()
        self._reported = ""
        self._next = 0.0
        self._due = 0.0
        self._requests = 0
        self._missed_in_a_row = 0
        self._in_step = True

    @property
    def fault_text(self) -> str:  # type: ignore[override]
        """Fault in words: the chip reports one, one of its signals has frozen, or attitude and gyro
        differ; empty without one.
        """
        frozen = (monitor.fault_text for monitor in self._frozen)
        return next(filter(None, (self._reported, *frozen, self._attitude.fault_text)), "")

    def begin(self, port: Serial) -> None:
        """Checks the chip and switches its fusion on.

        Raises `HardwareError` if what answers is no BNO055.
        """
        port.read(max(1, port.in_waiting))
        chip_id = self._ask(port, make_read(Register.CHIP_ID, 1), 1).data
        if chip_id != bytes([CHIP_ID]):
            raise HardwareError(
                f"IMU: chip id {chip_id.hex() or 'none'}; a BNO055 has {CHIP_ID:02x}"
            )
        for register, value, wait in (
            (Register.MODE, Mode.CONFIG, _MODE_CHANGE),
            (Register.PAGE_ID, 0, 0.0),
            (Register.UNITS, RADIANS, 0.0),
            (Register.MODE, Mode.IMU, _MODE_CHANGE),
        ):
            answer = self._ask(port, make_write(register, bytes([value])), 0)
            if answer.status != WRITE_DONE:
                raise HardwareError(f"IMU: register {register:#04x} cannot be written ({answer})")
            time.sleep(wait)
        self._next = time.monotonic()
        self._missed_in_a_row = 0
        self._in_step = True

    def align(self, due: float) -> None:
        """Times the requests so that a sample is at hand at `due` (s, monotonic) and every period
        after it.
        """
        self._due = due

    def read(self, port: Serial) -> tuple[float, Bno055Sample] | None:
        """Waits for the next period and reads one sample, taken at the instant of the request at
        the latest.

        After a sample that did not come in time the status is asked for first: the chip answers in
        order, so a late sample comes before the status and is dropped.
        """
        time.sleep(max(0.0, self._next - time.monotonic()))
        self._next = self._after(time.monotonic())
        self._requests += 1
        if self._requests % _STATUS_EVERY == 0 or not self._in_step:
            self._in_step = self._check_status(port) or self._in_step
        request_time = time.monotonic()
        try:
            if not self._in_step:
                raise FrameError("BNO055: the answers are late")
            sample = decode_sample(self._ask(port, make_sample_request(), SAMPLE_BYTES).data)
        except FrameError as error:
            self._in_step = False
            self._missed_in_a_row += 1
            if self._missed_in_a_row >= _MAX_MISSED:
                raise HardwareError(
                    f"{self._missed_in_a_row} requests in a row without a sample: {error}"
                ) from None
            return None
        self._missed_in_a_row = 0
        gyro, acceleration, attitude = self._frozen
        gyro.update(sample.gyro)
        acceleration.update(sample.acceleration)
        attitude.update(sample.quaternion, max(map(abs, sample.gyro)) > _TURNS)
        self._attitude.update(request_time, sample)
        return request_time, sample

    def _after(self, request_time: float) -> float:
        """Returns the time at which the next sample is requested: about a period later, in step
        with the time at which it is wanted.
        """
        first = self._due - _LEAD
        return first + math.ceil((request_time + 0.5 * _PERIOD - first) / _PERIOD) * _PERIOD

    def _check_status(self, port: Serial) -> bool:
        """Asks for the chip's own status; returns whether it answered.

        The length differs from that of the checks before, whose answers may still come.
        """
        length = 2 + self._requests % _STATUS_LENGTHS
        data = self._ask(port, make_read(Register.SYSTEM_STATUS, length), length).data
        if data:
            if data[0] == 1:
                self._reported = f"the IMU reports system error {data[1]}"
            else:
                self._reported = ""
        return bool(data)

    def _ask(self, port: Serial, request: bytes, length: int) -> Answer:
        """Returns the answer to a request, `length` bytes of data or a status code; an empty one if
        none comes in time.

        Data of another length answer an earlier request.
        """
        if stale := port.in_waiting:
            port.read(stale)
        stream = AnswerStream()
        port.write(request)
        end = time.monotonic() + _ANSWER_TIME
        while time.monotonic() < end:
            for answer in stream.feed(port.read(max(1, port.in_waiting))):
                if len(answer.data) == length or answer.status is not None:
                    return answer
        return Answer()


class GpsSession(Session[GpsSample]):
    """Session that takes whatever solutions the receiver sends; nothing is configured."""

    def __init__(self) -> None:
        self._stream = GpsStream()
        self._frozen = FrozenSensorMonitor("GPS")

    @property
    def fault_text(self) -> str:  # type: ignore[override]
        """Message that the receiver's speed has frozen; empty while it lives."""
        return self._frozen.fault_text

    def read(self, port: Serial) -> tuple[float, GpsSample] | None:
        """Returns the newest solution of the bytes at hand, with their arrival; None if there is
        none.
        """
        data = port.read(max(1, port.in_waiting))
        samples = self._stream.feed(data) if data else []
        for sample in samples:
            self._frozen.update(sample.speed, sample.speed > _MOVES)
        if samples:
            return (time.monotonic(), samples[-1])
        return None
