"""Equations of motion of many cars at once: a rigid body on four suspended wheels, with its tail on
two joints.

Pure functions of arrays without branches, whose last axis is the car. Body frame B and
signs as everywhere (design section 4): x forward, y left, z up, roll +x, pitch +y (nose down), yaw
and steering to the left; tail roll 0 = up, positive to the right.

    M(x) A = f(x),   A = (angular acceleration, acceleration of the origin of B, of the wheels'
    spin, of the tail)

with vectors in B. As on the full car: both edges of every tyre with stiffness, dissipation and
Coulomb friction, spin of the wheels with open differential and governor, suspension as prismatic
along z of B, the anti-ramp board on the ground, air on the sail, friction and motors of the tail's
joints, its weight and inertia. Simplified: unsprung masses move with the body, so that their travel
has no inertia and is a state of the first order; the wheels steer as the servo's linkage asks; a
stop of a joint is a stiff spring; tail and cage do not feel the ground (the tail's height is a
result).
"""

from typing import NamedTuple

import numpy as np

from aerodima.workbench.aero.section_laws import dot
from aerodima.workbench.car.reduced.ground_terms import add_board, add_tyres
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.states import (
    ANGLES,
    DEGREES,
    JOINTS,
    RATES,
    TAIL_RATE,
    Commands,
    Terms,
    V,
    W,
    apply,
    cross,
    skew,
    up,
    up_in_body,
)
from aerodima.workbench.car.reduced.tail_terms import add_tail
from aerodima.workbench.car.verdict import velocity_over_ground
from aerodima.workbench.core.array_types import FloatArray


class Equations(NamedTuple):
    """Terms of M A = f, and those that a step implicit in friction and damping needs.

    Attributes:
        mass: mass matrix M (12, 12, n).
        force: generalised force f (12, n).
        damping: stiff part of -df/drate, positive semidefinite (12, 12, n).
        stiffness: -df/dangle of the tail's joints (2, n).
        travel_rate: rates of the suspensions (4, n), m/s.
        loads: vertical force of the ground on every wheel (4, n), N.
    """

    mass: FloatArray
    force: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    travel_rate: FloatArray
    loads: FloatArray


def equations(state: FloatArray, commands: Commands, cars: VehicleParams) -> Equations:
    """Returns the equations of motion at a state (24, n)."""
    terms = _body(state, cars)
    stiffness = add_tail(state, commands, cars, terms)
    travel_rate, loads = add_tyres(state, commands, cars, terms)
    add_board(state, cars, terms)
    return Equations(*terms, stiffness, travel_rate, loads)


def step(state: FloatArray, system: Equations, length: float) -> FloatArray:
    """Returns the state after a time (s); implicit in friction and damping, with positions from the
    new rates.
    """
    rates = state[RATES]
    matrix = system.mass + length * system.damping
    # Tyres turn with the car: friction damps the velocity in B, whose rate is A - w x v.
    turned = np.sum(system.damping[:, V] * cross(rates[W], rates[V]), axis=1)
    force = system.force + length * turned
    matrix[JOINTS, JOINTS] += length**2 * system.stiffness
    force[TAIL_RATE] -= length * system.stiffness * rates[TAIL_RATE]
    new = rates + length * solve(matrix, force)
    moved = state[: RATES.start] + length * configuration_rate(state, new, system.travel_rate)
    turn = length * new[W]
    v = new[V] - cross(turn, new[V])
    new[V] = v + 0.5 * cross(turn, cross(turn, v))
    return np.concatenate([moved, new])


def configuration_rate(state: FloatArray, rates: FloatArray, travel_rate: FloatArray) -> FloatArray:
    """Returns the rates of the first twelve states (12, n)."""
    yaw, pitch, roll = state[ANGLES]
    p, q, r = rates[W]
    sy = np.sin(yaw)
    cy = np.cos(yaw)
    sp = np.sin(pitch)
    cp = np.cos(pitch)
    sr = np.sin(roll)
    cr = np.cos(roll)
    turning = q * sr + r * cr
    ahead, left = velocity_over_ground(rates[V], rates[W], roll, pitch, 0.0)
    x_rate = ahead * cy - left * sy
    y_rate = ahead * sy + left * cy
    z_rate = dot(up(pitch, roll), rates[V])
    pitch_rate = q * cr - r * sr
    roll_rate = p + turning * sp / cp
    body = np.stack([x_rate, y_rate, z_rate, turning / cp, pitch_rate, roll_rate])
    return np.concatenate([body, rates[TAIL_RATE], travel_rate])


def solve(matrix: FloatArray, force: FloatArray) -> FloatArray:
    """Returns the solution (k, n) of n symmetric positive definite systems (k, k, n) at once.

    The last unknowns are eliminated first: wheels and joints hardly act on one another, so most
    factors are zero.
    """
    rows = matrix.copy()
    right = force.copy()
    for k in reversed(range(len(right))):
        inverse = 1.0 / rows[k, k]
        factor = rows[k, :k] * inverse
        for i in range(k):
            rows[i, : i + 1] -= factor[i] * rows[k, : i + 1]
        right[:k] -= factor * right[k]
        right[k] *= inverse
        rows[k, :k] = factor
    for k in range(1, len(right)):
        right[k] -= np.sum(rows[k, :k] * right[:k], axis=0)
    return right


def _body(state: FloatArray, cars: VehicleParams) -> Terms:
    """Returns inertia and weight of all that does not move with the tail."""
    mass, damping = np.zeros_like(state, shape=(2, DEGREES, DEGREES, cars.count))
    force = np.zeros_like(state, shape=(DEGREES, cars.count))
    w = state[RATES][W]
    moment = cars.mass * cars.centre
    mass[W, W] = cars.inertia
    mass[W, V] = skew(moment)
    for axis in range(3, 6):
        mass[axis, axis] = cars.mass
    weight = cars.gravity * up_in_body(state)
    force[V] = -cars.mass * weight - cross(w, cross(w, moment))
    force[W] = -cross(moment, weight) - cross(w, apply(cars.inertia, w))
    return Terms(mass, force, damping)
