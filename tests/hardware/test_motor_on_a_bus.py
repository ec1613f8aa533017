"""Motors over real byte streams, in real time: python-can's virtual bus and slcan on a
pseudo-terminal.
"""

import threading
import time

import can
import pytest

from aerodima.hardware.devices.device_states import MotorFault, MotorState
from aerodima.hardware.devices.motor_group import MotorGroup
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.can_bus import BusFault, CanBus
from tests.hardware.fake_can import SlcanAdapter, wait_until
from tests.hardware.fake_motors import PERIOD, FakeMotor, hold, settings

pytestmark = pytest.mark.realtime  # threads and deadlines on the wall clock

EXIT_1, EXIT_2 = make_exit(1).data, make_exit(2).data


class MotorsOnAWire:
    """Two fake motors that answer what a wire brings, and a record of it."""

    def __init__(self):
        self.motors = {1: FakeMotor(1), 2: FakeMotor(2)}
        self.seen: list[tuple[float, int, bytes]] = []
        self._time = time.monotonic()

    def answer(self, arbitration_id, data):
        now = time.monotonic()
        self.seen.append((now, arbitration_id, data))
        for motor in self.motors.values():
            motor.advance(now - self._time)
        self._time = now
        return self.motors[arbitration_id].receive(CanFrame(arbitration_id, data))

    def first_exit(self, motor_id, since):
        times = [
            when
            for when, seen_id, data in self.seen
            if seen_id == motor_id and data == EXIT_1 and when >= since
        ]
        return times[0] - since if times else None


class VirtualWire(MotorsOnAWire):
    channel = "motors_on_a_wire"

    def __init__(self):
        super().__init__()
        self._bus = can.Bus(interface="virtual", channel=self.channel, ignore_config=True)
        self.settings = CanSettings(interface="virtual", channel=self.channel)
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        while self._running:
            message = self._bus.recv(0.05)
            if message is not None:
                for reply in self.answer(message.arbitration_id, bytes(message.data)):
                    self._bus.send(
                        can.Message(arbitration_id=0, data=reply.data, is_extended_id=False)
                    )

    def close(self):
        self._running = False
        self._thread.join()
        self._bus.shutdown()


class SlcanWire(MotorsOnAWire):
    def __init__(self):
        super().__init__()
        self.adapter = SlcanAdapter(self._on_frame)
        self.settings = CanSettings(
            interface="slcan", channel=self.adapter.path, options={"sleep_after_open": 0.0}
        )

    def _on_frame(self, arbitration_id, data):
        for reply in self.answer(arbitration_id, data):
            self.adapter.deliver(0, reply.data)

    def close(self):
        if self.adapter._running:
            self.adapter.unplug()


@pytest.fixture(params=[VirtualWire, SlcanWire], ids=["virtual", "slcan"])
def wire(request):
    wire = request.param()
    yield wire
    wire.close()


@pytest.fixture
def slcan_wire():
    wire = SlcanWire()
    yield wire
    wire.close()


def both():
    return settings("tail pitch", 1), settings("tail roll", 2)


def turn(group, cycles, command=None, until=None):
    """The loop at 100 Hz in real time."""
    due = time.monotonic()
    for _ in range(cycles):
        now = time.monotonic()
        group.step(now)
        if command is not None:
            for motor in group.motors:
                motor.set_command(command, now)
        if until is not None and until():
            return
        due += PERIOD
        time.sleep(max(0.0, due - time.monotonic()))


def running(bus):
    group = MotorGroup(both(), bus)
    group.set_enter(time.monotonic())
    turn(group, 20)
    turn(group, 20, hold(0.0))
    assert [motor.state for motor in group.motors] == [MotorState.RUNNING] * 2, group.fault_text
    return group


def test_motors_are_entered_held_moved_and_exited(wire):
    bus = CanBus.open(wire.settings)
    group = running(bus)
    turn(group, 150, hold(0.4))
    assert [motor.state for motor in group.motors] == [MotorState.RUNNING] * 2, group.fault_text
    assert wire.motors[2].position == pytest.approx(0.4, abs=0.1)
    assert group.motors[1].position == pytest.approx(wire.motors[2].position, abs=0.05)
    assert [motor.bad_frames for motor in group.motors] == [0, 0]
    group.set_exit(time.monotonic())
    assert bus.flush()
    assert wait_until(lambda: not wire.motors[1].entered and not wire.motors[2].entered, 0.5)
    bus.close()


def test_motor_that_falls_silent_is_switched_off_in_time(wire):
    bus = CanBus.open(wire.settings)
    group = running(bus)
    start = time.monotonic()
    wire.motors[2].respond = lambda frame: []
    turn(group, 50, hold(0.0))
    assert group.motors[1].fault is MotorFault.NO_REPLY
    for motor_id in (1, 2):
        # five cycles without a reply, one until the next step, and a margin for two busy cores
        assert wire.first_exit(motor_id, start) < 7 * PERIOD + 0.05
    assert not wire.motors[1].entered
    bus.close()


def test_receive_thread_that_dies_switches_the_motors_off(wire):
    bus = CanBus.open(wire.settings)
    group = running(bus)

    def broken(timeout):
        raise RuntimeError("driver bug")

    bus._bus.recv = broken
    start = time.monotonic()
    turn(group, 50, hold(0.0))
    assert bus.fault is BusFault.RECEIVER_DEAD
    assert {motor.fault for motor in group.motors} <= {
        MotorFault.BUS,
        MotorFault.NO_REPLY,
        MotorFault.OTHER_MOTOR,
    }
    assert wire.first_exit(1, start) < 7 * PERIOD + 0.05
    assert wire.first_exit(2, start) < 7 * PERIOD + 0.05
    bus.close()


def test_adapter_unplugged_ends_in_fault_without_blocking(slcan_wire):
    bus = CanBus.open(slcan_wire.settings)
    group = running(bus)
    slcan_wire.adapter.unplug()
    start = time.monotonic()
    turn(group, 50, hold(0.0))
    assert time.monotonic() - start < 0.7
    assert [motor.state for motor in group.motors] == [MotorState.FAULTED] * 2
    # no exit frame can reach the motors through an adapter that is gone: the reason is on record
    assert bus.fault is BusFault.ADAPTER_LOST
    assert group.motors[0].fault in (MotorFault.BUS, MotorFault.NO_REPLY)
    start = time.monotonic()
    group.set_exit(time.monotonic())
    bus.flush()
    bus.close()
    assert time.monotonic() - start < 1.5
