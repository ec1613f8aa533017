"""A turn made of formulas, for tests that need no run of the full car."""

from __future__ import annotations

from functools import cache

import numpy as np

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.swing_problem import ReducedMember, SwingLimits, SwingProblem
from aerodima.optimisation.swing.turn_profile import TurnProfile
from aerodima.workbench.config.scenario import load_scenario


@cache
def car() -> ReducedCar:
    return ReducedCar.of(load_scenario("turn_designed"))


def smooth_turn(friction: float = 0.75, speed: float = 4.5) -> TurnProfile:
    """Side force that comes and goes within 0.5 s, as in the full car's turn."""
    time = np.arange(-0.1, 1.5, 0.01)
    share = 0.5 * (np.tanh((time + 0.02) / 0.02) - np.tanh((time - 0.5) / 0.03))
    inputs = np.column_stack(
        [1.05 * friction * share, 0.1 * share, np.full(len(time), speed), -0.01 * share, 1.2 * share, 0 * share]
    )
    return TurnProfile(time, inputs, friction, speed, 0.02 * share, 0.0 * time, 2.04)


def problem(dof: int = 1, knots: int = 21, members: int = 1, **changes: object) -> SwingProblem:
    limits = SwingLimits.of(car(), dof, **changes.pop("limits", {}))  # type: ignore[arg-type]
    data: dict = {"parameter_range": (0.8, 1.2)} | changes
    return SwingProblem(
        (ReducedMember(car(), smooth_turn()),) * members,
        np.linspace(0.0, 1.0, knots),
        (-np.pi / 2, 0.0)[:dof],
        limits,
        **data,
    )
