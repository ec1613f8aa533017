import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.systems.analysis import Simulator

from aerodima.workbench.control.controller_systems import TailController
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_machine import SwingLaw
from aerodima.workbench.control.tail_law import UNKNOWN_IMU, observe
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.signal_table import IMU, STATUS, TAIL_STATE
from tests.refusals import assert_refused
from tests.workbench.control.published_law import published

PROMPT = published()
HOLD, SWING, SETTLE = float(SwingState.HOLD), float(SwingState.SWING), float(SwingState.SETTLE)


class Bench:
    """The controller with its inputs in hand."""

    def __init__(self, law=None):
        self.controller = TailController(law or SwingLaw(PROMPT))
        self.simulator = Simulator(self.controller)
        self.context = self.simulator.get_mutable_context()
        self.show(roll=-math.pi / 2)

    def show(self, roll=-math.pi / 2, yaw_rate=0.0, **status):
        zeros = dict.fromkeys(TAIL_STATE.fields, 0.0)
        self.fix("tail_state", TAIL_STATE.write(**(zeros | {"roll_angle": roll})))
        self.fix("imu", IMU.write(**(dict.fromkeys(IMU.fields, 0.0) | {"gyro_z": yaw_rate})))
        self.fix(
            "status", STATUS.write(**(dict.fromkeys(STATUS.fields, 0.0) | {"armed": 1.0} | status))
        )
        self.fix("planned_turn", [1.0])

    def fix(self, port, value):
        self.controller.GetInputPort(port).FixValue(self.context, value)

    def advance(self, until):
        self.simulator.AdvanceTo(until)
        return self.read("state")[0]

    def read(self, port):
        return self.controller.GetOutputPort(port).Eval(self.context)


class CountingLaw:
    """The law, and the times at which it was asked."""

    def __init__(self, settings=None):
        self._law = SwingLaw(settings or PROMPT)
        self.rate = self._law.rate
        self.memory_size = self._law.memory_size
        self.start = self._law.start
        self.times = []

    def step(self, memory, observation):
        self.times.append(observation.time)
        return self._law.step(memory, observation)


@pytest.mark.parametrize("rate", [100.0, 50.0])
def test_law_is_called_exactly_once_in_each_of_its_periods(rate):
    law = CountingLaw(published(rate=rate))
    Bench(law).advance(0.999)
    assert_allclose(law.times, np.arange(rate) / rate, atol=1e-12)


def test_holds_triggers_swings_and_settles():
    bench = Bench()
    assert bench.advance(0.105) == HOLD
    bench.show(yaw_rate=1.2)
    assert bench.advance(0.109) == HOLD, "nothing changes between ticks"
    assert bench.advance(0.115) == SWING
    assert_allclose(bench.read("tail_roll_command"), [0.0, 8.0, 0.0, 3.0, 0.0])
    assert_allclose(bench.read("tail_pitch_command"), [0.0, 0.0, 17.0, 5.0, 0.0])
    bench.show(roll=0.8, yaw_rate=3.0)
    assert bench.advance(0.125) == SETTLE


def test_silent_source_does_not_trigger():
    bench = Bench()
    bench.advance(0.05)
    bench.show(yaw_rate=3.0, imu_age=0.11)
    assert bench.advance(0.2) == HOLD
    bench.show(yaw_rate=3.0, imu_age=0.02)
    assert bench.advance(0.3) == SWING


def test_reset_context_repeats_the_run():
    """All memory is state: the same system run from a fresh context starts again in HOLD."""
    bench = Bench()
    bench.advance(0.05)
    bench.show(yaw_rate=3.0)
    assert bench.advance(0.1) == SWING
    bench.simulator.reset_context(bench.controller.CreateDefaultContext())
    bench.context = bench.simulator.get_mutable_context()
    bench.show()
    bench.simulator.Initialize()
    assert bench.advance(0.05) == HOLD


def test_age_limit_must_be_positive():
    assert_refused(
        lambda: TailController(SwingLaw(PROMPT), age_limit=0.0),
        UserError,
        "controller.age_limit",
        "0",
    )


@pytest.mark.parametrize(
    ("status", "unknown"),
    [
        ({}, set()),
        ({"imu_age": 0.11}, {"imu"}),
        ({"imu_age": math.nan}, {"imu"}),
        ({"imu_fault": 1.0}, {"imu"}),
        ({"tail_roll_age": 0.11}, {"roll_angle", "roll_rate"}),
        ({"tail_roll_fault": 3.0}, {"roll_angle", "roll_rate"}),
        ({"tail_pitch_age": 0.11}, {"pitch_angle", "pitch_rate"}),
        ({"tail_pitch_fault": 2.0}, {"pitch_angle", "pitch_rate"}),
        ({"speed_fault": 1.0}, {"speed"}),
        ({"speed_age": 5.0}, set()),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_a_law_is_not_given_what_a_silent_or_faulty_source_reports(status, unknown):
    """A GPS is late by nature: only its fault makes the speed unknown."""
    given = dict.fromkeys(STATUS.fields, 0.0) | status
    observation = observe(
        0.5,
        np.array([0.1, 0.2, 0.0, 0.3, 0.4, 0.0]),
        np.arange(9.0),
        STATUS.write(**given),
        1.0,
        np.array([3.5]),
    )
    expected = {
        "pitch_angle": 0.1,
        "roll_angle": 0.2,
        "pitch_rate": 0.3,
        "roll_rate": 0.4,
        "speed": 3.5,
        "imu": tuple(np.arange(9.0)),
    } | dict.fromkeys(unknown, math.nan)
    if "imu" in unknown:
        expected["imu"] = UNKNOWN_IMU
    assert observation.imu_valid == ("imu" not in unknown)
    for name, value in expected.items():
        assert_array_equal(getattr(observation, name), value, err_msg=name)
