"""What a 2 ms step of the whole tailed station costs beside its bare plant, and how fast and repeatable a run is."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.benchmarks.rows import BenchRow
from workbench.logs.journal import JournalWriter
from workbench.logs.recorder import RunRecorder, recorded_columns
from workbench.logs.schema import run_metadata, signals_equal
from workbench.plants.car import add_car_plant
from workbench.run import assemble, run_scenario
from workbench.scenario import Scenario, load_scenario

REPEATS = 5
"""Runs of each kind, in turns so that all meet the same disturbances; one more of each, first, is not counted."""


def bench_step() -> list[BenchRow]:
    """Time per step of driver, controller, estimator and station, without and with the recorder; peer: the bare plant.

    The bare plant is the same car with the same tail, alone in its diagram, all inputs zero. Each is stepped through
    the whole published turn at 3.33 m/s.
    """
    scenario = load_scenario("turn_swing")
    with tempfile.TemporaryDirectory() as folder:
        seconds: dict[str, list[float]] = {"bare": [], "station": [], "recorded": []}
        for repeat in range(REPEATS + 1):
            journal = Path(folder) / f"{repeat}.parquet"
            for name, step_seconds in (
                ("bare", _bare_step_seconds(scenario)),
                ("station", _station_step_seconds(scenario)),
                ("recorded", _recorded_step_seconds(scenario, journal)),
            ):
                if repeat > 0:
                    seconds[name].append(step_seconds)
    bare, station, recorded = (statistics.median(taken) * 1e6 for taken in seconds.values())
    step = scenario.simulation.step
    return [
        BenchRow("station_step", station, "us", "<= 2.0", bare),
        BenchRow("station_step_recorded", recorded, "us", "", bare),
        BenchRow("station_real_time_factor", step / (station * 1e-6), "1"),
        BenchRow("station_real_time_factor_recorded", step / (recorded * 1e-6), "1"),
    ]


def bench_repeated_run() -> list[BenchRow]:
    """1 when a repeated run has the same columns with the same bits, sensor noise included."""
    scenario = load_scenario("turn_swing", ["manoeuvre.duration=3.0"])
    with tempfile.TemporaryDirectory() as folder:
        first, second = (run_scenario(scenario, Path(folder) / f"{name}.parquet") for name in ("first", "second"))
    return [BenchRow("repeated_run_equal", float(signals_equal(first, second)), "1", "== 1")]


def _bare_step_seconds(scenario: Scenario) -> float:
    builder = DiagramBuilder()
    car = add_car_plant(builder, scenario)
    simulator = Simulator(builder.Build())
    context = car.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    assert car.tail is not None
    for instance in (car.car, car.tail):
        for port in (car.plant.get_actuation_input_port(instance), car.plant.get_desired_state_input_port(instance)):
            port.FixValue(context, np.zeros(port.size()))
    return _timed(simulator, scenario)


def _station_step_seconds(scenario: Scenario) -> float:
    return _timed(Simulator(assemble(scenario).builder.Build()), scenario)


def _recorded_step_seconds(scenario: Scenario, path: Path) -> float:
    car = assemble(scenario)
    metadata = run_metadata(scenario.resolved(), scenario.seed)
    with JournalWriter(path, recorded_columns(car.signals), metadata) as journal:
        RunRecorder.add_to_builder(car.builder, journal, car.signals, scenario.simulation.log_rate)
        return _timed(Simulator(car.builder.Build()), scenario)


def _timed(simulator: Simulator, scenario: Scenario) -> float:
    """Seconds per step of the plant over the whole run."""
    simulator.Initialize()
    start = time.perf_counter()
    simulator.AdvanceTo(scenario.manoeuvre.duration)
    return (time.perf_counter() - start) * scenario.simulation.step / scenario.manoeuvre.duration
