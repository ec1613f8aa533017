"""Swings: the planar problem against CasADi with IPOPT on the same transcription, Drake's DirectCollocation for
reference, and the command as a whole."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from aerodima.optimisation.swing.solver import cost_of, solve
from aerodima.optimisation.swing.swing_problem import random_start
from tests.benchmarks.rows import BenchRow
from tests.benchmarks.swing_casadi import CasadiProblem
from tests.benchmarks.swing_direct_collocation import solve_directly
from tests.optimisation.swing.turn import problem

_EXAMPLE = (
    *("--set", "manoeuvre.speed=4.5", "--set", "controller.swing_speed=5.0", "--set", "car.tyre_friction=0.75"),
    *("--threshold", "0.5"),
)
KNOTS, STARTS, DIRECT_STARTS = 41, 7, 3


def bench_planar_swing() -> Iterator[BenchRow]:
    """Median wall time over the same starts; peer: CasADi's IPOPT, without the time to build its functions."""
    posed = problem(knots=KNOTS)
    peer = CasadiProblem(posed)
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
    yield BenchRow("optimise swing, 1-DoF example", found, "s")
    yield BenchRow("optimise swing, 1-DoF example, with its verification", whole, "s", "<= 60")
