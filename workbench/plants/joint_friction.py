"""Law of the friction of joints; Drake's own have no Coulomb friction (design section 6)."""

import math
from collections.abc import Callable, Sequence
from typing import Any

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
