import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput

from aerodima.workbench.controllers.controller_systems import TurnDriver
from aerodima.workbench.controllers.manoeuvre import SpeedRamp, ThrottleLine, TurnSchedule
from aerodima.workbench.errors import UserError

SCHEDULE = TurnSchedule(SpeedRamp(4.0, 1.0, ThrottleLine(10.0, -1.0)), 1.0, 0.5, 2.0, 0.5)


class CountingSchedule:
    def __init__(self):
        self.times = []

    def at(self, time):
        self.times.append(time)
        return SCHEDULE.at(time)


def test_ports():
    driver = TurnDriver(SCHEDULE)
    names = [driver.get_output_port(i).get_name() for i in range(driver.num_output_ports())]
    assert names == ["steering_angle", "throttle", "planned_turn"]
    assert all(driver.GetOutputPort(name).size() == 1 for name in names)
    assert not driver.HasAnyDirectFeedthrough()


def test_schedule_is_asked_exactly_once_every_10_ms():
    schedule = CountingSchedule()
    simulator = Simulator(TurnDriver(schedule))
    schedule.times.clear()
    simulator.AdvanceTo(1.0)
    np.testing.assert_allclose(schedule.times, 0.01 * np.arange(100), atol=1e-12)


def test_steering_step_lasts_from_2_0_to_2_5_s():
    builder = DiagramBuilder()
    driver = builder.AddSystem(TurnDriver(SCHEDULE))
    log = LogVectorOutput(driver.GetOutputPort("steering_angle"), builder, publish_period=0.002)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(3.0)
    record = log.FindLog(simulator.get_context())
    turning = record.sample_times()[record.data()[0] > 0.0]
    # Published values are those before the updates of the same instant, so the step shows one log step late.
    assert turning[0] == pytest.approx(2.002)
    assert turning[-1] == pytest.approx(2.5)


def test_outputs_hold_the_schedule_from_the_first_instant():
    driver = TurnDriver(SCHEDULE)
    context = driver.CreateDefaultContext()
    assert driver.GetOutputPort("throttle").Eval(context)[0] == pytest.approx(0.1)
    assert driver.GetOutputPort("planned_turn").Eval(context)[0] == 1.0


def test_rate_must_be_positive():
    with pytest.raises(UserError, match=r"controller.rate: 0 Hz"):
        TurnDriver(SCHEDULE, rate=0.0)
