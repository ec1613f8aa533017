"""What a 2 ms step of the whole tailed station costs beside its plant alone, and how fast and
repeatable a run is.
"""

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    System,
)
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.recorder import RunRecorder, recorded_columns
from aerodima.workbench.logs.schema import run_metadata
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from tests.benchmarks.rows import BenchRow
from tests.workbench.made_up_runs import signals_equal

REPEATS = 5
"""Runs of each kind, in turns so that all meet the same disturbances."""
COPIES_OF_A_PORT = 3
"""Systems in Python before each of the three driven ports of a plant, nine in all. A lean station
has six that are evaluated in every step (motors, their friction, air, drive train, servo), and six
at the rate of a sensor or controller."""


class Copy(LeafSystem):
    """Copies its input: the least that a system in Python can do in a step."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self._input = self.DeclareVectorInputPort("input", size)
        self.DeclareVectorOutputPort("output", size, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(vector_of(self._input, context))


def bench_step() -> list[BenchRow]:
    """CPU time per step of driver, controller, estimator and station: lean as in a trial, and
    recorded.

    Peers: the same plant with its tail alone in a diagram, idle (all inputs zero) and driven
    (through the same turn, by the recorded torques, forces and steering angles of the station). The
    rest of the ratio is what the station adds. With Coulomb tyres a driven plant costs half as much
    again, since its contact solver works harder, and the ratio is smaller. What Drake takes to call
    Python at all is the row of copies: some more systems in Python than the lean station evaluates
    in a step, each of which copies its input. Each is stepped through the whole published turn at
    3.33 m/s. The least of all repeats counts, kind by kind.
    """
    scenario = load_scenario("turn_swing")
    inputs = _recorded_inputs(scenario)
    seconds: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(REPEATS):
            taken = {
                "idle": _timed(_bare_plant(scenario, {}), scenario),
                "driven": _timed(_bare_plant(scenario, inputs), scenario),
                "copies": _timed(_bare_plant(scenario, inputs, COPIES_OF_A_PORT), scenario),
                "lean": _timed(
                    Simulator(assemble(scenario, minimal=True).builder.Build()), scenario
                ),
                "whole": _timed(Simulator(assemble(scenario).builder.Build()), scenario),
                "recorded": _recorded_step_seconds(scenario, Path(folder) / f"{repeat}.parquet"),
            }
            for name, step_seconds in taken.items():
                seconds.setdefault(name, []).append(step_seconds)
    least = {name: min(values) * 1e6 for name, values in seconds.items()}
    idle = least["idle"]
    driven = least["driven"]
    step = scenario.simulation.step
    return [
        BenchRow("station_step_over_idle_plant", least["lean"], "us", "", idle),
        BenchRow("station_step_over_driven_plant", least["lean"], "us", "<= 1.6", driven),
        BenchRow("station_step_of_copies_in_python", least["copies"], "us", "", driven),
        BenchRow("station_step_with_truth", least["whole"], "us", "", driven),
        BenchRow("station_step_recorded", least["recorded"], "us", "", driven),
        BenchRow("station_real_time_factor", step / (least["lean"] * 1e-6), "1"),
        BenchRow("station_real_time_factor_recorded", step / (least["recorded"] * 1e-6), "1"),
    ]


def bench_outcome_trial() -> list[BenchRow]:
    """Outcome trials per second of CPU time over runs that record everything, in one process.

    One that survives and one that flips, in turns, the least of each.
    """
    scenarios = [load_scenario("turn_swing"), load_scenario("turn_none", ["manoeuvre.speed=3.61"])]
    seconds: dict[tuple[str, str], float] = {}
    for _ in range(REPEATS):
        for scenario in scenarios:
            for record in ("all", "outcome"):
                start = time.process_time()
                simulate(scenario, record=record)
                key = (record, scenario.name)
                seconds[key] = min(seconds.get(key, float("inf")), time.process_time() - start)
    per_second = {
        record: len(scenarios)
        / sum(value for (kind, _), value in seconds.items() if kind == record)
        for record in ("all", "outcome")
    }
    return [
        BenchRow(
            "outcome_trials_per_cpu_second",
            per_second["outcome"],
            "1/s",
            ">= 2.5",
            per_second["all"],
        )
    ]


def bench_repeated_run() -> list[BenchRow]:
    """1 when a repeated run has the same columns with the same bits, sensor noise included."""
    scenario = load_scenario("turn_swing", ["manoeuvre.duration=3.0"])
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            simulate(scenario, Path(folder) / f"{name}.parquet") for name in ("first", "second")
        )
    return [BenchRow("repeated_run_equal", float(signals_equal(first, second)), "1", "== 1")]


def _recorded_inputs(scenario: Scenario) -> dict[str, PiecewisePolynomial]:
    """What the station feeds its plant through the turn: input port of the plant -> its value over
    time.
    """
    car = assemble(scenario)
    diagram = car.builder.Build()
    simulator = Simulator(diagram)
    plant: Any = car.station.GetSubsystemByName("plant")
    ports = {port.get_name(): port for port in _driven_ports(plant)}
    times: list[float] = []
    values: dict[str, list[np.ndarray]] = {name: [] for name in ports}

    def record(context: Context) -> EventStatus:
        if (
            times and context.get_time() < times[-1] + 0.5 * scenario.simulation.step
        ):  # n x 0.1 s is not m x 2 ms
            return EventStatus.DidNothing()
        plant_context = plant.GetMyContextFromRoot(context)
        times.append(context.get_time())
        for name, port in ports.items():
            values[name].append(np.array(port.Eval(plant_context)).reshape(-1, 1))
        return EventStatus.Succeeded()

    simulator.set_monitor(record)
    simulator.Initialize()
    simulator.AdvanceTo(scenario.manoeuvre.duration)
    return {name: PiecewisePolynomial.ZeroOrderHold(times, rows) for name, rows in values.items()}


def _driven_ports(plant: Any) -> list[Any]:
    """All that drives the car: a port left out would let the peer stand still."""
    car = plant.GetModelInstanceByName("car")
    return [
        plant.get_actuation_input_port(),
        plant.get_applied_generalized_force_input_port(),
        plant.get_desired_state_input_port(car),
    ]


def _bare_plant(
    scenario: Scenario, inputs: dict[str, PiecewisePolynomial], copies: int = 0
) -> Simulator:
    """The plant alone; `inputs` by name of the port, zero where there is none, each through so many
    copies.
    """
    builder = DiagramBuilder()
    plant = add_car_plant(builder, scenario).plant
    for port in _driven_ports(plant):
        held = inputs.get(port.get_name(), PiecewisePolynomial(np.zeros((port.size(), 1))))
        source: System = builder.AddSystem(TrajectorySource(held))
        for _ in range(copies):
            copy = builder.AddSystem(Copy(port.size()))
            builder.Connect(source.get_output_port(), copy.get_input_port())
            source = copy
        builder.Connect(source.get_output_port(), port)
    return Simulator(builder.Build())


def _recorded_step_seconds(scenario: Scenario, path: Path) -> float:
    car = assemble(scenario)
    metadata = run_metadata(scenario.resolved(), scenario.seed)
    with JournalWriter(path, recorded_columns(car.signals), metadata) as journal:
        settings = scenario.simulation
        RunRecorder.add_to_builder(
            car.builder, journal, car.signals, settings.log_rate, settings.step
        )
        return _timed(Simulator(car.builder.Build()), scenario)


def _timed(simulator: Simulator, scenario: Scenario) -> float:
    """Seconds of CPU per step of the plant over the whole run."""
    simulator.Initialize()
    start = time.process_time()
    simulator.AdvanceTo(scenario.manoeuvre.duration)
    return (time.process_time() - start) * scenario.simulation.step / scenario.manoeuvre.duration
