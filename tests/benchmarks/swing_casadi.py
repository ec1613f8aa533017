"""The swing problem in CasADi: the same variables, bounds, linear rows and collocation, the same model traced by it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.optimisation.swing import reduced_model
from aerodima.optimisation.swing.solver import FEASIBLE, OPTIMALITY, bounds_of
from aerodima.optimisation.swing.swing_problem import ROLL, ROLL_RATE, TORQUE, SwingProblem
from aerodima.optimisation.swing.transcription import constraints


@dataclass(frozen=True)
class CasadiResult:
    """Scaled variables, wall time of the solver without building the problem, s, and whether it succeeded."""

    x: np.ndarray
    wall_time: float
    success: bool


class CasadiProblem:
    """A single-member planar problem with friction as parameter, ready to be solved by CasADi's IPOPT."""

    def __init__(self, problem: SwingProblem) -> None:
        import casadi as ca  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

        self._build(ca, problem)

    def _build(self, ca: Any, problem: SwingProblem) -> None:
        layout, knots = problem.layout, problem.knots
        member = problem.members[0]
        x = ca.SX.sym("x", layout.size)

        def part(places: np.ndarray) -> np.ndarray:
            return np.array([x[int(i)] * problem.units[i] for i in places], dtype=object)

        car, tail = layout.cars[0], layout.tail[0]
        roll, rate, torque = part(car.roll), part(car.rate), part(car.torque[0])
        q, qd, qdd = (part(places) for places in tail)
        middle = 0.5 * (knots[1:] + knots[:-1])
        h = np.diff(knots)

        def model(roll: Any, rate: Any, q: Any, qd: Any, qdd: Any, curve: np.ndarray) -> tuple[Any, Any]:
            grip = x[layout.size - 1]
            inputs = np.array(
                [[row[0] * grip, row[1] * grip, row[2], row[3], row[4] * grip, row[5]] for row in curve], dtype=object
            )
            acceleration, motor = reduced_model.motion(
                roll, rate, (q[:, None], qd[:, None], qdd[:, None]), inputs, member.car
            )
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
        rows += list(reduced_model.tip_height(roll[1:], q[1:, None], member.car) / 0.1)
        low.append(np.full(len(knots) - 1, problem.limits.clearance / 0.1))
        high.append(np.full(len(knots) - 1, np.inf))
        all_rows = ca.vertcat(*rows)
        for block in constraints(problem):
            if block.linear:
                A = block.jacobian(np.zeros(layout.size))
                all_rows = ca.vertcat(all_rows, ca.DM(ca.sparsify(ca.DM(A))) @ x)
                low.append(block.bounds[0])
                high.append(block.bounds[1])
        smooth, own = x[tail.acceleration.tolist()], x[car.roll.tolist()]
        cost = -x[layout.size - 1] + problem.smoothness * ca.sumsqr(smooth) / len(knots)
        cost = cost + problem.margin * ca.sumsqr(own) / len(knots)
        options = {
            "print_time": False,
            "ipopt": {"print_level": 0, "sb": "yes", "tol": OPTIMALITY, "constr_viol_tol": 0.1 * FEASIBLE},
        }
        self._solver = ca.nlpsol("swing", "ipopt", {"x": x, "f": cost, "g": all_rows}, options)
        self._bounds = (*bounds_of(problem), np.concatenate(low), np.concatenate(high))

    def solve(self, start: np.ndarray) -> CasadiResult:
        """From a start in scaled variables."""
        lower, upper, low, high = self._bounds
        begun = time.perf_counter()
        found = self._solver(x0=start, lbx=lower, ubx=upper, lbg=low, ubg=high)
        wall_time = time.perf_counter() - begun
        return CasadiResult(np.array(found["x"]).ravel(), wall_time, bool(self._solver.stats()["success"]))
