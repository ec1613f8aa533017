"""The tail in the equations of motion: arm, air, motors, friction and stops."""

import numpy as np

from aerodima.workbench.aero.section_laws import LineMotion, dot, plate_force
from aerodima.workbench.car.laws import (
    joint_friction,
    pd_torque,
    torque_bounds,
)
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.states import (
    JOINTS,
    RATES,
    TAIL_RATE,
    Commands,
    Terms,
    V,
    W,
    apply,
    cross,
    outer,
    skew,
    tail_axes,
    up_in_body,
)
from aerodima.workbench.core.array_types import ArrayPair, FloatArray

STOP_RATE = 150.0
"""Natural frequency of a joint on its stop, rad/s."""


def add_tail(
    state: FloatArray, commands: Commands, cars: VehicleParams, terms: Terms
) -> FloatArray:
    """Adds the arm with its joints, motors and air; returns the stiffness of the joints."""
    chord, normal, e = tail_axes(state[6], state[7])
    L = cars.tail_centre * e
    J_x, J_y, J_e = cars.tail_inertia
    J = J_x * outer(chord, chord) + J_y * outer(normal, normal) + J_e * outer(e, e)
    pitch_axis = np.zeros_like(chord)
    pitch_axis[1] = 1.0
    axes = (pitch_axis, chord)
    _add_tail_inertia(L, J, axes, cars, terms)

    m = cars.tail_mass
    P = cars.mount
    rates = state[RATES]
    w = rates[W]
    joint_rates = rates[TAIL_RATE]
    pitching = joint_rates[0] * pitch_axis
    rolling = joint_rates[1] * chord
    turn = w + pitching + rolling
    alpha = cross(w, pitching) + cross(w + pitching, rolling)
    swept = cross(w, P)
    a_S = cross(w, swept) + cars.gravity * up_in_body(state)
    line = LineMotion(-rates[V] - swept, -cross(turn, e), e, normal)
    F_air, M_air = _air(line, chord, cars)
    F = m * (a_S + cross(alpha, L) + cross(turn, cross(turn, L))) - F_air
    M = cross(L, m * a_S) + apply(J, alpha) + cross(turn, apply(J, turn)) - M_air
    terms.force[V] -= F
    terms.force[W] -= cross(P, F) + M
    terms.force[10] -= M[1]
    terms.force[11] -= dot(chord, M)
    return _add_joints(state, commands, cars, terms)


def _add_tail_inertia(
    L: FloatArray,
    J: FloatArray,
    axes: ArrayPair,
    cars: VehicleParams,
    terms: Terms,
) -> None:
    """Adds the inertia of arm, hub and rotors.

    Args:
        L: centre of mass of the arm from the joints, in B (3, n), m.
        J: inertia of the arm about the joints, in B (3, 3, n), kg m2.
        axes: axes of the pitch and the roll joint, in B (3, n) each.
    """
    mass = terms.mass
    m = cars.tail_mass
    P = cars.mount
    moment = m * (P + L)
    for row in range(3, 6):
        mass[row, row] += m
    mass[W, V] += skew(moment)
    mass[V, W] = -mass[W, V]
    eye = np.eye(3)[:, :, None]
    PL = outer(P, L)
    about_mount = (dot(P, P) + 2 * dot(P, L)) * eye - outer(P, P) - PL - np.swapaxes(PL, 0, 1)
    mass[W, W] += J + m * about_mount
    for row, axis in zip(JOINTS, axes, strict=True):
        pull = m * cross(axis, L)
        twist = apply(J, axis)
        both = cross(P, pull) + twist
        mass[V, row] = pull
        mass[row, V] = pull
        mass[W, row] = both
        mass[row, W] = both
        mass[row, row] = dot(axis, twist) + cars.rotor_inertia
    for row, column in ((1, 10), (10, 1), (10, 10)):
        mass[row, column] += cars.hub_inertia


def _air(line: LineMotion, chord: FloatArray, cars: VehicleParams) -> ArrayPair:
    """Returns the force of the air on the sail, and its moment about the joints (3, n), by the law
    of design section 5.

    Args:
        line: motion of the sail against the air, in B.
        chord: direction across the sail, the normal of the plate that stands for its depth.
    """
    total = np.zeros_like(chord, shape=(6, cars.count))
    for normal, coefficient in ((line.n, cars.force_across), (chord, cars.force_chord)):
        areas = tuple(coefficient * cars.section_areas)
        plate = line._replace(n=normal)
        total += plate_force(
            plate, tuple(cars.section_distances), areas, cars.air_density, 1.0, 1.0
        )
    return total[:3], total[3:]


def _add_joints(
    state: FloatArray, commands: Commands, cars: VehicleParams, terms: Terms
) -> FloatArray:
    """Adds motors (design section 6), friction and stops of the tail's joints; returns their
    stiffness (2, n).
    """
    mass, force, damping = terms
    angle = state[6:8]
    rate = state[RATES][TAIL_RATE]
    target, speed, kp, kd = np.swapaxes(commands.tail, 0, 1)
    kp = cars.torque_scale * kp
    kd = cars.torque_scale * kd
    asked = pd_torque(angle, rate, target, speed, kp, kd)
    lower, upper = torque_bounds(rate, cars.torque_limit, cars.stall_torque, cars.no_load_speed)
    free = (asked < upper) & (asked > lower)
    friction = joint_friction(rate, cars.coulomb, cars.viscous, cars.tanh_gain)
    rounded = np.tanh(cars.tanh_gain * rate)
    slope = cars.viscous + cars.coulomb * cars.tanh_gain * (1.0 - rounded * rounded)
    limit = np.stack([cars.pitch_limit, cars.roll_stop])
    beyond = np.maximum(angle - limit, 0.0) + np.minimum(angle + limit, 0.0)
    inertia = mass[JOINTS, JOINTS]
    stopped = (np.abs(angle) >= limit) * inertia
    stop_damping = 2.0 * STOP_RATE * stopped
    force[TAIL_RATE] += np.clip(asked, lower, upper) + friction
    force[TAIL_RATE] -= inertia * STOP_RATE**2 * beyond + stop_damping * rate
    damping[JOINTS, JOINTS] += free * kd + slope + stop_damping
    return free * kp + STOP_RATE**2 * stopped
