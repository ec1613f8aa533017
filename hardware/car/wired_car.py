"""What both wirings share: the car's devices behind `Wiring`, each cycle's order of things, the way out."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from aerodima.hardware.car.car_devices import Devices
from aerodima.hardware.car.car_reading import CarReporter, ListeningPort, SailRate
from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.wiring import CarCommand, CarReading, WiringName
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import ENERGISED, MotorFault, SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.devices.sensor_threads import SensorThread
from aerodima.hardware.devices.teensy_link import TeensyFault
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.protocol.ak70 import MitCommand
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.protocol.radio import Asks
from aerodima.hardware.protocol.teensy import SERVO_PULSES, THROTTLE_PULSES
from aerodima.workbench.config.signal_table import IMU, STATUS
from aerodima.workbench.errors import HardwareError

_LAST_STRINGS = 5
"""Strings with throttle 0 and exit that are sent at the end, one every 10 ms."""
_CYCLE = 0.01
_ROLL, _PITCH = IMU.index("roll"), IMU.index("pitch")
_TEENSY_FAULTS = {
    TeensyFault.NONE: SourceFault.NONE,
    TeensyFault.NO_REPLY_YET: SourceFault.NO_SAMPLE_YET,
    TeensyFault.SILENT: SourceFault.SILENT,
    TeensyFault.LOST: SourceFault.LOST,
    TeensyFault.WATCHDOG_ACTED: SourceFault.REPORTED,
}


class WiredCar:
    """A car on its cables: `Wiring` for both wirings; `open_direct_can` and `open_teensy_bridge` make it.

    Args:
        name: of the wiring.
        motors: settings of pitch and roll; none for a car without a tail.
        mounting, safety: signs and limits.
        open_devices: opens every port; what it opened before a failure it closes itself.
        authorise: raises `HardwareError` while no watchdog test of this wiring is recorded.
        car: its number, for the operator's station.

    Attributes:
        devices: open ones; None before `start` and after `stop`.
        group: the motors.
        reading: of the last cycle.
        stop_reason: of the first `stop`, empty before.
        asks: what the operator is told to do; see `Wiring`.
        traffic_error: what stopped the log of the CAN traffic, known after `stop`; empty if nothing did.
    """

    def __init__(
        self,
        name: WiringName,
        motors: tuple[MotorSettings, ...],
        mounting: Mounting,
        safety: DriveSafety,
        open_devices: Callable[[], Devices],
        authorise: Callable[[], None],
        car: int = 0,
    ) -> None:
        self.name: WiringName = name
        self._settings = motors
        self._mounting, self._safety = mounting, safety
        self._open_devices, self._authorise = open_devices, authorise
        self.devices: Devices | None = None
        self.group: MotorGroup | None = None
        self._port: ListeningPort | None = None
        self.reading = CarReading()
        self.stop_reason = ""
        self.asks = Asks.NOTHING
        self.traffic_error = ""
        self._sail = SailRate()
        self._reporter = CarReporter(bool(motors), car)
        self._released = False  # by hand; what stands for `armed` where there are no motors
        self._tail_seen = np.zeros((2, 3))
        self._imu_seen = (math.nan, self.reading.imu)
        self._speed_seen = self.reading.speed

    # -- from off to armed

    def authorise(self) -> None:
        """Raises `HardwareError` where the tail's motors may not be switched on; a car without a tail has none."""
        if self._settings:
            self._authorise()

    def start(self) -> None:
        """Opens everything. See `Wiring.start`."""
        if self.devices is not None or self.stop_reason:
            raise HardwareError(f"{self.name}: was started already")
        self.devices = self._open_devices()
        self._port = ListeningPort(self.devices.motor_port)
        self.group = MotorGroup(self._settings, self._port)

    def arm(self) -> None:
        """Begins to switch the motors on. See `Wiring.arm`."""
        devices, group = self._open()
        self.authorise()
        if devices.teensy.fault:
            raise HardwareError(devices.teensy.fault_text)
        self._released = True
        if not self._settings:
            return
        if devices.watchdog is not None:
            devices.watchdog.arm()
        group.set_enter(time.monotonic())

    def hold(self, now: float) -> None:
        """Holds the tail. See `Wiring.hold`; nothing after `stop`."""
        if self.devices is not None and self.group is not None:
            self.group.set_hold(now)

    def disarm(self, now: float) -> None:
        """Switches the motors off. See `Wiring.disarm`; after `stop` they are."""
        self._released = False
        if self.devices is not None and self.group is not None:
            self.group.set_exit(now)

    def reset(self, now: float) -> None:
        """Forgets faults and the operator's stop, by hand only. See `Wiring.reset`."""
        devices, group = self._open()
        self._released = False
        group.reset(now)
        if devices.radio is not None:
            devices.radio.clear_stop()

    def _open(self) -> tuple[Devices, MotorGroup]:
        if self.devices is None or self.group is None:
            raise HardwareError(f"{self.name}: is not started" + (f" ({self.stop_reason})" * bool(self.stop_reason)))
        return self.devices, self.group

    @property
    def unwatched(self) -> str:
        """Why the watchdog of this wiring cannot be relied on, in words; empty while it can, or before `start`."""
        watchdog = None if self.devices is None else self.devices.watchdog
        return "" if watchdog is None or watchdog.healthy else watchdog.reason

    def replies(self, motor_id: int) -> list[tuple[float, CanFrame]]:
        """The newest frames that name a motor, with their arrival (s), oldest first."""
        heard = () if self._port is None else self._port.heard
        return [(when, frame) for when, frame in heard if frame.data[:1] == bytes([motor_id])]

    # -- one cycle

    def read(self, now: float) -> CarReading:
        """See `Wiring.read`; after `stop` the last reading, not armed."""
        if self.devices is None or self.group is None:
            return self.reading
        devices, group = self.devices, self.group
        if devices.radio is not None:
            devices.radio.poll()
        group.step(now)
        if devices.motor_port is not devices.teensy:
            devices.teensy.poll()
        self._watch(devices, group, now)
        devices.imu.align(now + _CYCLE)
        self.reading = self._read(devices, group, now)
        return self.reading

    def write(self, command: CarCommand, now: float) -> None:
        """See `Wiring.write`; nothing after `stop`."""
        if self.devices is not None and self.group is not None:
            self._send(self.devices, self.group, command, now)
            if self.devices.radio is not None:
                self._reporter.turn(self.devices.radio, self.reading, now, self.asks)

    def _watch(self, devices: Devices, group: MotorGroup, now: float) -> None:
        if devices.watchdog is None:
            return
        if any(motor.state in ENERGISED for motor in group.motors):
            if not devices.watchdog.healthy:
                for motor in group.motors:
                    motor.set_fault(MotorFault.BUS, devices.watchdog.reason, now)
            devices.watchdog.beat()
        elif any(
            motor.fault in (MotorFault.BUS, MotorFault.NO_REPLY) or motor.off_overdue(now) for motor in group.motors
        ):
            devices.watchdog.trip()  # exit frames of our own may not have left
        elif all(motor.off_confirmed for motor in group.motors):
            devices.watchdog.disarm()
        else:
            devices.watchdog.beat()

    def _send(self, devices: Devices, group: MotorGroup, command: CarCommand, now: float) -> None:
        if command.finite:
            servo = self._mounting.servo_pulse(command.steering_angle)
            throttle = self._mounting.throttle_pulse(command.throttle)
            for motor, values in zip(group.motors, (command.tail_pitch, command.tail_roll), strict=False):
                if np.any(values):
                    motor.set_command(MitCommand(*values.tolist()), now)
        else:
            servo, throttle = SERVO_PULSES[1], THROTTLE_PULSES[1]
            for motor in group.motors:
                motor.set_fault(MotorFault.BAD_COMMAND, "the controller commands NaN or infinity", now)
        devices.teensy.set_pulses(servo, throttle)
        taken, imu = self._imu_seen
        devices.teensy.set_attitude(float(imu[_ROLL]), float(imu[_PITCH]), taken)
        devices.teensy.commit()

    # -- what is known

    def _read(self, devices: Devices, group: MotorGroup, now: float) -> CarReading:
        for index, motor in enumerate(group.motors):
            if math.isfinite(motor.position):
                self._tail_seen[index] = motor.position, motor.speed, motor.torque
        sail, sail_rate = self._sail.of(devices.teensy, self._mounting)
        (pitch, roll) = self._tail_seen
        return CarReading(
            tail_state=np.array([pitch[0], roll[0], sail, pitch[1], roll[1], sail_rate]),
            tail_torque=self._tail_seen[:, 2].copy(),
            imu=self._imu(devices.imu),
            speed=self._speed(devices.gps),
            status=self._status(devices, group, now),
            operator=IDLE if devices.radio is None else devices.radio.command,
            fault_text=self._fault_text(devices, group, now),
        )

    def _imu(self, imu: SensorThread[Bno055Sample]) -> np.ndarray:
        newest = imu.newest
        if newest is not None and newest[0] != self._imu_seen[0]:
            self._imu_seen = newest[0], self._mounting.imu_reading(newest[1])
        return self._imu_seen[1]

    def _speed(self, gps: SensorThread[GpsSample] | None) -> np.ndarray:
        newest = None if gps is None else gps.newest
        if newest is not None and newest[1].fix:
            self._speed_seen = np.array([newest[1].speed])
        return self._speed_seen

    def _status(self, devices: Devices, group: MotorGroup, now: float) -> np.ndarray:
        ages = {"sail": devices.teensy.age(now), "imu": devices.imu.age(now)}
        faults = {"sail": _TEENSY_FAULTS[devices.teensy.fault], "imu": devices.imu.fault(now)[0]}
        for name, motor in zip(("tail_pitch", "tail_roll"), group.motors, strict=False):
            ages[name], faults[name] = motor.age(now), motor.fault  # type: ignore[assignment]
        if devices.gps is not None:
            ages["speed"], faults["speed"] = devices.gps.age(now), self._gps_fault(devices.gps, now)[0]
        if devices.radio is not None:
            ages["operator"], faults["operator"] = devices.radio.age(now), self._operator_fault(devices, now)[0]
        values = {"armed": float(group.ready if group.motors else self._released)}
        for source in ("tail_pitch", "tail_roll", "sail", "imu", "speed", "operator"):
            values[f"{source}_age"] = ages.get(source, 0.0)
            values[f"{source}_fault"] = float(faults.get(source, SourceFault.NOT_FITTED))
        return STATUS.write(**values)

    def _gps_fault(self, gps: SensorThread[GpsSample], now: float) -> tuple[SourceFault, str]:
        fault, text = gps.fault(now)
        if fault is SourceFault.NONE and gps.newest is not None and not gps.newest[1].fix:
            return SourceFault.NO_FIX, "the GPS has no fix"
        return fault, text

    def _operator_fault(self, devices: Devices, now: float) -> tuple[SourceFault, str]:
        radio = devices.radio
        if radio is None:
            return SourceFault.NOT_FITTED, "there is no radio"
        if radio.stopped:
            return SourceFault.STOPPED, "the operator asked for an emergency stop"
        if devices.radio_serial is not None and not devices.radio_serial.healthy:
            return SourceFault.LOST, f"the radio's port is lost: {devices.radio_serial.error}"
        age = radio.age(now)
        if math.isinf(age):
            rejected = f" ({radio.rejected} frames rejected: {radio.last_error})" if radio.rejected else ""
            return SourceFault.NO_SAMPLE_YET, f"the operator's radio has not been heard yet{rejected}"
        if age > self._safety.operator_silence:
            return SourceFault.SILENT, f"the operator's radio is silent for {age:.2f} s"
        return SourceFault.NONE, ""

    def _fault_text(self, devices: Devices, group: MotorGroup, now: float) -> str:
        texts = [self._operator_fault(devices, now)] if devices.radio is not None else []
        gps = [] if devices.gps is None else [self._gps_fault(devices.gps, now)]
        others = [text for _, text in (*texts, devices.imu.fault(now), *gps) if text]
        stopped = devices.radio is not None and devices.radio.stopped
        named = [*(others[:1] if stopped else ()), group.fault_text, devices.teensy.fault_text, *others]
        return next((text for text in named if text), "")

    @property
    def teensy_time(self) -> float:
        """When the Teensy sent its last reply, s on the clock of `time.monotonic`; NaN before the first."""
        return math.nan if self.devices is None else self.devices.teensy.sent_time

    @property
    def imu_time(self) -> float:
        """When the newest sample of the IMU was taken, s on the same clock; NaN before the first."""
        return self._imu_seen[0]

    # -- the way out

    def stop(self, reason: str) -> None:
        """See `Wiring.stop`."""
        devices, group = self.devices, self.group
        self.stop_reason = self.stop_reason or reason
        self.devices = None
        if devices is None:
            return
        for _ in range(_LAST_STRINGS):
            if group is not None:
                with contextlib.suppress(Exception):  # whatever it is, the next exit frame must get its chance
                    group.set_exit(time.monotonic())
                    group.step(time.monotonic())
            with contextlib.suppress(Exception):
                devices.teensy.set_pulses(SERVO_PULSES[1], THROTTLE_PULSES[1])
                devices.teensy.commit()
            time.sleep(_CYCLE)
        off = False
        with contextlib.suppress(Exception):
            off = devices.motor_port.flush() and not devices.motor_port.fault
        if devices.watchdog is not None:
            off = off and (group is None or all(motor.off_confirmed for motor in group.motors))
            with contextlib.suppress(Exception):
                devices.watchdog.disarm() if off else devices.watchdog.trip()
        status = self.reading.status.copy()
        status[STATUS.index("armed")] = 0.0
        self.reading = replace(self.reading, status=status, fault_text=self.reading.fault_text or self.stop_reason)
        if devices.radio is not None:
            with contextlib.suppress(Exception):
                self._reporter.turn(devices.radio, self.reading, time.monotonic(), at_once=True)
        for close in devices.closers:
            with contextlib.suppress(Exception):
                close()
        self.traffic_error = devices.traffic_error()
