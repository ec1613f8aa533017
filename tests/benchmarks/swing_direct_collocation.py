"""The planar swing problem in Drake's DirectCollocation, for reference: the reduced model as a system with AutoDiff.

DirectCollocation knows neither parameters nor dynamics that change with time (it ignores the latter without a word), so
time and friction are states here, with the derivatives 1 and 0. The limits of the torque and of the tail's height are
left out: it has no place for an output that is bounded. The rest is the problem of `swing_problem.SwingProblem`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.planning import DirectCollocation
from pydrake.solvers import SnoptSolver, SolverOptions
from pydrake.systems import framework, scalar_conversion
from pydrake.trajectories import PiecewisePolynomial

from aerodima.optimisation.swing.reduced_car import lift_roll
from aerodima.optimisation.swing.reduced_model import COMPLEX_STEP, motion
from aerodima.optimisation.swing.solver import FEASIBLE, OPTIMALITY
from aerodima.optimisation.swing.swing_problem import (
    ACCELERATION,
    ANGLE,
    RATE,
    ROLL,
    ROLL_RATE,
    ReducedMember,
    SwingProblem,
)

_DRAKE: Any = framework  # the stubs know neither the templates nor arrays of variables
_TEMPLATE: Any = scalar_conversion.TemplateSystem
_HOLD: Any = PiecewisePolynomial.FirstOrderHold

ROLL_PLACE, TAIL_PLACE, ROLL_RATE_PLACE, TAIL_RATE_PLACE, TIME_PLACE, GRIP_PLACE = range(6)
STATE_SCALE = (ROLL, ANGLE, ROLL_RATE, RATE, 1.0, 1.0)
TIME_DIFFERENCE = 1e-6
"""s; to either side, for the slope of the profile over time."""


def _slopes(member: ReducedMember, state: np.ndarray, acceleration: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of the six states, (6,), and its Jacobian with states and control, (6, 7)."""
    before, here, after = member.profile.curve(state[TIME_PLACE] + TIME_DIFFERENCE * np.array([-1.0, 0.0, 1.0]))

    def rolls(point: np.ndarray) -> Any:
        inputs = member.profile.scaled(point[7:], friction=point[GRIP_PLACE] * member.profile.friction)
        tail: Any = (point[1:2], point[3:4], point[6:7])
        return motion(point[0], point[2], tail, inputs, member.car)[0]

    point = np.concatenate([state, [acceleration], here]).astype(complex)
    value = np.array([*state[2:4], rolls(point).real, acceleration, 1.0, 0.0])
    jacobian = np.zeros((6, 7))
    jacobian[0, ROLL_RATE_PLACE] = jacobian[1, TAIL_RATE_PLACE] = jacobian[3, 6] = 1.0
    for place in (0, 1, 2, 3, GRIP_PLACE, 6):
        moved = point.copy()
        moved[place] += 1j * COMPLEX_STEP
        jacobian[2, place] = rolls(moved).imag / COMPLEX_STEP
    moved = point.copy()
    moved[7:] += 1j * COMPLEX_STEP * (after - before) / (2 * TIME_DIFFERENCE)
    jacobian[2, TIME_PLACE] = rolls(moved).imag / COMPLEX_STEP
    return value, jacobian


@_TEMPLATE.define("RollingCar_")  # type: ignore[untyped-decorator, unused-ignore]
def RollingCar_(T: Any) -> Any:  # noqa: N802 (a template of classes)
    """Car and tail under a prescribed tail acceleration: states as the places above, input rad/s2."""

    class Impl(_DRAKE.LeafSystem_[T]):  # type: ignore[misc, valid-type, unused-ignore]
        def _construct(self, member: ReducedMember, converter: Any = None) -> None:
            super().__init__(converter=converter)
            self.member = member
            self.DeclareVectorInputPort("tail_roll_acceleration", 1)
            self.DeclareContinuousState(_DRAKE.BasicVector_[T](6), 4, 0, 2)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.member, converter=converter)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            state = context.get_continuous_state_vector().CopyToVector()
            control = self.EvalVectorInput(context, 0).CopyToVector()
            if T is AutoDiffXd:
                both = np.concatenate([state, control])
                numbers, gradient = ExtractValue(both).ravel(), ExtractGradient(both)
                value, jacobian = _slopes(self.member, numbers[:6], float(numbers[6]))
                derivatives.get_mutable_vector().SetFromVector(InitializeAutoDiff(value, jacobian @ gradient).ravel())
            else:
                value, _ = _slopes(self.member, np.asarray(state), float(control[0]))
                derivatives.get_mutable_vector().SetFromVector(value)

    return Impl


@dataclass(frozen=True)
class DirectResult:
    """Wall time of the solver without building the problem, s, friction factor reached, and whether it succeeded."""

    wall_time: float
    grip: float
    success: bool


def solve_directly(problem: SwingProblem, start: np.ndarray, iterations: int = 300) -> DirectResult:
    """One solve of a single-member planar problem for friction, from the start of `solve` (scaled variables)."""
    (member,) = problem.members
    layout, limits, knots = problem.layout, problem.limits, problem.knots
    system = RollingCar_[float](member)
    step = float(knots[1] - knots[0])
    direct = DirectCollocation(
        system, system.CreateDefaultContext(), len(knots), step, step, system.get_input_port().get_index()
    )
    prog: Any = direct.prog()
    first_roll, first_rate = member.profile.state_at(0.0)
    first = [first_roll, problem.start[0], first_rate, 0.0, 0.0]
    prog.AddBoundingBoxConstraint(first, first, direct.initial_state()[:5])
    inwards = -min(limits.roll_inwards, lift_roll(member.car))
    low = [inwards, -limits.angles[0], -10.0, -limits.tail_rate, 0.0, problem.parameter_range[0]]
    high = [limits.roll, limits.angles[0], 10.0, limits.tail_rate, float(knots[-1]) + step, problem.parameter_range[1]]
    for number in range(len(knots)):
        state, control = direct.state(number), direct.input(number)
        prog.AddBoundingBoxConstraint(low, high, state)
        for variable, unit in zip([*state, *control], [*STATE_SCALE, ACCELERATION], strict=True):
            prog.SetVariableScaling(variable, unit)
        prog.AddQuadraticCost(problem.smoothness / len(knots) * (control[0] / ACCELERATION) ** 2)
        prog.AddQuadraticCost(problem.margin / len(knots) * (state[ROLL_PLACE] / ROLL) ** 2)
    last = direct.final_state()
    prog.AddBoundingBoxConstraint(-np.inf, limits.end_roll, last[ROLL_PLACE])
    prog.AddBoundingBoxConstraint(-limits.end_roll_rate, limits.end_roll_rate, last[ROLL_RATE_PLACE])
    prog.AddBoundingBoxConstraint(0.0, 0.0, [last[TAIL_RATE_PLACE], *direct.input(len(knots) - 1)])
    prog.AddLinearCost(-direct.initial_state()[GRIP_PLACE])
    guess = np.vstack(
        [
            start[layout.cars[0].roll] * ROLL,
            start[layout.tail[0].angle] * ANGLE,
            start[layout.cars[0].rate] * ROLL_RATE,
            start[layout.tail[0].rate] * RATE,
            knots,
            np.full(len(knots), start[-1]),
        ]
    )
    direct.SetInitialTrajectory(
        _HOLD(knots, start[layout.tail[0].acceleration][None, :] * ACCELERATION),
        _HOLD(knots, guess),
    )
    solver, options = SnoptSolver(), SolverOptions()
    for key, value in (("Major iterations limit", iterations), ("Superbasics limit", prog.num_vars())):
        options.SetOption(solver.solver_id(), key, value)
    options.SetOption(solver.solver_id(), "Major feasibility tolerance", 0.1 * FEASIBLE)
    options.SetOption(solver.solver_id(), "Major optimality tolerance", OPTIMALITY)
    begun = time.perf_counter()
    result = solver.Solve(prog, prog.initial_guess(), options)
    took = time.perf_counter() - begun
    return DirectResult(took, float(result.GetSolution(direct.initial_state())[GRIP_PLACE]), bool(result.is_success()))
