"""Commands to the car and readings of it, one of each per cycle, in every wiring (design
section 14).

In `teensy_bridge` everything goes through the text frames of the Teensy. `watched_can` has the
motors on a CAN adapter of the computer, the Teensy for servo, throttle and sail, and the Teensy on
the motors' bus as watchdog. Both are a `WiredCar`, with the same readings, the same faults and the
same end. Plain NumPy: it runs where Drake has no wheel.
"""

import math
from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from aerodima.hardware.car.bus_watch import BusWatch
from aerodima.hardware.car.mounting import Mounting
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.radio_link import IDLE, RadioLink
from aerodima.hardware.devices.sensor_threads import SensorThread
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.protocol.radio import (
    REPORT_PERIOD,
    CarReport,
    OperatorCommand,
    OperatorPrompt,
    make_report,
)
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.scenario.signal_table import (
    IMU,
    STATUS,
    STATUS_SOURCES,
    TAIL_COMMAND,
    TAIL_STATE,
    TAIL_TORQUE,
)

_Sources = dict[str, tuple[float, int, str]]
"""Age (s), fault, and fault in words of each source, by its name."""
WiringName = Literal["teensy_bridge", "watched_can"]
WIRINGS: tuple[WiringName, ...] = get_args(WiringName)
UNSOUND = "NaN, infinity or a negative gain"
"""Values that are never sent to a motor, in words."""
PERIOD = 0.01
"""Time between two cycles of every loop that talks to the car, s."""
_FORCE_SHARE = 0.05
"""Weight of a sample in the mean force: a time constant of 0.2 s at 100 Hz. A car that lies is
beyond 60 degrees after that time; an impact of 4 g for 50 ms, or a drive at 1.5 g, is not."""
_RATE_WINDOW = 0.02
"""Window over which the sail's rate is taken, s, as in the simulated encoder."""
_REST_FIRST = "put the switch in IDLE first"
_UNKNOWN_FAULT = 255
"""Largest fault code of a report: codes of the status port are small; a larger one is cut to this
and is still a fault."""


def wiring_name(name: str) -> WiringName:
    """Returns the wiring of that name; raises a `HardwareError` that lists the known ones."""
    for known in WIRINGS:
        if known == name:
            return known
    raise HardwareError(f"--wiring {name}: allowed: {', '.join(WIRINGS)}")


@dataclass
class Devices:
    """The open devices of a car.

    Attributes:
        group: tail motors, on the CAN bus or, in the bridge, on the Teensy itself.
        teensy: link to the Teensy, with servo, throttle and sail.
        imu: thread that reads the IMU.
        gps: thread that reads the GPS; None where it is not fitted.
        radio: link to the operator's radio; None where it is not fitted.
        closers: stack that closes all of them.
        watchdog: the Teensy as watchdog on the motors' bus; None in the bridge, where the text
            frames are the heartbeat.
        bus: bus of the motors; None in the bridge.
    """

    group: MotorGroup
    teensy: TeensyLink
    imu: SensorThread[Bno055Sample]
    gps: SensorThread[GpsSample] | None
    radio: RadioLink | None
    closers: ExitStack
    watchdog: BusWatch | None = None
    bus: CanBus | None = None


@dataclass(frozen=True)
class CarCommand:
    """One cycle's commands, in the units and signs of the station's input ports; the default asks
    for nothing.

    Attributes:
        steering_angle: commanded steering angle, rad, positive to the left.
        throttle: commanded throttle, -1 to 1.
        tail_pitch: command of the pitch motor, (5,) as
            `aerodima.workbench.scenario.signal_table.TAIL_COMMAND`.
        tail_roll: command of the roll motor, (5,), likewise.
    """

    steering_angle: float = 0.0
    throttle: float = 0.0
    tail_pitch: FloatArray = field(default_factory=TAIL_COMMAND.zeros)
    tail_roll: FloatArray = field(default_factory=TAIL_COMMAND.zeros)

    @property
    def sound(self) -> bool:
        """Returns whether every number is finite, and no gain of a motor negative."""
        numbers = np.concatenate(
            ([self.steering_angle, self.throttle], self.tail_pitch, self.tail_roll)
        )
        gains = np.concatenate((self.tail_pitch[2:4], self.tail_roll[2:4]))
        return bool(np.all(np.isfinite(numbers)) and np.all(gains >= 0.0))


@dataclass(frozen=True)
class CarReading:
    """Readings of a cycle, as the station's output ports give them.

    Values hold their last sample.

    Attributes:
        tail_state: angles and rates of tail and sail, (6,)
            `aerodima.workbench.scenario.signal_table.TAIL_STATE`, rad and rad/s.
        tail_torque: torques of the tail motors, (2,) N m.
        imu: reading of the IMU, (9,) `aerodima.workbench.scenario.signal_table.IMU`.
        speed: speed by the GPS, (1,) m/s.
        status: state of the sources, (13,) `aerodima.workbench.scenario.signal_table.STATUS`: ages
            in s (infinite before the first sample), faults, armed.
        operator: last command of the operator, for driving by radio.
        lean: lean of the car by its accelerometer, rad from upright.
        fault_text: the worst fault in words; empty while there is none.
        fault_texts: faults of the sources in words, by the name of the source.
    """

    tail_state: FloatArray = field(default_factory=TAIL_STATE.zeros)
    tail_torque: FloatArray = field(default_factory=TAIL_TORQUE.zeros)
    imu: FloatArray = field(default_factory=IMU.zeros)
    speed: FloatArray = field(default_factory=partial(np.zeros, 1))
    status: FloatArray = field(default_factory=STATUS.zeros)
    operator: OperatorCommand = IDLE
    fault_text: str = ""
    lean: float = 0.0
    fault_texts: dict[str, str] = field(default_factory=dict)

    @property
    def named_status(self) -> Any:
        """The status as a named tuple."""
        return STATUS.read(self.status)


class CarReader:
    """Maker of the readings of a car; values hold their last sample.

    Attributes:
        imu_time: time at which the newest sample of the IMU was taken, s on `time.monotonic`; NaN
            before the first.
    """

    def __init__(self, mounting: Mounting) -> None:
        self._mounting = mounting
        self._sail = _SailRate()
        self._tail = np.zeros((2, 3))
        self._imu = IMU.zeros()
        self._speed = np.zeros(1)
        self._force = np.array([0.0, 0.0, STANDARD_GRAVITY])
        self._lean = 0.0
        self.imu_time = math.nan

    def read(self, devices: Devices, now: float, released: bool) -> CarReading:
        """Makes the reading at `now` (s, monotonic); without motors `released` counts as armed."""
        motors = devices.group.motors
        for index, motor in enumerate(motors):
            if math.isfinite(motor.position):
                self._tail[index] = motor.position, motor.speed, motor.torque
        newest = devices.imu.newest
        if newest is not None and newest[0] != self.imu_time:
            self.imu_time = newest[0]
            self._imu = self._mounting.imu_reading(newest[1])
            self._lean = self._lean_of(newest[1])
        solution = None if devices.gps is None else devices.gps.newest
        if solution is not None and solution[1].fix:
            self._speed = np.array([solution[1].speed])
        sail, sail_rate = self._sail.update(devices.teensy, self._mounting)
        pitch, roll = self._tail
        tail_state = np.array([pitch[0], roll[0], sail, pitch[1], roll[1], sail_rate])
        sources = _sources(devices, now)
        texts = {name: text for name, (_, _, text) in sources.items()}
        status = {"armed": float(devices.group.ready if motors else released)}
        for source, (age, fault, _) in sources.items():
            status |= {f"{source}_age": age, f"{source}_fault": float(fault)}
        return CarReading(
            tail_state=tail_state,
            tail_torque=self._tail[:, 2].copy(),
            imu=self._imu,
            speed=self._speed,
            status=STATUS.write(**status),
            operator=IDLE if devices.radio is None else devices.radio.command,
            fault_text=_worst(devices, texts),
            lean=self._lean,
            fault_texts=texts,
        )

    def _lean_of(self, sample: Bno055Sample) -> float:
        """Returns the angle between the car's z axis and the mean force that it feels, rad.

        The chip takes gravity off by its attitude. Put back by the same attitude the sum is what
        was measured, whatever the attitude says; at rest it points upwards.
        """
        force = np.array(sample.acceleration) + STANDARD_GRAVITY * sample.rotation[2]
        self._force += _FORCE_SHARE * (self._mounting.chip_to_body @ force - self._force)
        x, y, z = self._force.tolist()
        return math.atan2(math.hypot(x, y), z)


def _sources(devices: Devices, now: float) -> _Sources:
    """Returns age (s), fault, and the fault in words, of every source."""
    teensy = devices.teensy
    imu = devices.imu
    gps = devices.gps
    radio = devices.radio
    sources: _Sources = dict.fromkeys(STATUS_SOURCES, (0.0, SourceFault.NOT_FITTED, ""))
    sources["sail"] = teensy.age(now), teensy.fault, teensy.fault_text
    sources["imu"] = imu.age(now), *imu.fault(now)
    for name, motor in zip(("tail_pitch", "tail_roll"), devices.group.motors, strict=False):
        sources[name] = motor.age(now), motor.fault, motor.fault_text
    if gps is not None:
        fault, text = gps.fault(now)
        if fault is SourceFault.NONE and gps.newest is not None and not gps.newest[1].fix:
            fault = SourceFault.NO_FIX
            text = "the GPS has no fix"
        sources["speed"] = gps.age(now), fault, text
    if radio is not None:
        sources["operator"] = radio.age(now), *radio.fault(now)
    return sources


def _worst(devices: Devices, texts: dict[str, str]) -> str:
    """Returns the fault that is reported: an emergency stop before all others, then motors, Teensy,
    operator, IMU, GPS.
    """
    stopped = devices.radio is not None and devices.radio.stopped
    others = [texts[name] for name in ("operator", "imu", "speed")]
    first = others[:1] if stopped else []
    ordered = [*first, devices.group.fault_text, devices.teensy.fault_text, *others]
    return next(filter(None, ordered), "")


class _SailRate:
    """Sail angle and rate from the Teensy's replies, each with the time at which it was sent."""

    def __init__(self) -> None:
        self._past: deque[Pair] = deque(maxlen=64)
        self._seen = (0.0, 0.0)

    def update(self, teensy: TeensyLink, mounting: Mounting) -> Pair:
        """Returns angle (in [0, 2 pi) rad) and rate (rad/s); zeros before the first reply."""
        sent = teensy.sent_time
        past = self._past
        if not math.isfinite(sent) or (past and sent <= past[-1][0]):
            return self._seen
        angle = mounting.sail_angle(teensy.sail)
        past.append((sent, angle))
        while len(past) > 2 and sent - past[1][0] >= _RATE_WINDOW - 1e-3:
            past.popleft()
        span = sent - past[0][0]
        if span > 1e-3:
            rate = math.remainder(angle - past[0][1], 2.0 * math.pi) / span
        else:
            rate = 0.0
        self._seen = angle, rate
        return self._seen


class CarReporter:
    """Sender of a car's reports to its operator.

    Args:
        has_tail: whether the car has tail motors.
        car: number of the car, which tells it from others on the channel.
    """

    def __init__(self, has_tail: bool, car: int) -> None:
        self._has_tail = has_tail
        self._car = car
        self._due = 0.0
        self._sequence = 0

    def update(
        self,
        radio: RadioLink,
        reading: CarReading,
        now: float,
        prompt: OperatorPrompt = OperatorPrompt.NONE,
        posture: str = "",
        at_once: bool = False,
    ) -> None:
        """Sends a report when one is due.

        Args:
            radio: link to the operator's radio.
            reading: reading of the car to report.
            now: time, s, monotonic.
            prompt: what the operator must do before the car drives.
            posture: posture of the tail of a car that stops, in words.
            at_once: whether to send a report even if none is due.
        """
        if now < self._due and not at_once:
            return
        self._due = now + REPORT_PERIOD
        self._sequence += 1
        status = reading.named_status
        tail = TAIL_STATE.read(reading.tail_state)
        imu = IMU.read(reading.imu)
        torque = TAIL_TORQUE.read(reading.tail_torque)
        codes = np.minimum(reading.status[1::2], _UNKNOWN_FAULT)
        text = "; ".join(filter(None, (reading.fault_text, posture)))
        if not text and prompt is OperatorPrompt.RETURN_TO_IDLE:
            text = _REST_FIRST
        report = CarReport(
            armed=status.armed == 1.0,
            stopped=radio.stopped,
            mode=reading.operator.mode,
            faults=tuple(codes.astype(int).tolist()),
            yaw_rate=imu.gyro_z,
            roll=imu.roll,
            tail_pitch=tail.pitch_angle,
            tail_roll=tail.roll_angle,
            torque_pitch=torque.pitch,
            torque_roll=torque.roll,
            speed=float(reading.speed[0]),
            operator_age=status.operator_age,
            text=text,
            prompt=prompt,
            has_tail=self._has_tail,
            car=self._car,
        )
        radio.report(make_report(report, self._sequence))
