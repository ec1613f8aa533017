"""What the motor test makes of motors that are not well, on devices in memory and a clock that does
not wait.
"""

import math
import signal
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from aerodima.hardware.car import wired_car
from aerodima.hardware.car.wiring import CarCommand
from aerodima.hardware.devices.device_states import MotorState
from aerodima.hardware.driving import held_car
from aerodima.hardware.driving.motor_test import run_motor_test
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.car.fake_devices import CarOnTheBench
from tests.refusals import assert_refused


class Bench(CarOnTheBench):
    """Devices whose time goes on when somebody waits."""

    def __init__(self, monkeypatch):
        super().__init__()
        self.pitch, self.roll = self.port.motors
        self.roll.position = 0.05
        self.begin = None
        self.spoil = lambda bench: None
        clock = SimpleNamespace(monotonic=lambda: self.now, sleep=lambda _: None)
        monkeypatch.setattr(held_car, "time", clock)
        monkeypatch.setattr(wired_car, "time", clock)
        monkeypatch.setattr(held_car, "wait_until", self.wait)

    def wait(self, due):
        self.now = self.port.now = due
        for motor in self.port.motors:
            motor.advance(0.01)
        self.spoil(self)

    def tried(self, joint, answer=True):
        asked = []
        found = run_motor_test(
            self.car, joint, asked.append, lambda text: asked.append(text) or answer
        )
        return found, asked

    def assert_off(self):
        assert not any(motor.entered for motor in self.port.motors)
        assert self.closed == [1]


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


@pytest.mark.parametrize("joint", ["tail_pitch", "tail_roll"])
def test_a_motor_that_is_well(bench, joint):
    moved, kept = (bench.pitch, bench.roll) if joint == "tail_pitch" else (bench.roll, bench.pitch)
    before = kept.position
    most = []
    bench.spoil = lambda bench: most.append(abs(moved.position - 0.05))
    found, _ = bench.tried(joint)
    assert math.degrees(found.moved) == pytest.approx(5.0, abs=0.5)
    assert max(most) <= math.radians(5.0) + 0.02
    assert moved.position == pytest.approx(
        0.05, abs=0.03
    )  # back again, as far as the trial of its direction let it
    assert kept.position == pytest.approx(before, abs=0.03)
    assert found.temperature == 30.0
    bench.assert_off()


def test_at_the_end_of_its_range_a_joint_goes_the_other_way(bench):
    bench.roll.position = bench.motors[1].motor_angle(math.pi / 2)
    found, asked = bench.tried("tail_roll")
    assert math.degrees(found.moved) == pytest.approx(-5.0, abs=0.5)
    assert "left" in asked[-1]


def block(motor):
    motor.blocked = True
    motor.speed = 0.0


def block_at_the_end_of_arming(bench):
    if bench.car.motors and bench.car.motors[1].state is MotorState.HOLDING:
        block(bench.roll)


def mislead(motor):
    """It reports 0.9 N m more than it makes: less than what a drive looks at."""
    truth = motor.reply

    def reply():
        motor.torque += 0.9
        frame = truth()
        motor.torque -= 0.9
        return frame

    motor.reply = reply


def heat(motor):
    motor.temperature = 70.0


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (None, ("+0.0", "+5")),
        (heat, ("70", "60")),
        (mislead, ("+0.9", "N m", "profile")),
    ],
)
def test_what_is_not_well_is_named_and_the_motors_are_off(bench, spoil, named):
    if spoil is None:
        bench.spoil = block_at_the_end_of_arming
    else:
        spoil(bench.roll)
    assert_refused(lambda: bench.tried("tail_roll"), HardwareError, "tail_roll", *named)
    bench.assert_off()


def test_a_joint_that_cannot_move_is_not_armed(bench):
    block(bench.roll)
    assert_refused(lambda: bench.tried("tail_roll"), HardwareError, "tail roll", "2 N m")
    bench.assert_off()


def test_the_other_way_is_seen_by_people_only(bench):
    work = lambda: bench.tried("tail_roll", answer=False)  # noqa: E731
    assert_refused(work, HardwareError, "tail_roll.direction", "-1")
    bench.assert_off()


def test_without_a_watchdog_test_nothing_is_opened(monkeypatch):
    bench = CarOnTheBench(authorised=False)
    assert_refused(held_car.holding(bench.car).__enter__, HardwareError, "watched_can")
    assert bench.car.devices is None


def test_an_exception_in_the_block_lets_the_tail_go(bench):
    def drop():
        with held_car.holding(bench.car):
            held_car.run_cycles(
                bench.car, CarCommand(tail_roll=np.array([0.1, 0.0, 17.0, 1.0, 0.0]))
            )
            assert bench.roll.entered
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        drop()
    bench.assert_off()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_in_the_block_lets_the_tail_go(bench, number):
    def drop():
        with held_car.holding(bench.car):
            assert bench.roll.entered
            signal.raise_signal(number)

    def stop(reason):
        signal.raise_signal(number)  # somebody is impatient
        switch_off(reason)

    before = signal.getsignal(number)
    switch_off, bench.car.stop = bench.car.stop, stop
    with pytest.raises(KeyboardInterrupt):
        drop()
    bench.assert_off()
    assert signal.getsignal(number) == before


def test_a_car_may_be_held_on_any_thread(bench):
    def hold():
        with held_car.holding(bench.car):
            assert bench.roll.entered

    with ThreadPoolExecutor(1) as pool:
        pool.submit(hold).result()
    bench.assert_off()
