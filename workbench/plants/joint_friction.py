"""Joint friction as a system, since Drake's joints have no Coulomb friction (design section 6)."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

FrictionLaw = Callable[[float], float]
"""Joint rate (rad/s) to friction torque (N m), which opposes it."""


def smooth_friction(coulomb: float, viscous: float, tanh_gain: float) -> FrictionLaw:
    """tau = -(Cf tanh(k w) + Vf w): thesis eq. 4.12 with the sign of ERRATA E14 and E15; k = 10 s/rad there."""

    def torque(rate: float) -> float:
        return -(coulomb * math.tanh(tanh_gain * rate) + viscous * rate)

    return torque


def sign_friction(coulomb: float, viscous: float) -> FrictionLaw:
    """tau = -sign(w) (Cf + Vf |w|): thesis eq. 6.1; zero at rest."""

    def torque(rate: float) -> float:
        return -math.copysign(coulomb + viscous * abs(rate), rate) if rate != 0.0 else 0.0

    return torque


class JointFriction(LeafSystem):
    """Friction torque of `count` joints.

    Input ports:
        joint_state (2 count): angles rad, then rates rad/s.
    Output ports:
        torque (count): N m, opposing the rates.
    """

    def __init__(self, law: FrictionLaw, count: int):
        super().__init__()
        self._law = law
        self._count = count
        self._state = self.DeclareVectorInputPort("joint_state", 2 * count)
        self.DeclareVectorOutputPort("torque", count, self._calc_torque, prerequisites_of_calc={self._state.ticket()})

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.Eval(context)
        rates = state[self._count :].tolist()
        output.SetFromVector(np.array([self._law(rate) for rate in rates]))
