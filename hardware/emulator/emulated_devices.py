"""Teensy, IMU, GPS and the operator's radio of the emulated car: bytes in and out, silent or noisy
as the script says.

The Teensy is the firmware's own core between a serial port, the bus, the pins and the encoder.
"""

import math
import time
from collections import deque
from collections.abc import Sequence

import numpy as np
from pydrake.math import RollPitchYaw

from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.devices.bno055 import Bno055Chip
from aerodima.hardware.devices.ublox import GpsSample, make_nav_pvt
from aerodima.hardware.emulator.emulated_bus import EmulatedBus
from aerodima.hardware.emulator.fault_script import EventLog, FaultBoard, OperatorEntry
from aerodima.hardware.firmware.teensy_core import CoreState, TeensyCore
from aerodima.hardware.firmware.teensy_firmware import FirmwareSettings
from aerodima.hardware.protocol import radio
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.radio import OperatorPrompt, decode_report
from aerodima.hardware.protocol.teensy import THROTTLE_PULSES, TeensyStatus
from aerodima.hardware.protocol.xbee import BROADCAST, ApiStream, Packet, make_received
from aerodima.workbench.core.quantity import STANDARD_GRAVITY

_RESTART_TIME = 0.5
"""Time-out of the processor's own watchdog in the Teensy's sketch, s."""
OPERATOR_RATE = 20.0
"""Rate of the operator's frames, Hz: five commands and heartbeats within the dead-man time of
0.25 s."""
_DAY = 86_400.0
"""Length of a day, s."""
_STOP_FRAMES = 3
"""Number of emergency stops that an operator sends."""
_ON_ITS_SIDE = 1.57
"""Roll that the fault `tipped_over` reports, rad."""
_TOO_FAST = 9.0
"""Speed that the fault `over_speed` reports, m/s."""
OPERATOR = 0x0013_A200_4000_0001
"""64-bit serial number of the operator's emulated module; the first half is the maker's."""
CAR = 0x0013_A200_4000_0002
"""64-bit serial number of the car's emulated module."""
_FOREIGN = CAR + 1
"""Sender of the reports while the fault `foreign_module` is on."""


class EmulatedTeensy:
    """The firmware's core, connected to the bus, the sail and the computer.

    A hung Teensy does nothing, and its outputs stay as they are; the processor's own watchdog
    restarts it after a while.

    Args:
        watches: whether it is the second node on the bus, beside the computer's adapter.
    """

    def __init__(
        self,
        settings: FirmwareSettings,
        bus: EmulatedBus,
        board: FaultBoard,
        events: EventLog,
        now: float,
        watches: bool,
    ) -> None:
        self._watches = watches
        if watches:
            bus.watch = self._receive
        self._settings = settings
        self._bus = bus
        self._board = board
        self._events = events
        self._core = TeensyCore(settings, now)
        self._hung_since: float | None = None
        self._powered = True
        self._last = CoreState(0, 0, TeensyStatus.WATCHDOG_ACTED, 0)
        self.update(now)

    @property
    def state(self) -> CoreState:
        """Pulses and status of the core."""
        return self._core.state

    @property
    def driving(self) -> bool:
        """Returns whether the throttle pulse is not the neutral one."""
        return self._last.throttle != THROTTLE_PULSES[1]

    def feed(self, data: bytes, now: float) -> None:
        """Takes bytes from the computer."""
        if self._awake:
            self._core.feed(data, now)

    def set_sail(self, angle: float) -> None:
        """Sets the angle of the sail, rad."""
        words = 1 << self._settings.sail_bits
        self._core.set_sail_word(round(angle / (2.0 * math.pi) * words) % words)

    def update(self, now: float) -> bytes:
        """Runs the firmware's loop once; returns bytes for the computer."""
        if not self._runs(now):
            return b""
        self._core.step(now)
        for frame in self._core.frames():
            if self._board.entry("teensy_off_bus"):
                continue
            if self._watches:
                self._bus.carry_from_watch(frame)
                continue
            for answer in self._bus.carry(frame):
                self._core.receive(answer)
        self._core.step(now)  # a reply that waited for the motors goes out at once
        self._note()
        return self._board.corrupt("teensy", self._core.reply())

    def _receive(self, frame: CanFrame) -> None:
        if self._awake and self._board.entry("teensy_off_bus") is None:
            self._core.receive(frame)

    @property
    def _awake(self) -> bool:
        """Returns whether it has power and does not hang."""
        return self._powered and (self._hung_since is None or math.isinf(self._hung_since))

    def _runs(self, now: float) -> bool:
        powered = self._board.entry("teensy_unpowered") is None
        if powered is not self._powered:
            self._powered = powered
            self._core = TeensyCore(self._settings, now)
            self._note()  # servo and ESC get no pulses without power: neutral
        if not powered:
            return False
        if self._board.entry("teensy_hung") is None:
            self._hung_since = None
            return True
        if self._hung_since is None:
            self._hung_since = now
        if now - self._hung_since <= _RESTART_TIME:
            return False
        if not math.isinf(self._hung_since):
            self._events.add("teensy_restarted")
            self._core = TeensyCore(self._settings, now)
            self._hung_since = -math.inf
        return True

    def _note(self) -> None:
        before = self._last.status
        was_driving = self.driving
        self._last = self._core.state
        if self._last.status != before:
            self._events.add("watchdog_acted" if self._last.status else "watchdog_released")
        if self.driving is not was_driving:
            self._events.add("throttle_on" if self.driving else "throttle_neutral")


class EmulatedImu:
    """A BNO055 on its UART."""

    def __init__(self, mounting: Mounting, board: FaultBoard) -> None:
        self._mounting = mounting
        self._chip = Bno055Chip()
        self._board = board
        self._reading: np.ndarray | None = None
        self._answers: deque[tuple[float, bytes]] = deque()

    def set_reading(self, reading: np.ndarray) -> None:
        """Sets the reading (9,) as `aerodima.workbench.scenario.signal_table.IMU`."""
        before = self._reading
        if self._board.entry("frozen", "imu") and before is not None:
            return
        if self._board.entry("tipped_over"):
            reading = np.array([_ON_ITS_SIDE, *reading[1:]])
        if self._board.entry("attitude_stuck") and before is not None:
            # The chip removes gravity from what it measures by the attitude in which it believes.
            felt = reading[6:9] + _gravity(reading)
            reading = np.concatenate([before[:3], reading[3:6], felt - _gravity(before)])
        self._reading = reading
        self._chip.set_sample(self._mounting.imu_sample(reading))

    def feed(self, data: bytes, now: float) -> None:
        """Takes requests; their answers come in order, late ones before those that follow."""
        late = self._board.entry("answer_late")
        due = now + late.delay if late else now
        self._answers.append((due, self._chip.feed(data)))
        self._board.consume("answer_late")

    def poll(self, now: float) -> bytes:
        """Returns the answers that are due."""
        answers = b""
        while self._answers and self._answers[0][0] <= now:
            answers += self._answers.popleft()[1]
        return self._board.corrupt("imu", answers) if answers else b""


def _gravity(reading: np.ndarray) -> np.ndarray:
    """Returns the acceleration (3,) that a car at rest feels in the attitude of a reading, m/s2."""
    return STANDARD_GRAVITY * RollPitchYaw(reading[:3]).ToRotationMatrix().matrix()[2]


class EmulatedGps:
    """A u-blox receiver that sends NAV-PVT at its own rate."""

    def __init__(self, rate: float, board: FaultBoard) -> None:
        self._period = 1.0 / rate
        self._next = 0.0
        self._board = board
        self._speed = 0.0

    def update(self, speed: float, now: float) -> bytes:
        """Returns bytes that are due; speed in m/s."""
        if now < self._next:
            return b""
        self._next = max(self._next + self._period, now)
        if self._board.entry("over_speed"):
            speed = _TOO_FAST
        if not self._board.entry("frozen", "gps"):
            self._speed = speed
        fix = self._board.entry("fix_lost") is None
        sample = GpsSample(max(0.0, self._speed), fix, time.time() % _DAY)
        return self._board.corrupt("gps", make_nav_pvt(sample))


class EmulatedOperator:
    """The operator at the radio, as the car's module hands over the frames in API mode 1: commands
    and a living heartbeat.

    Attributes:
        prompted: whether the car's last prompt was for a choice.
    """

    def __init__(self, entries: Sequence[OperatorEntry], board: FaultBoard) -> None:
        self._entries = sorted(entries, key=lambda entry: entry.time)
        self._next = 0.0
        self._board = board
        self._counter = 0
        self._stops = 0
        self._of_car = ApiStream()
        self.prompted = False

    def receive(self, data: bytes) -> None:
        """Receives what the car's computer hands to its module: reports with a prompt."""
        for packet in self._of_car.feed_transmits(data):
            try:
                prompt = decode_report(packet.data).prompt
            except FrameError:
                continue
            if prompt is not OperatorPrompt.NONE:
                self.prompted = prompt is OperatorPrompt.SELECT_MODE

    def update(self, now: float) -> bytes:
        """Returns bytes that are due."""
        if now < self._next:
            return b""
        self._next = max(self._next + 1.0 / OPERATOR_RATE, now)
        passed = [entry for entry in self._entries if entry.time <= max(0.0, self._board.time)]
        if not passed:
            return b""
        self._counter += 1
        frames = [radio.make_heartbeat(self._counter)]
        if passed[-1].stop:
            if self._stops < _STOP_FRAMES:
                self._stops += 1
                frames.append(radio.make_emergency_stop())
        else:
            frames.append(radio.make_command(passed[-1].command(self.prompted)))
        return self._board.corrupt(
            "radio", b"".join(make_received(Packet(OPERATOR, frame)) for frame in frames)
        )


class EmulatedAir:
    """Two XBee modules and the air between them: what one computer hands to its module, the other
    module hands out.
    """

    def __init__(self, board: FaultBoard) -> None:
        self._board = board
        self._of_operator = ApiStream()
        self._of_car = ApiStream()

    def to_car(self, data: bytes) -> bytes:
        """Carries bytes of the console's serial port to the car's."""
        return self._carry(self._of_operator, data, OPERATOR, CAR)

    def to_console(self, data: bytes) -> bytes:
        """Carries bytes of the car's serial port to the console's."""
        sender = _FOREIGN if self._board.entry("foreign_module") else CAR
        return self._carry(self._of_car, data, sender, OPERATOR)

    def _carry(self, stream: ApiStream, data: bytes, sender: int, receiver: int) -> bytes:
        packets = [
            packet
            for packet in stream.feed_transmits(data)
            if packet.address in (receiver, BROADCAST)
        ]
        return self._board.corrupt(
            "radio",
            b"".join(make_received(Packet(sender, packet.data)) for packet in packets),
        )
