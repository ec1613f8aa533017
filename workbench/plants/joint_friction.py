"""Joint friction as a system, since Drake's joints have no Coulomb friction (design section 6)."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.systems.vector_ports import vector_of

FrictionLaw = Callable[[Any], Any]
"""Joint rate (rad/s) to friction torque (N m), which opposes it."""


def friction_torque(rate: Any, tanh_of_rate: Any, coulomb: Any, viscous: Any) -> Any:
    """tau = -(Cf tanh(k w) + Vf w), N m; see `smooth_friction`."""
    return -(coulomb * tanh_of_rate + viscous * rate)


def smooth_friction(
    coulomb: Any, viscous: Any, tanh_gain: float, stribeck: Sequence[float] = (), tanh: Callable[[Any], Any] = math.tanh
) -> FrictionLaw:
    """tau = -(Cf tanh(k w) + Vf w): thesis eq. 4.12 with the sign of ERRATA E14 and E15; k = 10 s/rad there.

    Args:
        coulomb, viscous: Cf (N m) and Vf (N m s/rad), for arrays of rates also arrays.
        tanh_gain: k, s/rad.
        stribeck: excess of the breakaway torque over Cf (N m), which dies out with speed, and the Stribeck speed
            (rad/s).
        tanh: of NumPy for arrays of rates; that of `math` is much faster for one.
    """
    if stribeck:
        excess, speed = stribeck
        return lambda rate: friction_torque(
            rate, tanh(tanh_gain * rate), coulomb + excess * math.exp(-((rate / speed) ** 2)), viscous
        )
    return lambda rate: friction_torque(rate, tanh(tanh_gain * rate), coulomb, viscous)


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
        state = vector_of(self._state, context)
        rates = state[self._count :].tolist()
        output.SetFromVector(np.array([self._law(rate) for rate in rates]))
