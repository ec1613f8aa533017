"""Swings: the planar problem against CasADi with IPOPT on the same transcription, Drake's DirectCollocation for
reference, and the command as a whole."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

from aerodima.optimisation.swing.full_car import drive
from aerodima.optimisation.swing.solver import cost_of, solve
from aerodima.optimisation.swing.swing_construction import constant_rate_swing
from aerodima.optimisation.swing.swing_problem import random_start
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.simulate.simulation import simulate
from tests.benchmarks.rows import BenchRow
from tests.benchmarks.swing_casadi import CasadiProblem
from tests.benchmarks.swing_direct_collocation import solve_directly
from tests.optimisation.screening_gate import reduced_seconds
from tests.optimisation.swing.turn import problem

_EXAMPLE = (
    *("--set", "manoeuvre.speed=4.5", "--set", "controller.swing_speed=5.0", "--set", "car.tyre_friction=0.75"),
    *("--threshold", "0.5"),
)
KNOTS, STARTS, DIRECT_STARTS = 41, 7, 3


def bench_planar_swing() -> Iterator[BenchRow]:
    """Wall times over the same starts; peer: CasADi's IPOPT, without and with the time to build its functions.

    What our side sets up (written-out model, programme) is in both rows: in its first solve, and in every one.
    """
    posed = problem(knots=KNOTS)
    import_module("casadi")  # is no part of building
    begun = time.perf_counter()
    peer = CasadiProblem(posed)
    building = time.perf_counter() - begun
    ours, theirs, costs = [], [], []
    converged = 0
    for number in range(STARTS):
        start = random_start(posed, np.random.default_rng([1, number]))
        solution, other = solve(posed, start), peer.solve(start)
        converged += solution.success
        if solution.success and other.success:
            ours.append(solution.wall_time)
            theirs.append(other.wall_time)
            costs.append((solution.cost, cost_of(posed, other.x)))
    yield BenchRow("planar swing, N = 41, one solve", float(np.median(ours)), "s", "<= 0.7", float(np.median(theirs)))
    name = f"planar swing, N = 41, {STARTS} starts with what both set up"
    yield BenchRow(name, sum(ours), "s", "<= 0.7", building + sum(theirs))
    gap = max(abs(own - other) / abs(other) for own, other in costs)
    yield BenchRow("planar swing, objective against CasADi", gap, "1", "<= 0.01")
    yield BenchRow("planar swing, share of random starts converged", converged / STARTS, "1", ">= 0.95")


def bench_direct_collocation() -> Iterator[BenchRow]:
    """Our solve over that of DirectCollocation, and the frictions that both reach, the worst of the same starts."""
    posed = problem(knots=KNOTS)
    ours, theirs, gaps = [], [], []
    for number in range(DIRECT_STARTS):
        start = random_start(posed, np.random.default_rng([1, number]))
        solution, direct = solve(posed, start), solve_directly(posed, start)
        if solution.success and direct.success:
            ours.append(solution.wall_time)
            theirs.append(direct.wall_time)
            gaps.append(abs(solution.parameter / direct.grip - 1.0))
    yield BenchRow(
        "planar swing, N = 41, against DirectCollocation", float(np.median(ours)), "s", "", float(np.median(theirs))
    )
    yield BenchRow("planar swing, friction reached against DirectCollocation", max(gaps), "1", "<= 0.01")


def bench_optimise_command() -> Iterator[BenchRow]:
    """Wall time of the README's example, and of its verification on its own car and one more at the fine step."""
    aerodima = str(Path(sys.executable).with_name("aerodima"))
    with tempfile.TemporaryDirectory() as folder:
        swing = Path(folder) / "swing.yaml"
        begun = time.perf_counter()
        find = [aerodima, "optimise", "swing", "turn_swing", *_EXAMPLE, "--out", str(swing)]
        subprocess.run(find, check=True, capture_output=True)
        found = time.perf_counter() - begun
        verify = [aerodima, "verify", str(swing), "--members", "1", "--out", f"{folder}/verify"]
        judged = subprocess.run(verify, check=False, capture_output=True)
        if judged.returncode not in (0, 2):  # 2: it is judged, and not verified
            raise RuntimeError(judged.stderr.decode())
        whole = time.perf_counter() - begun
    yield BenchRow("optimise swing, 1-DoF example", found, "s", "<= 5")
    yield BenchRow("optimise swing, 1-DoF example, with its verification", whole, "s", "<= 15")


def bench_rolling_start() -> list[BenchRow]:
    """Trials per second of CPU time of a search over swings and frictions, over the same from rest, in one process.

    Two swings at four frictions each; the two straights that they share are part of it.
    """
    scenario = load_scenario("turn_swing", ["manoeuvre.speed=4.5"])
    swings = [
        constant_rate_swing("even", scenario, length=length, knots=41, provenance={"source": "bench"})
        for length in (0.9, 1.0)
    ]
    seconds = {True: 0.0, False: 0.0}
    for friction in (0.61, 0.64, 0.67, 0.7):
        for swing in swings:
            for rolling in seconds:
                begun = time.process_time()
                drive(scenario, swing, friction, rolling=rolling)
                seconds[rolling] += time.process_time() - begun
    rolled, rest = (8 / seconds[rolling] for rolling in (True, False))
    return [BenchRow("trials of a swing search that share their straight", rolled, "1/s", ">= 1.4", rest)]


def bench_screening() -> list[BenchRow]:
    """Reduced runs among many per second of CPU time, over trials of the full car, in one process."""
    scenario = load_scenario("turn_designed")
    simulate(scenario, record="outcome")
    begun = time.process_time()
    for _ in range(3):
        simulate(scenario, record="outcome")
    full = 3 / (time.process_time() - begun)
    return [BenchRow("screening, reduced runs", 1.0 / reduced_seconds([scenario]), "1/s", ">= 20", full)]
