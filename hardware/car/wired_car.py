"""The car at the end of its cables in every wiring: the order within a cycle, and the end."""

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.car.wiring import (
    PERIOD,
    UNSOUND,
    CarCommand,
    CarReader,
    CarReading,
    CarReporter,
    Devices,
    WiringName,
)
from aerodima.hardware.devices.device_states import ENERGISED, MotorFault
from aerodima.hardware.devices.tail_motor import Motor
from aerodima.hardware.protocol.ak70 import MitCommand
from aerodima.hardware.protocol.can_frame import TimedFrames
from aerodima.hardware.protocol.radio import OperatorPrompt
from aerodima.hardware.protocol.teensy import SERVO_PULSES, THROTTLE_PULSES
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.signal_table import IMU, STATUS

_LAST_FRAMES = 5
"""Number of text frames with throttle 0 and exit that are sent at the end, one every 10 ms."""


class WiredCar:
    """A car on its cables; `wire_car` makes it.

    None of the calls waits for a device, apart from `start` and `stop`. Times: `time.monotonic()`,
    s.

    Args:
        name: name of the wiring.
        has_tail: whether the car has tail motors.
        mounting: signs and zeros of the parts on the car.
        open_devices: function that opens every port; after a failure it closes those that it
            opened.
        authorise: function that raises `HardwareError` while no watchdog test of this wiring is
            recorded.
        car: number of the car, for the operator's station.

    Attributes:
        devices: open devices; None before `start` and after `stop`.
        reading: reading of the last cycle.
        stop_reason: reason of the first `stop`; empty before.
        prompt: what the operator must do before the car drives, for the next report; set by the
            guard.
        posture: posture of the tail of a car that stops, in words, for the operator; set by the
            guard.
        holds_pitch: whether a fault of the roll motor leaves the pitch motor on; set by the guard.
        traffic_error: error that stopped the log of the CAN traffic, known after `stop`; empty if
            there was none.
    """

    def __init__(
        self,
        name: WiringName,
        has_tail: bool,
        mounting: Mounting,
        open_devices: Callable[[], Devices],
        authorise: Callable[[], None],
        car: int = 0,
    ) -> None:
        self.name: WiringName = name
        self._has_tail = has_tail
        self._mounting = mounting
        self._open_devices = open_devices
        self._authorise = authorise
        self.devices: Devices | None = None
        self.reading = CarReading()
        self.stop_reason = ""
        self.traffic_error = ""
        self.prompt = OperatorPrompt.NONE
        self.posture = ""
        self.holds_pitch = False
        self._reader = CarReader(mounting)
        self._reporter = CarReporter(has_tail, car)
        self._released = False  # by hand; what stands for `armed` where there are no motors

    # -- from off to armed

    def authorise(self) -> None:
        """Raises `HardwareError` where the tail's motors may not be switched on; a car without a
        tail has none.
        """
        if self._has_tail:
            self._authorise()

    def start(self) -> None:
        """Opens the ports and starts the threads; commands nothing.

        A `HardwareError` names the port that failed.
        """
        if self.devices is not None or self.stop_reason:
            raise HardwareError(f"{self.name}: was started already")
        self.devices = self._open_devices()

    def arm(self) -> None:
        """Begins to switch the tail motors on; they take commands when `armed` of the status is 1.

        A car without a tail is armed at once: servo and throttle take commands.

        Raises:
            HardwareError: no watchdog test is recorded for this wiring, or a motor or the bus has a
                fault.
        """
        devices = self.devices
        if devices is None:
            reason = f" ({self.stop_reason})" if self.stop_reason else ""
            raise HardwareError(f"{self.name}: is not started{reason}")
        self.authorise()
        if devices.teensy.fault:
            raise HardwareError(devices.teensy.fault_text)
        self._released = True
        if not self._has_tail:
            return
        if devices.watchdog is not None:
            devices.watchdog.arm()
        devices.group.set_enter(time.monotonic())

    def hold(self, now: float, centred: bool = False) -> None:
        """Holds the tail until the next command that is not all zeros: where it is or, with
        `centred`, with its roll in the middle. Does nothing after `stop`.
        """
        for motor, centre in zip(self.motors, (None, 0.0), strict=False):
            motor.set_hold(now, centre if centred else None)

    def disarm(self, now: float) -> None:
        """Sends exit frames now and in the following cycles; the links stay open and `read` goes
        on.

        Does nothing after `stop`.
        """
        self._released = False
        if self.devices is not None:
            self.devices.group.set_exit(now)

    # -- what is known

    @property
    def unwatched(self) -> str:
        """Reason why the watchdog of this wiring is not reliable; empty while it is, or before
        `start`.
        """
        watchdog = None if self.devices is None else self.devices.watchdog
        return "" if watchdog is None else watchdog.reason

    @property
    def motors(self) -> tuple[Motor, ...]:
        """The motors of the tail, pitch and roll; empty while the car is not started."""
        return () if self.devices is None else self.devices.group.motors

    def replies(self, motor_id: int) -> TimedFrames:
        """Returns the newest frames that name a motor, with their arrival (s), oldest first."""
        if self.devices is None:
            return []
        heard = self.devices.group.received
        return [(when, frame) for when, frame in heard if frame.data[:1] == bytes([motor_id])]

    @property
    def teensy_time(self) -> float:
        """Time at which the Teensy sent its last reply, s; NaN before the first."""
        return math.nan if self.devices is None else self.devices.teensy.sent_time

    @property
    def imu_time(self) -> float:
        """Time at which the newest sample of the IMU was taken, s; NaN before the first."""
        return self._reader.imu_time

    @property
    def gps_time(self) -> float | None:
        """UTC by the GPS receiver, s since midnight; None while it is not known."""
        gps = None if self.devices is None else self.devices.gps
        newest = None if gps is None else gps.newest
        if newest is None or newest[1].time_of_day is None:
            return None
        return newest[1].time_of_day + time.monotonic() - newest[0]

    # -- one cycle

    def read(self, now: float) -> CarReading:
        """Runs the first half of a cycle, every 10 ms: reads what came, and advances the states of
        the motors.

        Reading and writing are two calls so that a command can be made of the readings of its own
        cycle; one call for both would let every command wait a cycle, 10 ms in which the tail
        swings 0.08 rad. After `stop` it returns the last reading, not armed.
        """
        devices = self.devices
        if devices is None:
            return self.reading
        if devices.radio is not None:
            devices.radio.poll()
        # A command may have been under way while another thread disarmed.
        for motor in devices.group.motors:
            if motor.state in ENERGISED and not self._released:
                motor.set_exit(now)
        devices.group.step(now, self.holds_pitch)
        if devices.group.port is not devices.teensy:
            devices.teensy.poll()
        _watch(devices, now)
        devices.imu.align(now + PERIOD)
        self.reading = self._reader.read(devices, now, self._released)
        return self.reading

    def write(self, command: CarCommand, now: float) -> None:
        """Runs the second half of a cycle: sends the command.

        A value that is not finite, or a negative gain, is a fault of both motors; throttle 0 and
        steering 0 are sent then.
        """
        devices = self.devices
        if devices is None:
            return
        servo = SERVO_PULSES[1]
        throttle = THROTTLE_PULSES[1]
        if command.sound:
            servo = self._mounting.servo_pulse(command.steering_angle)
            throttle = self._mounting.throttle_pulse(command.throttle)
            for motor, values in zip(
                devices.group.motors, (command.tail_pitch, command.tail_roll), strict=False
            ):
                if np.any(values):
                    motor.set_command(MitCommand(*values.tolist()), now)
        else:
            for motor in devices.group.motors:
                motor.set_fault(MotorFault.BAD_COMMAND, f"the controller commands {UNSOUND}", now)
        devices.teensy.set_pulses(servo, throttle)
        if self.reading.named_status.imu_fault == 0.0:
            imu = IMU.read(self.reading.imu)
            devices.teensy.set_attitude(
                imu.roll, imu.pitch, self.imu_time, self.reading.lean, imu.gyro_z
            )
        devices.teensy.commit()
        if devices.radio is not None:
            self._reporter.update(devices.radio, self.reading, now, self.prompt, self.posture)

    # -- the way out

    def stop(self, reason: str) -> None:
        """Sends exit frames several times, throttle 0 and steering 0, then closes everything; from
        every state, at any time.

        Never raises and may be called twice.
        """
        devices = self.devices
        self.devices = None
        self.stop_reason = self.stop_reason or reason
        if devices is None:
            return
        group = devices.group
        off = False
        quietly = contextlib.suppress(Exception)
        for _ in range(_LAST_FRAMES):
            with quietly:  # whatever it is, the next exit frame must get its chance
                group.set_exit(time.monotonic())
                group.step(time.monotonic())
            with quietly:
                devices.teensy.set_pulses(SERVO_PULSES[1], THROTTLE_PULSES[1])
                devices.teensy.commit()
            time.sleep(PERIOD)
        with quietly:
            off = group.port.flush() and not group.port.fault and group.off_confirmed
        if devices.watchdog is not None:
            with quietly:
                devices.watchdog.disarm() if off else devices.watchdog.trip()
        status = self.reading.status.copy()
        status[STATUS.index("armed")] = 0.0
        self.reading = replace(
            self.reading, status=status, fault_text=self.reading.fault_text or self.stop_reason
        )
        if devices.radio is not None:
            with quietly:
                self._reporter.update(devices.radio, self.reading, time.monotonic(), at_once=True)
        with quietly:
            devices.closers.close()
        self.traffic_error = "" if devices.bus is None else devices.bus.log_error


def _watch(devices: Devices, now: float) -> None:
    """Reports the state of the motors to the watchdog, and an unreliable watchdog to the motors."""
    motors = devices.group.motors
    watchdog = devices.watchdog
    if watchdog is None:
        return
    if any(motor.state in ENERGISED for motor in motors):
        if watchdog.reason:
            for motor in motors:
                motor.set_fault(MotorFault.BUS, watchdog.reason, now)
        watchdog.heartbeat()
    elif any(
        motor.fault in (MotorFault.BUS, MotorFault.NO_REPLY) or motor.off_overdue(now)
        for motor in motors
    ):
        watchdog.trip()  # exit frames of our own may not have left
    elif devices.group.off_confirmed:
        watchdog.disarm()
    else:
        watchdog.heartbeat()
