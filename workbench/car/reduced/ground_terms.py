"""The ground in the equations of motion: tyres, wheels, drive and anti-ramp board."""

from typing import NamedTuple

import numpy as np

from aerodima.workbench.aero.section_laws import dot
from aerodima.workbench.car.car_model import CAGE_STIFFNESS
from aerodima.workbench.car.laws import (
    ROLLING_RATE,
    governor_torque,
    rolling_resistance,
)
from aerodima.workbench.car.reduced.parameters import MIN_REGULARISATION_SPEED, VehicleParams
from aerodima.workbench.car.reduced.states import (
    RATES,
    SPIN,
    SPINS,
    TRAVEL,
    Commands,
    Terms,
    V,
    W,
    cross,
    outer,
    up_in_body,
)
from aerodima.workbench.core.array_types import ArrayPair, FloatArray

BOARD_DISSIPATION = 1.0
"""Dissipation of the board's contact with the ground, s/m, as `car_model` sets it."""


class WheelPoses(NamedTuple):
    """Wheels of n cars, in B.

    Attributes:
        axle: directions of the axles, to the left (3, 4, n).
        tilt: cosine of the angle between axle and upright (4, n).
        reach: distance from the middle of an edge, an ellipsoid, down to its lowest point (4, n),
            m.
        centre: centres of the wheels (3, 4, n), m.
    """

    axle: FloatArray
    tilt: FloatArray
    reach: FloatArray
    centre: FloatArray


class TyreEdges(NamedTuple):
    """Edges of the tyres on the ground, (2 edges, 4 wheels, n) after the axis of a vector.

    Attributes:
        points: points at which they meet the ground, in B, m.
        spinning: velocity of these points for each rad/s of the wheel's spin, m.
        sunk: depth in the ground, m.
        closing: speed into the ground without that of the suspension, m/s.
        slip: velocity along the ground, m/s.
    """

    points: FloatArray
    spinning: FloatArray
    sunk: FloatArray
    closing: FloatArray
    slip: FloatArray


def add_tyres(
    state: FloatArray, commands: Commands, cars: VehicleParams, terms: Terms
) -> ArrayPair:
    """Adds wheels, drive and the forces of the ground; returns rates of the suspensions (4, n),
    m/s, and loads of the wheels (4, n), N.
    """
    n = up_in_body(state)
    wheels = _wheel_poses(state, commands.steering, cars)
    edges = _tyre_edges(state, wheels, cars)
    slip = edges.slip
    sliding = cars.friction / np.sqrt(dot(slip, slip) + cars.slip_speed**2)
    travel_rate, load = _edge_loads(state, edges, sliding, n[2], cars)

    grip = sliding * load
    push = load * n[:, None, None] - grip * slip
    add_contact_forces(edges.points, push, grip, n, terms)
    pushed = grip * edges.spinning
    terms.force[SPIN] -= np.sum(dot(pushed, slip), axis=0)
    moments = np.sum(cross(edges.points, pushed), axis=1)
    mixed = np.concatenate([moments, np.sum(pushed, axis=1)])  # (6, 4, n)
    terms.damping[:6, SPIN] += mixed
    terms.damping[SPIN, :6] += np.swapaxes(mixed, 0, 1)
    spin_damping = np.sum(dot(pushed, edges.spinning), axis=0)
    _add_wheels(state, commands, wheels.axle, spin_damping, cars, terms)
    return travel_rate, np.sum(load, axis=0)


def wheel_lifts(state: FloatArray, cars: VehicleParams, steering: FloatArray) -> FloatArray:
    """Returns the height of the lowest point of each tyre over the ground (4, n), m; negative where
    the tyre presses into the ground.

    Args:
        state: states of the cars (24, n).
        cars: parameters of the n cars.
        steering: angles of the front wheels (n), rad.
    """
    wheels = _wheel_poses(state, np.stack([steering, steering]), cars)
    middle = state[2] + dot(up_in_body(state)[:, None], wheels.centre)
    return middle - cars.edge * np.abs(wheels.tilt) - wheels.reach


def _wheel_poses(state: FloatArray, steering: FloatArray, cars: VehicleParams) -> WheelPoses:
    """Returns the wheels at a state (24, n) and angles of the front wheels (2, n), rad."""
    steer = np.concatenate([steering, np.zeros((2, cars.count))])
    axle = np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer])
    tilt = dot(axle, up_in_body(state)[:, None])
    R2 = cars.tyre_radius**2
    h2 = cars.tyre_half_width**2
    reach = np.sqrt(R2 * (1.0 - tilt * tilt) + h2 * tilt * tilt)
    x, y, z = cars.wheel
    return WheelPoses(axle, tilt, reach, np.stack([x, y, z + state[TRAVEL]]))


def _tyre_edges(state: FloatArray, wheels: WheelPoses, cars: VehicleParams) -> TyreEdges:
    """Returns the lowest point of each edge and where it meets the ground."""
    axle, tilt, reach, centre = wheels
    n = up_in_body(state)
    n4 = n[:, None]
    R2 = cars.tyre_radius**2
    h2 = cars.tyre_half_width**2
    down = (-1.0 / reach) * (R2 * (n4 - tilt * axle) + h2 * tilt * axle)
    sides = np.array([1.0, -1.0])[:, None, None]
    axle_e = axle[:, None]
    n_e = n[:, None, None]
    middle = centre[:, None] + cars.edge * sides * axle_e
    sunk = np.maximum(reach - state[2] - dot(n_e, middle), 0.0)
    lever = down[:, None] + sunk * n_e
    points = middle + lever
    spinning = cross(axle_e, lever)
    rates = state[RATES]
    velocity = rates[V][:, None, None] + cross(rates[W][:, None, None], points)
    closing = -dot(n_e, velocity)
    slip = velocity + spinning * rates[SPIN] + closing * n_e  # along the ground, as `spinning`
    return TyreEdges(points, spinning, sunk, closing, slip)


def _edge_loads(
    state: FloatArray,
    edges: TyreEdges,
    sliding: FloatArray,
    n_z: FloatArray,
    cars: VehicleParams,
) -> ArrayPair:
    """Returns rates of the suspensions (4, n), m/s, and loads of the edges (2, 4, n), N, which
    follow from one balance per wheel.

    Args:
        sliding: friction coefficient divided by the speed of the slip (2, 4, n), s/m.
        n_z: component of the upright along z of B (n).
    """
    closing = edges.closing
    lean = n_z - sliding * edges.slip[2]
    spring = cars.tyre_stiffness * edges.sunk
    undamped = spring * np.maximum(1.0 + cars.tyre_dissipation * closing, 0.0)
    carried = cars.preload + cars.spring * state[TRAVEL] + cars.unsprung * cars.gravity * n_z
    tyre_damping = np.maximum(lean, 0.0) * cars.tyre_dissipation * spring * n_z
    holding = cars.damper + np.sum(tyre_damping, axis=0)
    travel_rate = (np.sum(undamped * lean, axis=0) - carried) / holding
    sinking = closing - n_z * travel_rate
    load = spring * np.maximum(1.0 + cars.tyre_dissipation * sinking, 0.0)
    return travel_rate, load


def _add_wheels(
    state: FloatArray,
    commands: Commands,
    axle: FloatArray,
    spin_damping: FloatArray,
    cars: VehicleParams,
    terms: Terms,
) -> None:
    """Adds inertia and rolling resistance of the wheels, and the drive, whose shaft turns at the
    mean of the rear wheels.

    Args:
        axle: directions of the axles in B (3, 4, n).
        spin_damping: damping of the spin by the ground (4, n), N m s/rad.
    """
    mass, force, damping = terms
    rates = state[RATES]
    spin = rates[SPIN]
    rounded = np.tanh(spin / ROLLING_RATE)
    resistance = rolling_resistance(spin, cars.rolling)
    slope = cars.rolling * (1.0 - rounded * rounded) / ROLLING_RATE
    force[SPIN] += resistance
    inertia = cars.wheel_inertia
    coupling = inertia * axle
    mass[SPINS, SPINS] = inertia
    mass[W, SPIN] = coupling
    mass[SPIN, W] = np.swapaxes(coupling, 0, 1)
    damping[SPINS, SPINS] += spin_damping + slope
    force[W] -= cross(rates[W], inertia * np.sum(axle * spin, axis=1))

    limit = cars.shaft_limit
    torque = governor_torque(
        commands.shaft_speed,
        0.5 * (spin[2] + spin[3]),
        cars.shaft_gain,
        -np.sum(resistance, axis=0),
        limit,
    )
    rear = slice(8, 10)
    mass[rear, rear] += 0.25 * cars.shaft_inertia
    damping[rear, rear] += 0.25 * cars.shaft_gain * (np.abs(torque) < limit)
    force[rear] += 0.5 * torque


def add_board(state: FloatArray, cars: VehicleParams, terms: Terms) -> None:
    """Adds the ground's force on the anti-ramp board, which keeps a car that gathers speed from
    tipping over.
    """
    rates = state[RATES]
    n = up_in_body(state)
    n_e = n[:, None]
    velocity = rates[V][:, None] + cross(rates[W][:, None], cars.board)  # (3, 2, n)
    sunk = np.maximum(-state[2] - dot(n_e, cars.board), 0.0)
    closing = -dot(n_e, velocity)
    load = CAGE_STIFFNESS * sunk * np.maximum(1.0 + BOARD_DISSIPATION * closing, 0.0)
    slip = velocity + closing * n_e
    slip_speed = np.sqrt(dot(slip, slip) + MIN_REGULARISATION_SPEED**2)
    grip = cars.board_friction * load / slip_speed
    push = load * n_e - grip * slip
    add_contact_forces(cars.board, push, grip, n, terms)


def add_contact_forces(
    points: FloatArray, forces: FloatArray, grip: FloatArray, normal: FloatArray, terms: Terms
) -> None:
    """Adds forces of the ground on the body, all in B.

    Args:
        points: points of contact (3, ..., n), m.
        forces: forces at these points (3, ..., n), N.
        grip: damping of a slip in any direction along the ground by these forces (..., n), N s/m.
        normal: normal of the ground (3, n).
    """
    _, force, damping = terms
    columns = (3, -1, normal.shape[-1])
    points = points.reshape(columns)
    forces = forces.reshape(columns)
    grip = grip.reshape(columns[1:])
    force[W] += np.sum(cross(points, forces), axis=1)
    force[V] += np.sum(forces, axis=1)
    flat = np.eye(3)[:, :, None] - outer(normal, normal)
    damping[V, V] += np.sum(grip, axis=0) * flat
    weighted = grip * points
    arm = cross(points, normal[:, None])
    crossed = weighted[:, None] * points + (grip * arm)[:, None] * arm
    damping[W, W] -= np.sum(crossed, axis=2)
    for axis in range(3):
        damping[axis, axis] += np.sum(dot(weighted, points), axis=0)
        turned = cross(np.sum(weighted, axis=1), flat[axis])
        damping[W, 3 + axis] += turned
        damping[3 + axis, W] += turned
