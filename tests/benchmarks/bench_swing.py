"""The planar swing problem: SNOPT through MathematicalProgram against CasADi with IPOPT on the same transcription."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optimisation.swing.solve import cost_of, solve
from optimisation.swing.start import random_start
from tests.benchmarks.rows import BenchRow
from tests.benchmarks.swing_casadi import CasadiProblem
from tests.optimisation.swing.turn import problem

KNOTS, STARTS = 41, 7


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
