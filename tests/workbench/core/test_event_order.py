"""Sensors, controllers, logs and plant steps: one order at every tick, whatever the step."""

from itertools import pairwise

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_sensors import GpsSpeed, Imu, MotorEncoder
from aerodima.workbench.car.roll_estimator import RollEstimator
from aerodima.workbench.control.controller_systems import TailController, TurnDriver
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.core.event_order import (
    EVENT_OFFSET,
    EventPriority,
    nominal_time,
    period_of,
    row_period,
    step_instant,
)
from aerodima.workbench.logs.recorder import RunRecorder
from aerodima.workbench.scenario.scenario import load_scenario

STEPS = [0.004, 0.002, 0.001, 0.0005, 0.0003]
"""s; the last one divides no period of a tick, and no power of ten."""

TRACED = [
    (Imu, "_sample", "sensor"),
    (MotorEncoder, "_sample", "sensor"),
    (GpsSpeed, "_sample", "sensor"),
    (TailController, "_tick", "controller"),
    (RollEstimator, "_tick", "controller"),
    (TurnDriver, "_tick", "controller"),  # at one rate
    (RunRecorder, "_record", "row"),
]
ORDER = ["sensor", "controller", "row", "step"]


class Ticker(LeafSystem):
    """Writes into a trace whenever the plant steps: period and offset are the plant's."""

    def __init__(self, step, trace):
        super().__init__()
        self.DeclarePeriodicDiscreteUpdateEvent(
            step, 0.0, lambda context, _: trace.append(("step", context.get_time()))
        )
        self.DeclareDiscreteState(1)


def scenario_at(step, duration=2.9, **more):
    rate = 250.0 if step == 0.004 else min(1.0 / step, 1000.0)
    settings = {
        "simulation.step": step,
        "simulation.log_rate": rate,
        "manoeuvre.duration": duration,
        **more,
    }
    return load_scenario("turn_swing", [f"{key}={value!r}" for key, value in settings.items()])


def traced(trace, who, original):
    def call(self, context, *rest):
        trace.append((who, context.get_time()))
        return original(self, context, *rest)

    return call


def trace_of(step, monkeypatch):
    """(who, context time) in the order in which Drake let them act, over a whole turn."""
    trace = []
    for owner, name, who in TRACED:
        monkeypatch.setattr(owner, name, traced(trace, who, getattr(owner, name)))
    scenario = scenario_at(step)
    car = assemble(scenario)
    sink = type("Sink", (), {"append": lambda self, row: None})()
    RunRecorder.add_to_builder(
        car.builder, sink, car.signals[:6], scenario.simulation.log_rate, step
    )
    car.builder.AddSystem(Ticker(step, trace))
    simulator = Simulator(car.builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(scenario.manoeuvre.duration)
    return trace


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS)
def test_all_that_happens_at_one_instant_happens_in_one_order_at_every_tick(step, monkeypatch):
    """Times apart by more than rounding are two instants; within one, stages follow each other and
    the step is last.
    """
    trace = trace_of(step, monkeypatch)
    start = [who for who, time in trace if time == 0.0]
    assert {"controller", "row"} <= set(start[: start.index("step")])
    trace = trace[len(start) :]
    while trace[-1][0] != "step":  # the run ends before the last instant's step
        trace.pop()
    instants = [[trace[0]]]
    for before, event in pairwise(trace):
        assert event[1] >= before[1]
        if event[1] - before[1] > 1e-6:
            instants.append([])
        instants[-1].append(event)
    assert len(instants) >= 2.8 / step
    met = set()
    for instant in instants:
        ranks = [ORDER.index(who) for who, _ in instant]
        assert ranks == sorted(ranks)
        for (who, time), (other, later) in pairwise(instant):
            published = (who, other) == ("row", "step")  # Drake publishes before it updates
            assert who == other or time < later or published, "two stages at the same Drake time"
        met.add(tuple(dict.fromkeys(who for who, _ in instant)))
    if step in (0.002, 0.001):  # every tick falls on a step and every step has its row
        assert met == {("row", "step"), tuple(ORDER)}


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.002, 0.001, 0.0005])
def test_steering_and_swing_act_on_the_step_of_the_tick_that_commands_them(step):
    """No latency but what is modelled, at any step: the row after a command has the knuckle and the
    tail moving.
    """
    log = simulate(scenario_at(step, 2.7, **{"simulation.log_rate": 1.0 / step}))
    time = log.time
    command = log.signal("steering_command_rad")
    assert time[np.flatnonzero(command)[0]] == pytest.approx(2.0, abs=1e-12)
    knuckle = log.signal("plant_position_car_front_left_steering_q")
    before = knuckle[np.searchsorted(time, 2.0 - 1e-9)]
    steered = np.abs(knuckle - before) > 0.1 * 3.74 * step  # the servo turns at 3.74 rad/s
    assert time[np.flatnonzero(steered & (time >= 2.0))[0]] == pytest.approx(2.0 + step, abs=1e-9)
    swing = np.flatnonzero(log.signal("controller_state") == SwingState.SWING)[0]
    torque = log.signal("tail_roll_torque_n_m")
    assert abs(torque[swing] - torque[swing - 1]) > 1.0, (
        "the motor follows the command within the row of the tick"
    )


class Watching:
    """A law of some rate that notes when it saw which steering command."""

    memory_size = 1

    def __init__(self, rate):
        self.rate = rate
        self.seen = []

    def start(self):
        return np.zeros(1)

    def step(self, memory, observation):
        self.seen.append((observation.time, observation.steering_angle))
        return memory, np.zeros(5), np.zeros(5), 0


@pytest.mark.parametrize(("rate", "later"), [(100.0, 0.01), (50.0, 0.02), (333.0, 1 / 333)])
def test_a_law_sees_what_the_driver_did_at_the_tick_before_at_one_rate_and_at_two(rate, later):
    law = Watching(rate)
    scenario = scenario_at(0.004, **{"manoeuvre.speed_ramp": 0.5, "manoeuvre.turn_start": 1.0})
    simulator = Simulator(assemble(scenario, tail_law=law, minimal=True).builder.Build())
    simulator.AdvanceTo(1.05)
    first = next(time for time, angle in law.seen if angle != 0.0)
    assert first == pytest.approx(1.0 + later, abs=1e-9)


def test_a_law_of_ones_own_ticks_on_a_car_without_tail_too():
    law = Watching(100.0)
    car = assemble(load_scenario("turn_none"), tail_law=law, minimal=True)
    Simulator(car.builder.Build()).AdvanceTo(0.1)
    assert len(law.seen) == 11


@pytest.mark.parametrize("step", STEPS)
def test_the_instant_of_a_step_has_the_bits_with_which_drake_computes_it(step):
    for k in (1, 7, 1450, 19_999):
        assert step_instant(round(k * step, 9), step) == k * step
        assert step_instant((k + 0.5) * step, step) is None


def test_stages_are_further_apart_than_rounding_and_closer_than_anything_physical():
    times = np.arange(1, 200_001)
    for rate in (10.0, 100.0, 333.0, 1000.0):
        exact = times / rate
        early = [
            times * period_of(rate, stage) for stage in sorted(EventPriority, reverse=True)
        ] + [exact]
        gaps = np.diff(early, axis=0)
        assert np.all(gaps > 1e5 * np.spacing(exact))
        assert np.all(exact - early[0] <= 7 * EVENT_OFFSET * exact)
        np.testing.assert_allclose(
            [nominal_time(time, rate) for time in early[0][:100]], exact[:100], rtol=1e-15
        )


@pytest.mark.parametrize(
    ("rate", "step"),
    [(500.0, 0.002), (500.0, 0.0005), (250.0, 0.001), (500.0, 0.0004), (100.0, 0.003)],
)
def test_rows_share_the_bits_of_a_step_or_come_before_it(rate, step):
    """Every row is at the step's instant to the bit, or between the step before and its own
    instant; never after.
    """
    period = row_period(rate, step)
    numbers = np.arange(1.0, 20_001.0)
    steps = numbers * step
    rows = numbers * period
    ratio = 1.0 / (rate * step)
    if period == round(ratio) * step:
        assert np.isin(rows[: int(20_000 / ratio)], steps).all()
    else:
        before = numbers / rate
        assert ((rows < before) & (rows > before * (1.0 - 1e-8))).all()
