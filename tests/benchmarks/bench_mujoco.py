"""The tailless flip speed against MuJoCo: the same car, each engine at the coarsest step that it can afford."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.plants.car import add_car_plant
from aerodima.workbench.simulate.simulation import simulate
from tests.benchmarks.mujoco_car import MujocoTurn, load_model
from tests.benchmarks.rows import BenchRow

SCENARIO = "turn_none"
SLOW, FAST = 2.5, 4.5
TOLERANCE = 0.05
"""m/s; also how far the answer of a coarse step may be from that of the fine one."""
FINE = 0.0005
STEPS = (0.005, 0.004, 0.002, 0.001)
"""s, coarsest first."""
STANDING_STEPS = 1000


def bench_flip_speed() -> Iterator[BenchRow]:
    """Time to find the flip speed to 0.05 m/s, each engine at its own coarsest sufficient step; then one step."""
    engines = {"Drake": _flips_in_drake, "MuJoCo": _flips_in_mujoco}
    seconds = {}
    for name, flips in engines.items():
        fine, _ = _flip_speed(partial(flips, step=FINE))
        yield BenchRow(f"tailless flip speed, {name}, {1000 * FINE:g} ms", fine, "m/s")
        for step in STEPS:
            speed, seconds[name] = _flip_speed(partial(flips, step=step))
            if abs(speed - fine) <= TOLERANCE:
                break
        yield BenchRow(f"tailless flip speed, {name}, {1000 * step:g} ms", speed, "m/s")
    yield BenchRow(
        "tailless flip speed to 0.05 m/s, Drake over MuJoCo", seconds["Drake"], "s", "<= 1", seconds["MuJoCo"]
    )


def bench_raw_step() -> Iterator[BenchRow]:
    """One step of the standing car at 2 ms: plant alone, without controller, sensors and log."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

    scenario = load_scenario(SCENARIO)
    step = scenario.simulation.step
    builder = DiagramBuilder()
    add_car_plant(builder, scenario)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    start = time.perf_counter()
    simulator.AdvanceTo(0.1 + STANDING_STEPS * step)
    ours = (time.perf_counter() - start) / STANDING_STEPS
    model = load_model(scenario, step)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 50)
    start = time.perf_counter()
    mujoco.mj_step(model, data, STANDING_STEPS)
    theirs = (time.perf_counter() - start) / STANDING_STEPS
    yield BenchRow("raw step of the standing car, Drake over MuJoCo", 1e6 * ours, "us", "", 1e6 * theirs)


def _flip_speed(flips: Callable[[float], bool]) -> tuple[float, float]:
    """Middle of the bracket (m/s), and the wall time (s) of the bisection."""
    low, high = SLOW, FAST
    start = time.perf_counter()
    while high - low > TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if flips(middle) else (middle, high)
    return 0.5 * (low + high), time.perf_counter() - start


def _scenario(speed: float, step: float) -> Scenario:
    rate = min(500.0, 1.0 / step)
    settings = [f"manoeuvre.speed={speed!r}", f"simulation.step={step!r}", f"simulation.log_rate={rate:g}"]
    return load_scenario(SCENARIO, settings)


def _flips_in_drake(speed: float, step: float) -> bool:
    return metrics_of(simulate(_scenario(speed, step), record="outcome")).outcome.result == "flipped"


def _flips_in_mujoco(speed: float, step: float) -> bool:
    return MujocoTurn(_scenario(speed, step), step).flips()
