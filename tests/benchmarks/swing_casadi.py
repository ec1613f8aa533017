"""The swing problem in CasADi: the same variables, bounds, linear rows and collocation, the same model traced by it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.optimisation.swing import planar_model as planar
from aerodima.optimisation.swing.solver import FEASIBLE, OPTIMALITY, bounds_of, linear_rows
from aerodima.optimisation.swing.transcription import ACCELERATION, ANGLE, RATE, ROLL, ROLL_RATE, TORQUE, Problem


@dataclass(frozen=True)
class CasadiResult:
    """Scaled variables, wall time of the solver without building the problem, s, and whether it succeeded."""

    x: np.ndarray
    wall_time: float
    success: bool


class CasadiProblem:
    """A single-member planar problem with friction as parameter, ready to be solved by CasADi's IPOPT."""

    def __init__(self, problem: Problem) -> None:
        import casadi as ca  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

        with _traceable(ca):
            self._build(ca, problem)

    def _build(self, ca: Any, problem: Problem) -> None:
        layout, knots = problem.layout, problem.knots
        member = problem.members[0]
        x = ca.SX.sym("x", layout.size)

        def part(where: slice, unit: float) -> np.ndarray:
            return np.array([x[i] * unit for i in range(where.start, where.stop)], dtype=object)

        roll, rate = part(layout.member(0, 0), ROLL), part(layout.member(0, 1), ROLL_RATE)
        torque = part(layout.member(0, 2), TORQUE)
        q, qd, qdd = (part(layout.tail(0, k), unit) for k, unit in enumerate((ANGLE, RATE, ACCELERATION)))
        middle = 0.5 * (knots[1:] + knots[:-1])
        h = np.diff(knots)

        def model(roll: Any, rate: Any, q: Any, qd: Any, qdd: Any, curve: np.ndarray) -> tuple[Any, Any]:
            grip = x[layout.size - 1]
            inputs = np.array(
                [[row[0] * grip, row[1] * grip, row[2], row[3], row[4] * grip, row[5]] for row in curve], dtype=object
            )
            acceleration, motor = planar.motion(roll, rate, (q[:, None], qd[:, None], qdd[:, None]), inputs, member.car)
            return acceleration, motor[:, 0]

        g, motor = model(roll, rate, q, qd, qdd, member.profile.curve(knots))
        rate_m = 0.5 * (rate[1:] + rate[:-1]) + h / 8 * (g[:-1] - g[1:])
        gm, _ = model(
            0.5 * (roll[1:] + roll[:-1]) + h / 8 * (rate[:-1] - rate[1:]),
            rate_m,
            0.5 * (q[1:] + q[:-1]) + h / 8 * (qd[:-1] - qd[1:]),
            0.5 * (qd[1:] + qd[:-1]) + h / 8 * (qdd[:-1] - qdd[1:]),
            0.5 * (qdd[1:] + qdd[:-1]),
            member.profile.curve(middle),
        )
        rows = [
            *((roll[1:] - roll[:-1] - h / 6 * (rate[:-1] + 4 * rate_m + rate[1:])) / ROLL),
            *((rate[1:] - rate[:-1] - h / 6 * (g[:-1] + 4 * gm + g[1:])) / ROLL_RATE),
            *((torque - motor) / TORQUE),
        ]
        low, high = [np.zeros(len(rows))], [np.zeros(len(rows))]
        rows += list(planar.tip_height(roll[1:], q[1:, None], member.car) / 0.1)
        low.append(np.full(len(knots) - 1, problem.limits.clearance / 0.1))
        high.append(np.full(len(knots) - 1, np.inf))
        constraints = ca.vertcat(*rows)
        for A, lower, upper, *_ in linear_rows(problem):
            constraints = ca.vertcat(constraints, ca.DM(ca.sparsify(ca.DM(A))) @ x)
            low.append(lower)
            high.append(upper)
        smooth, own = x[layout.tail(0, 2)], x[layout.member(0, 0)]
        cost = -x[layout.size - 1] + problem.smoothness * ca.sumsqr(smooth) / len(knots)
        cost = cost + problem.margin * ca.sumsqr(own) / len(knots)
        options = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": OPTIMALITY, "constr_viol_tol": 0.1 * FEASIBLE},
        }
        self._solver = ca.nlpsol("swing", "ipopt", {"x": x, "f": cost, "g": constraints}, options)
        self._bounds = (*bounds_of(problem), np.concatenate(low), np.concatenate(high))

    def solve(self, start: np.ndarray) -> CasadiResult:
        """From a start in scaled variables."""
        lower, upper, low, high = self._bounds
        begun = time.perf_counter()
        found = self._solver(x0=start, lbx=lower, ubx=upper, lbg=low, ubg=high)
        wall_time = time.perf_counter() - begun
        return CasadiResult(np.array(found["x"]).ravel(), wall_time, bool(self._solver.stats()["success"]))


@contextmanager
def _traceable(ca: Any) -> Iterator[None]:
    """`planar.lift_state` without its branch against overflow, which a traced symbol has no value for."""

    def lift_state(roll: Any, car: Any) -> tuple[Any, Any, Any]:
        x = (roll - planar.lift_roll(car)) / planar.LIFT_WIDTH
        share = 0.5 * (1.0 + np.tanh(0.5 * x))
        above = np.array([ca.fmax(value, 0) + ca.log1p(ca.exp(-ca.fabs(value))) for value in x], dtype=object)
        return car.half_track * (roll - planar.LIFT_WIDTH * above), share, share * (1.0 - share) / planar.LIFT_WIDTH

    original = planar.lift_state
    planar.lift_state = lift_state
    try:
        yield
    finally:
        planar.lift_state = original
