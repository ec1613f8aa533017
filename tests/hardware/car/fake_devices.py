"""Devices in memory for `WiredCar`: a bus with two motors in simulated time, a Teensy, sensors and
a radio.
"""

import math
import time
from contextlib import ExitStack
from types import SimpleNamespace

from aerodima.hardware.car.car_ports import ports_from_dict
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import Devices
from aerodima.hardware.car.wirings import tail_motors
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.devices.radio_link import IDLE, RadioLink
from aerodima.hardware.devices.ublox import GpsSample
from aerodima.hardware.protocol.radio import OperatorCommand, OperatorPrompt, RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware.fake_motors import FakeMotor, FakePort

PORTS = {"schema": "aerodima/ports/1", "teensy": {"path": "/dev/a"}, "imu": {"path": "/dev/b"}}


class FakeTeensyLink:
    def __init__(self):
        self.fault = SourceFault.NONE
        self.fault_text = ""
        self.sail = -0.2
        self.sent_time = math.nan
        self.pulses = []
        self.noted = None

    def age(self, now):
        return 0.005

    def poll(self):
        return []

    def set_pulses(self, servo, throttle):
        self.noted = (servo, throttle)

    def set_attitude(self, *attitude):
        self.attitude = attitude

    def commit(self):
        self.pulses.append(self.noted)


class FakeSensor:
    def __init__(self, sample):
        self.newest = (0.0, sample)
        self.code = SourceFault.NONE
        self.text = ""
        self.aligned = None

    def align(self, due):
        self.aligned = due

    def age(self, now):
        return now - self.newest[0]

    def fault(self, now):
        return self.code, self.text


class ImuAtRest(FakeSensor):
    """A chip on a car that stands: a new sample every 10 ms, with the noise of one."""

    def __init__(self):
        super().__init__(None)

    @property
    def newest(self):
        tick = int(time.monotonic() / 0.01)
        return 0.01 * tick, Bno055Sample(
            (1.0, 0.0, 0.0, 0.0), (0.001 * (tick % 3), 0.0, 0.0), (0.01, 0.0, 0.0)
        )

    @newest.setter
    def newest(self, value):
        pass

    def age(self, now):
        return 0.004


class FakeRadio(RadioLink):
    """An operator who goes to IDLE first when the car asks for it, and then back to what was
    chosen.
    """

    def __init__(self):
        self.car = None
        super().__init__(SimpleNamespace(fault=""), load_drive_safety().operator_silence)
        self.command = OperatorCommand(RadioMode.AUTO)
        self.silence = 0.05
        self.reports = []

    @property
    def command(self):
        return (
            IDLE
            if self.car is not None and self.car.prompt is OperatorPrompt.RETURN_TO_IDLE
            else self._chosen
        )

    @command.setter
    def command(self, chosen):
        self._chosen = chosen

    def report(self, data):
        self.reports.append(data)

    def poll(self):
        pass

    def age(self, now):
        return self.silence


class FakeWatchdog:
    def __init__(self):
        self.calls = []
        self.reason = ""

    def arm(self):
        self.calls.append("arm")

    def heartbeat(self):
        self.calls.append("beat")

    def disarm(self):
        self.calls.append("disarm")

    def trip(self):
        self.calls.append("trip")


class CarOnTheBench:
    def __init__(self, *settings, authorised=True):
        self.scenario = load_scenario("auto_turn", list(settings))
        self.port = FakePort([FakeMotor(1, 0.05), FakeMotor(2, -1.5)])
        self.teensy = FakeTeensyLink()
        self.radio = FakeRadio()
        self.watchdog = FakeWatchdog()
        level = Bno055Sample((1.0, 0.0, 0.0, 0.0), (0.1, -0.2, 0.9), (1.0, 2.0, 3.0))
        self.imu = FakeSensor(level)
        self.gps = FakeSensor(GpsSample(3.3, True, 10.0))
        self.closed = []
        mounting = load_mounting()
        self.motors = tail_motors(self.scenario, ports_from_dict(PORTS), mounting)
        group = MotorGroup(self.motors, self.port)
        closers = ExitStack()
        closers.callback(self.closed.append, 1)
        devices = Devices(
            group, self.teensy, self.imu, self.gps, self.radio, closers, self.watchdog
        )

        def authorise():
            if not authorised:
                raise HardwareError("no watchdog test of watched_can is recorded")

        self.devices = devices
        self.car = WiredCar("watched_can", bool(self.motors), mounting, lambda: devices, authorise)
        self.radio.car = self.car
        self.now = 10.0

    def cycle(self, command, count=1):
        for _ in range(count):
            self.now += 0.01
            self.port.now = self.now
            for motor in self.port.motors:
                motor.advance(0.01)
            reading = self.car.read(self.now)
            self.car.write(command, self.now)
        return reading
