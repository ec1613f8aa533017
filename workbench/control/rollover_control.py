"""Limit of the steering by speed and by the roll of the car, as in a stability control. No Drake.

The wheels get a share of the angle that the driver asks for, which is at most that of a lateral
acceleration of the kinematic car:

    share = 1 - gain max(0, |phi - phi_0 + lead dphi/dt| - start), from 0 to 1

with roll phi. While the wheels are straight, phi_0 follows the roll. Ackermann and Odenthal feed
roll and roll rate back to the steering, too ("Robust steering control for active rollover avoidance
of vehicles with elevated center of gravity", AVEC 1998).
"""

from typing import Any, NamedTuple

import numpy as np

STRAIGHT = 0.02
"""Asked steering angle below which the wheels count as straight, rad."""


class RolloverMemory(NamedTuple):
    """Values that the control carries from tick to tick, numbers or arrays (n).

    Attributes:
        share: share of the steering that the wheels get.
        zero: roll of the car that counts as none, rad.
    """

    share: Any
    zero: Any


def max_angle(wheelbase: Any, acceleration: Any, speed: Any) -> Any:
    """Returns the angle (rad) at which the kinematic car of a wheelbase, m, has a lateral
    acceleration, m/s2, at a speed, m/s.
    """
    return np.arctan2(wheelbase * acceleration, speed**2)


def limit_by_roll(
    gains: Any, rate: float, memory: RolloverMemory, asked: Any, roll: Any, roll_rate: Any
) -> RolloverMemory:
    """Returns the memory after one tick.

    Args:
        gains: any object with the fields of `RolloverControlParameters`.
        rate: rate of the ticks, Hz.
        memory: memory of the tick before.
        asked: steering angle that the driver asks for, within `max_angle`, rad.
        roll, roll_rate: roll and roll rate of the car, rad and rad/s.
    """
    straight = np.abs(asked) < STRAIGHT
    zero = memory.zero + straight * (roll - memory.zero) / (gains.zero_time * rate)
    tilt = np.abs(roll - zero + gains.lead * roll_rate)
    share = np.clip(1.0 - gains.gain * np.maximum(tilt - gains.start, 0.0), 0.0, 1.0)
    return RolloverMemory(share, zero)
