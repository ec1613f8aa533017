import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from aerodima.workbench.control.controller_systems import TurnDriver
from aerodima.workbench.control.manoeuvre import (
    DriverInput,
    SpeedRamp,
    ThrottleLine,
    TurnSchedule,
)
from aerodima.workbench.core.errors import UserError
from tests.refusals import assert_refused

SCHEDULE = TurnSchedule(SpeedRamp(4.0, 1.0, ThrottleLine(10.0, -1.0)), 1.0, 0.5, 2.0, 0.5)


class CountingSchedule:
    def __init__(self):
        self.times = []

    def at(self, time):
        self.times.append(time)
        return SCHEDULE.at(time)


def test_schedule_is_asked_exactly_once_every_10_ms():
    schedule = CountingSchedule()
    simulator = Simulator(TurnDriver(schedule))
    schedule.times.clear()
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(schedule.times, 0.01 * np.arange(100), atol=1e-12)


def test_outputs_hold_the_schedule_from_the_first_instant():
    driver = TurnDriver(SCHEDULE)
    context = driver.CreateDefaultContext()
    assert driver.GetOutputPort("throttle").Eval(context)[0] == pytest.approx(0.1)
    assert driver.GetOutputPort("planned_turn").Eval(context)[0] == 1.0


def test_rate_must_be_positive():
    assert_refused(lambda: TurnDriver(SCHEDULE, rate=0.0), UserError, "controller.rate", "0")


class LooksAtTheCar:
    """Steers the roll rate, announces the yaw rate, and counts its ticks as throttle."""

    sources = ("imu", "pose")

    def __init__(self):
        self.seen = []

    def start(self):
        return np.array([0.0])

    def step(self, memory, seen):
        self.seen.append(seen)
        return memory + 1.0, DriverInput(seen.roll_rate, float(memory[0]), seen.yaw_rate)


def test_a_law_sees_pose_and_rates_of_its_ports():
    law = LooksAtTheCar()
    driver = TurnDriver(law)
    context = driver.CreateDefaultContext()
    imu = np.zeros(9)
    imu[3], imu[5] = 0.2, 0.3  # gyro about x and z
    driver.GetInputPort("imu").FixValue(context, imu)
    half = 0.5 * np.pi / 3.0
    driver.GetInputPort("pose").FixValue(
        context, [np.cos(half), 0.0, 0.0, np.sin(half), 4.0, 5.0, 0.0, 2.0]
    )
    seen = driver.view(context)
    assert (seen.position, seen.speed, seen.roll_rate, seen.yaw_rate) == ((4.0, 5.0), 2.0, 0.2, 0.3)
    assert seen.heading == pytest.approx(np.pi / 3.0)
    assert seen.course == pytest.approx(np.pi / 2.0)


def test_a_standing_car_has_the_course_of_its_heading():
    driver = TurnDriver(LooksAtTheCar())
    context = driver.CreateDefaultContext()
    driver.GetInputPort("imu").FixValue(context, np.zeros(9))
    driver.GetInputPort("pose").FixValue(context, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.01, 0.01])
    assert driver.view(context).course == 0.0


def test_memory_of_a_law_is_state_and_a_reset_context_repeats_a_run():
    driver = TurnDriver(LooksAtTheCar())
    simulator = Simulator(driver)

    def throttle_after_a_tenth():
        context = simulator.get_mutable_context()
        driver.GetInputPort("imu").FixValue(context, np.zeros(9))
        driver.GetInputPort("pose").FixValue(context, [1.0, *np.zeros(7)])
        simulator.Initialize()
        simulator.AdvanceTo(0.095)
        return driver.GetOutputPort("throttle").Eval(context)[0]

    assert throttle_after_a_tenth() == 9.0, "the tenth tick, at 0.09 s, saw a memory of 9"
    simulator.reset_context(driver.CreateDefaultContext())
    assert throttle_after_a_tenth() == 9.0


def test_a_driver_that_needs_the_pose_is_refused_beside_a_real_car():
    builder = DiagramBuilder()
    ports = {"steering_angle": 1, "throttle": 1}
    station = builder.AddSystem(NoPlant(ports))
    assert_refused(
        lambda: TurnDriver.add_to_builder(builder, LooksAtTheCar(), station=station),
        UserError,
        "driver",
    )


class NoPlant(LeafSystem):
    def __init__(self, inputs):
        super().__init__()
        for name, size in inputs.items():
            self.DeclareVectorInputPort(name, size)
        self.DeclareVectorOutputPort("imu", 9, lambda context, out: None)
