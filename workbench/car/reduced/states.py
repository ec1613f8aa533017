"""States of the reduced car by index, its commands, and vectors of many cars at once."""

from typing import NamedTuple

import numpy as np

from aerodima.workbench.aero.section_laws import cross as vector_product
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.signal_table import WHEELS

STATES = (
    *("x", "y", "z", "yaw", "pitch", "roll", "tail_pitch", "tail_roll"),
    *(f"travel_{wheel}" for wheel in WHEELS),
    *("w_x", "w_y", "w_z", "v_x", "v_y", "v_z"),
    *(f"spin_{wheel}" for wheel in WHEELS),
    "tail_pitch_rate",
    "tail_roll_rate",
)
"""Names of the states, in m, rad, rad/s and m/s: position of the origin of B in W, its velocity and
the angular velocity in B, spin forwards."""
ANGLES = slice(3, 6)
"""Indices of yaw, pitch, roll, rad."""
TRAVEL = slice(8, 12)
"""Indices of the travel of the four wheels, m."""
RATES = slice(12, 24)
"""Indices of the twelve rates."""
W = slice(0, 3)
"""Indices of the angular velocity among the twelve rates, rad/s."""
V = slice(3, 6)
"""Indices of the velocity among the rates, m/s."""
SPIN = slice(6, 10)
"""Indices of the spin of the four wheels among the rates, rad/s."""
TAIL_RATE = slice(10, 12)
"""Indices of pitch and roll rate of the tail among the rates, rad/s."""
DEGREES = 12
"""Number of the rates."""
SPINS = [6, 7, 8, 9]
"""Rows of the wheels' spin in a matrix of the rates, for its diagonal."""
JOINTS = [10, 11]
"""Rows of the tail's joints in such a matrix."""
EPS_SQRT = 1e-12
"""Number added under roots so that they are smooth at 0; m2/s2, or 1 beside squared sines."""


class Commands(NamedTuple):
    """Inputs of the cars.

    Attributes:
        steering: angles of the front wheels, left and right (2, n), rad.
        shaft_speed: target of the governor (n), rad/s.
        tail: commands to the pitch and roll motor (2, 4, n): angle rad, rate rad/s, kp N m/rad,
            kd N m s/rad.
    """

    steering: FloatArray
    shaft_speed: FloatArray
    tail: FloatArray


class Terms(NamedTuple):
    """Arrays that every part of the car adds to; see `Equations`."""

    mass: FloatArray
    force: FloatArray
    damping: FloatArray


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the vector product along the first axis."""
    return np.stack(vector_product(a, b))


def up(pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Returns the upright direction in B (3, n)."""
    cp = np.cos(pitch)
    return np.stack([-np.sin(pitch), cp * np.sin(roll), cp * np.cos(roll)])


def up_in_body(state: FloatArray) -> FloatArray:
    """Returns the upright direction in B (3, n) at a state (24, n)."""
    return up(state[4], state[5])


def tail_axes(pitch: FloatArray, roll: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns chord (axis of the roll joint), normal of the sail and axis of the tail in B, (3, n)
    each.
    """
    sp = np.sin(pitch)
    cp = np.cos(pitch)
    sq = np.sin(roll)
    cq = np.cos(roll)
    chord = np.stack([cp, 0.0 * cp, -sp])
    normal = np.stack([sp * sq, cq, cp * sq])
    axis = np.stack([sp * cq, -sq, cp * cq])
    return chord, normal, axis


def skew(a: FloatArray) -> FloatArray:
    """Returns [a]x (3, 3, n), with [a]x b = a x b."""
    zero = 0.0 * a[0]
    x, y, z = a
    return np.stack([np.stack([zero, -z, y]), np.stack([z, zero, -x]), np.stack([-y, x, zero])])


def outer(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the outer product a b' (3, 3, n) of two vectors."""
    return a[:, None] * b[None]


def apply(matrix: FloatArray, a: FloatArray) -> FloatArray:
    """Returns a matrix (3, 3, n) times a vector (3, n)."""
    return np.sum(matrix * a[None], axis=1)
