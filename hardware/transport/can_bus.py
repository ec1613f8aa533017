"""A CAN bus that never holds up its user and never dies unnoticed.

Two threads carry the frames: one receives, one sends. The user polls what came in and reads
`fault`. A CAN driver is allowed to raise, to block or to spin: every one of these becomes a fault
that stays until the bus is opened again.
"""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Collection
from enum import IntEnum
from pathlib import Path

from aerodima.hardware.protocol.can_frame import MAX_BYTES, CanFrame, TimedFrames
from aerodima.hardware.transport.can_adapter import CanSettings, TrafficLog, can, open_bus
from aerodima.hardware.transport.serial_link import causes, reason_of
from aerodima.workbench.core.errors import HardwareError

_RECEIVE_TIMEOUT = 0.05
"""Longest wait of one read from the driver, s."""
_RECEIVER_SILENT = 0.5
"""Time without a pass of its loop after which a receive thread is taken for dead, s."""
_SENDER_STUCK = 0.25
"""Time after which a driver that does not return from sending counts as stuck, s."""
_SEND_TIMEOUT = 0.02
"""Time-out of the driver's send call, s. pyserial checks it after the write too: a thread that
waits 5 ms for its turn is not late."""
_SEND_RETRY = 0.001
"""Wait after a failed sending before the next attempt, s."""
_SEND_BLOCKED = 0.05
"""Time after which a driver that takes no frame counts as blocked, s: its buffer is full (ENOBUFS)
since nobody acknowledges on the bus."""
_MAX_GARBAGE = 200
"""Largest number of lines in a row that are no frame."""
_ECHO_TIME = 0.05
"""Time within which a received frame that equals a sent one is its echo, s."""
_ERROR_BUS_OFF = 0x40
"""Class bit of socketcan's error frames (linux/can/error.h)."""
_GONE = (
    errno.ENODEV,
    errno.ENXIO,
    errno.EIO,
    errno.ENETDOWN,
    errno.EBADF,
    errno.EPIPE,
    errno.ECONNRESET,
)
_STALE_AFTER = 0.05
"""Time after which a waiting command is no longer sent, s: five cycles of the loop."""
_CLOSE = 0.2
"""Longest wait at the end for what is to be sent, and for a thread, s."""
_MAX_URGENT = 256
"""Largest number of urgent frames that wait."""


class BusFault(IntEnum):
    """Reason why the bus cannot be trusted."""

    NONE = 0
    BUS_OFF = 1
    SEND_BLOCKED = 2
    ADAPTER_LOST = 3
    RECEIVER_DEAD = 4
    CLOSED = 5


class Outbox:
    """Frames that wait for the sending thread: urgent ones first, of the others only the newest per
    id.

    A blocked adapter must not let old commands through when it comes back, and must let exit frames
    through first.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._urgent: deque[CanFrame] = deque(maxlen=_MAX_URGENT)
        self._waiting: dict[tuple[int, bool], tuple[float, CanFrame]] = {}
        self._in_hand: tuple[float, CanFrame, bool] | None = None
        self._taken = 0.0
        self._closed = False

    def put(self, frame: CanFrame, urgent: bool) -> None:
        """Adds a frame; see `CanBus.send`."""
        with self._condition:
            self._waiting.pop(_key(frame), None)
            if urgent:
                self._urgent.append(frame)
            else:
                self._waiting[_key(frame)] = (time.monotonic(), frame)
            self._condition.notify_all()

    def next(self) -> CanFrame | None:
        """Takes the frame in hand as sent and waits for the next one; returns None when the box is
        closed and holds no urgent one.
        """
        with self._condition:
            while True:
                self._in_hand = None
                self._taken = time.monotonic()
                if self._urgent:
                    self._in_hand = (self._taken, self._urgent.popleft(), True)
                    return self._in_hand[1]
                if self._closed:
                    return None
                while self._waiting:
                    since, frame = self._waiting.pop(next(iter(self._waiting)))
                    if self._taken - since <= _STALE_AFTER:
                        self._in_hand = (since, frame, False)
                        return frame
                self._condition.notify_all()
                self._condition.wait()

    def put_back(self, may_have_left: bool) -> None:
        """Puts back the frame in hand, which could not be sent: it goes first again, unless a newer
        one or an exit came, or it is old.

        A command that may have left all the same is not sent twice, for the motor would answer
        twice.

        After `close` nothing comes back, so that a lost adapter cannot keep the thread alive.
        """
        with self._condition:
            assert self._in_hand is not None  # set by `next`
            since, frame, urgent = self._in_hand
            self._in_hand = None
            newer = {*self._waiting, *map(_key, self._urgent)}
            if self._closed:
                self._urgent.clear()
            elif urgent:
                self._urgent.appendleft(frame)
            elif not may_have_left and _key(frame) not in newer:
                self._waiting = {_key(frame): (since, frame), **self._waiting}

    def age_in_hand(self) -> float:
        """Returns how long the sending thread holds its frame, s; 0 when it holds none."""
        with self._condition:
            if self._in_hand is None:
                return 0.0
            return time.monotonic() - self._taken

    def wait_empty(self, timeout: float) -> bool:
        """Waits until nothing waits and nothing is in hand, at most `timeout` s.

        Returns whether that is so.
        """
        with self._condition:
            return self._condition.wait_for(
                lambda: not self._urgent and not self._waiting and self._in_hand is None, timeout
            )

    def close(self) -> None:
        """Closes the box: no more frames; `next` returns None."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()


class CanBus:
    """Frames in and out of one adapter.

    Args:
        bus: bus of python-can; this object owns and closes it. `CanBus.open` makes both.
        traffic_log: log that takes all frames; this object closes it.
        listen: standard ids whose frames are kept; None: all. Extended frames are always kept,
            since they reveal V3 firmware.
        name: name of the adapter, for messages.

    Attributes:
        fault: first reason not to trust the bus; it stays.
        fault_text: the same in words, with what the driver said.
        garbage: number of messages since the start that are no frame.
    """

    def __init__(
        self,
        bus: can.BusABC,
        traffic_log: TrafficLog | None = None,
        listen: Collection[int] | None = None,
        name: str = "CAN",
    ) -> None:
        self._bus = bus
        self._name = name
        self._listen = None if listen is None else frozenset(listen)
        self.fault = BusFault.NONE
        self.fault_text = ""
        self.garbage = 0
        self._outbox = Outbox()
        self._inbox: deque[tuple[float, CanFrame]] = deque(maxlen=4096)
        self._recent: deque[tuple[float, int, bytes]] = deque(maxlen=64)
        self._recent_lock = threading.Lock()
        self._garbage_in_a_row = 0
        self._closing = threading.Event()
        self._receiver_time = time.monotonic()
        self._log = traffic_log
        self._receiver = threading.Thread(target=self._receive, name="can-receive", daemon=True)
        self._sender = threading.Thread(target=self._send, name="can-send", daemon=True)
        self._receiver.start()
        self._sender.start()

    @classmethod
    def open(
        cls,
        settings: CanSettings,
        traffic_log: Path | None = None,
        listen: Collection[int] | None = None,
    ) -> CanBus:
        """Opens the adapter of these settings and a new file for the traffic (`.blf`; no file when
        None).

        Raises:
            HardwareError: an error of `open_bus` or `TrafficLog.create`.
        """
        log = None if traffic_log is None else TrafficLog.create(traffic_log)
        try:
            return cls(open_bus(settings), log, listen, str(settings))
        except HardwareError:
            if log is not None:
                log.close()
            raise

    @property
    def log_error(self) -> str:
        """Error that stopped the traffic log, empty while it works."""
        return "" if self._log is None else self._log.error

    def send(self, frame: CanFrame, urgent: bool = False) -> bool:
        """Hands a frame to the sending thread and returns at once.

        Args:
            urgent: whether the frame goes out before all others, is repeated until the driver takes
                it, and removes the waiting commands for the same id: for exit frames. Other frames
                that wait are replaced by the next one of the same id.

        Returns:
            False if the bus is closed.
        """
        if self._closing.is_set():
            return False
        self._outbox.put(frame, urgent)
        return True

    def poll(self) -> TimedFrames:
        """Returns the frames received since the last call, oldest first, each with its arrival, s
        on `time.monotonic`.
        """
        self._check_threads()
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def flush(self, timeout: float = _CLOSE) -> bool:
        """Waits, at most `timeout` s, until the driver has every frame; returns whether it has."""
        return self._outbox.wait_empty(timeout)

    def close(self) -> None:
        """Sends what waits (at most 0.2 s), stops the threads, closes adapter and log.

        Never raises.
        """
        self.flush()
        self._closing.set()
        self._outbox.close()
        self._sender.join(_CLOSE)
        self._receiver.join(_CLOSE + _RECEIVE_TIMEOUT)
        try:
            self._bus.shutdown()
        except Exception as error:  # a lost adapter cannot be closed properly
            self._set_fault(BusFault.ADAPTER_LOST, str(error))
        self._set_fault(BusFault.CLOSED, "closed")
        if self._log is not None:
            self._log.close()

    def _set_fault(self, fault: BusFault, text: str) -> None:
        if self.fault is BusFault.NONE:
            self.fault_text = text
            self.fault = fault

    def _set_failure(self, fault: BusFault, doing: str, error: Exception) -> None:
        self._set_fault(
            fault, f"{self._name}: {doing} failed: {reason_of(error.__cause__ or error)}"
        )

    def _check_threads(self) -> None:
        if self._closing.is_set():
            return
        silent = time.monotonic() - self._receiver_time
        stuck = self._outbox.age_in_hand()
        if not self._receiver.is_alive():
            self._set_fault(BusFault.RECEIVER_DEAD, "the receive thread ended")
        elif silent > _RECEIVER_SILENT:
            self._set_fault(BusFault.RECEIVER_DEAD, f"the receive thread hangs for {silent:.2f} s")
        elif not self._sender.is_alive():
            self._set_fault(BusFault.SEND_BLOCKED, "the send thread ended")
        elif stuck > _SENDER_STUCK:
            self._set_fault(BusFault.SEND_BLOCKED, f"the driver holds a frame for {stuck:.2f} s")

    # -- receiving thread

    def _receive(self) -> None:
        try:
            while not self._closing.is_set():
                self._receiver_time = time.monotonic()
                self._receive_one()
        except Exception as error:
            self._set_failure(_fault_of(error, BusFault.RECEIVER_DEAD), "receiving", error)

    def _receive_one(self) -> None:
        busy = time.thread_time()
        try:
            message = self._bus.recv(_RECEIVE_TIMEOUT)
        except Exception as error:
            self._drop_garbage(error)
            return
        if message is None:
            if time.thread_time() - busy > _RECEIVE_TIMEOUT / 2 and not self._closing.is_set():
                # python-can's socketcand reads an endless nothing, at full load, once its server
                # has gone
                raise ConnectionResetError(
                    errno.ECONNRESET, "the driver reads without end: the server has gone"
                )
            return
        self._garbage_in_a_row = 0
        now = time.monotonic()
        if self._log is not None:
            self._log.add(message)
        if message.is_error_frame:
            if message.arbitration_id & _ERROR_BUS_OFF:
                self._set_fault(BusFault.BUS_OFF, "the controller reports bus-off")
        elif (
            message.is_remote_frame
            or message.is_fd
            or len(message.data) > MAX_BYTES
            or len(message.data) != message.dlc
        ):
            self.garbage += 1
        else:
            self._take(now, message)

    def _drop_garbage(self, error: Exception) -> None:
        """Goes on after a line of slcan that is no frame, or no text; raises everything else."""
        causes = (error, error.__cause__)
        if self._garbage_in_a_row > _MAX_GARBAGE or not any(
            isinstance(e, ValueError | IndexError) for e in causes
        ):
            raise error
        self.garbage += 1
        self._garbage_in_a_row += 1

    def _take(self, now: float, message: can.Message) -> None:
        number = message.arbitration_id
        data = bytes(message.data)
        if not message.is_rx or self._is_echo(now, number, data):
            return
        if self._listen is None or message.is_extended_id or number in self._listen:
            self._inbox.append((now, CanFrame(number, data, message.is_extended_id)))

    def _is_echo(self, now: float, arbitration_id: int, data: bytes) -> bool:
        with self._recent_lock:
            for item in self._recent:
                if item[1:] == (arbitration_id, data) and now - item[0] < _ECHO_TIME:
                    self._recent.remove(item)
                    return True
        return False

    # -- sending thread

    def _send(self) -> None:
        blocked_since = None
        while (frame := self._outbox.next()) is not None:
            now = time.monotonic()
            try:
                self._send_one(frame)
            except Exception as error:
                blocked_since = now if blocked_since is None else blocked_since
                fault = _fault_of(error, BusFault.SEND_BLOCKED)
                if fault is not BusFault.SEND_BLOCKED or now - blocked_since > _SEND_BLOCKED:
                    self._set_failure(fault, "sending", error)
                self._closing.wait(_SEND_RETRY)
                # pyserial times out after a whole write too: the frame may be on the bus.
                kinds = (type(cause).__name__ for cause in causes(error))
                self._outbox.put_back("SerialTimeoutException" in kinds)
            else:
                blocked_since = None

    def _send_one(self, frame: CanFrame) -> None:
        message = can.Message(
            time.time(), frame.arbitration_id, frame.extended, data=frame.data, is_rx=False
        )
        with self._recent_lock:
            self._recent.append((time.monotonic(), frame.arbitration_id, frame.data))
        self._bus.send(message, timeout=_SEND_TIMEOUT)
        if self._log is not None:
            self._log.add(message)


def _key(frame: CanFrame) -> tuple[int, bool]:
    """Returns the key that tells the frames of one id from others."""
    return frame.arbitration_id, frame.extended


def _fault_of(error: BaseException, otherwise: BusFault) -> BusFault:
    """Returns `ADAPTER_LOST` if the cause, somewhere in the chain, is that the device has gone."""
    for cause in causes(error):
        number = getattr(cause, "errno", None) or getattr(cause, "error_code", None)
        if number in _GONE or "readiness to read but returned no data" in str(cause):
            return BusFault.ADAPTER_LOST
    return otherwise
