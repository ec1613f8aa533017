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
joints, its weight and inertia. Left out: unsprung masses move with the body, so that their travel
has no inertia and is a state of the first order; the wheels steer as the servo's linkage asks; a
stop of a joint is a stiff spring; tail and cage do not feel the ground (the tail's height is an
answer).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from aerodima.workbench.aero.laws import LineMotion, plate_force
from aerodima.workbench.car.car_model import CAGE_STIFFNESS
from aerodima.workbench.car.laws import ROLLING_RATE
from aerodima.workbench.car.reduced.vehicle_parameters import SLIDING, Vehicles
from aerodima.workbench.core.array_types import FloatArray

_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
STATES = (
    *("x", "y", "z", "yaw", "pitch", "roll", "tail_pitch", "tail_roll"),
    *(f"travel_{wheel}" for wheel in _WHEELS),
    *("w_x", "w_y", "w_z", "v_x", "v_y", "v_z"),
    *(f"spin_{wheel}" for wheel in _WHEELS),
    "tail_pitch_rate",
    "tail_roll_rate",
)
"""m, rad, rad/s, m/s. Position of the origin of B in W, its velocity and the angular velocity in B,
spin forwards."""
POSITION = slice(0, 3)
"""Of the states: x, y, z, m."""
ANGLES = slice(3, 6)
"""Of the states: yaw, pitch, roll, rad."""
TAIL = slice(6, 8)
"""Of the states: pitch and roll of the tail, rad."""
TRAVEL = slice(8, 12)
"""Of the states: travel of the four wheels, m."""
RATES = slice(12, 24)
"""Of the states: the twelve rates."""
W = slice(0, 3)
"""Of the twelve rates, as the next three."""
V = slice(3, 6)
"""Velocity, m/s."""
SPIN = slice(6, 10)
"""Spin of the four wheels, rad/s."""
TAIL_RATE = slice(10, 12)
"""Rates of the tail's pitch and roll, rad/s."""
DEGREES = 12
"""Number of the rates."""
STOP_RATE = 150.0
"""Natural frequency of a joint on its stop, rad/s."""
BOARD_DISSIPATION = 1.0
"""Of the board's contact with the ground, s/m, as `car_model` sets it."""
TINY = 1e-12
"""Under roots, so that they are smooth at 0; m2/s2, or of squared sines."""


class Commands(NamedTuple):
    """What drives the cars.

    Attributes:
        steering: angles of the front wheels, left and right (2, n), rad.
        shaft_speed: target of the governor (n), rad/s.
        tail: to the pitch and roll motor (2, 4, n): rad, rad/s, N m/rad, N m s/rad.
    """

    steering: FloatArray
    shaft_speed: FloatArray
    tail: FloatArray


class Equations(NamedTuple):
    """M A = f, and what a step that is implicit in friction and damping needs.

    Attributes:
        mass: M (12, 12, n).
        force: f (12, n).
        damping: -df/drate, positive semidefinite (12, 12, n); stiff.
        stiffness: -df/dangle of the tail's joints (2, n).
        travel_rate: of the suspensions (4, n), m/s.
        loads: vertical force of the ground on every wheel (4, n), N.
    """

    mass: FloatArray
    force: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    travel_rate: FloatArray
    loads: FloatArray


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product along the first axis."""
    x = a[1] * b[2] - a[2] * b[1]
    found = np.empty_like(x, shape=(3, *x.shape))
    found[0] = x
    found[1] = a[2] * b[0] - a[0] * b[2]
    found[2] = a[0] * b[1] - a[1] * b[0]
    return found


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar product along the first axis."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def up(pitch: FloatArray, roll: FloatArray) -> FloatArray:
    """Upright direction in B (3, n)."""
    cp = np.cos(pitch)
    return np.stack([-np.sin(pitch), cp * np.sin(roll), cp * np.cos(roll)])


def up_in_body(state: FloatArray) -> FloatArray:
    """Upright direction in B (3, n) at a state (24, n)."""
    return up(state[4], state[5])


def tail_axes(pitch: FloatArray, roll: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Chord (axis of the roll joint), normal of the sail and axis of the tail in B, (3, n) each."""
    sp = np.sin(pitch)
    cp = np.cos(pitch)
    sq = np.sin(roll)
    cq = np.cos(roll)
    chord = np.stack([cp, 0.0 * cp, -sp])
    normal = np.stack([sp * sq, cq, cp * sq])
    axis = np.stack([sp * cq, -sq, cp * cq])
    return chord, normal, axis


def equations(state: FloatArray, commands: Commands, cars: Vehicles) -> Equations:
    """The equations of motion at a state (24, n)."""
    mass, force, damping = _body(state, cars)
    stiffness = _tail(state, commands, cars, mass, force, damping)
    travel_rate, loads = _tyres(state, commands, cars, mass, force, damping)
    _board(state, cars, force, damping)
    return Equations(mass, force, damping, stiffness, travel_rate, loads)


def step(state: FloatArray, found: Equations, length: float) -> FloatArray:
    """State after a time (s): implicit in friction and damping, positions from the new rates."""
    rates = state[RATES]
    matrix = found.mass + length * found.damping
    # Tyres turn with the car: what slips less is the velocity in B, whose rate is A - w x v.
    force = found.force + length * np.sum(found.damping[:, V] * cross(rates[W], rates[V]), axis=1)
    for joint, place in enumerate(range(DEGREES)[TAIL_RATE]):
        stiffness = found.stiffness[joint]
        matrix[place, place] += length**2 * stiffness
        force[place] -= length * stiffness * rates[place]
    new = rates + length * solve(matrix, force)
    moved = state[: RATES.start] + length * configuration_rate(state, new, found.travel_rate)
    turn = length * new[W]
    v = new[V] - cross(turn, new[V])
    new[V] = v + 0.5 * cross(turn, cross(turn, v))
    return np.concatenate([moved, new])


def advance(
    length: float,
    cars: Vehicles,
    state: FloatArray,
    steering: FloatArray,
    shaft_speed: FloatArray,
    tail: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """State (24, n) after a time (s), with `Commands`, and the loads (4, n) before it."""
    found = equations(state, Commands(steering, shaft_speed, tail), cars)
    return step(state, found, length), found.loads


def configuration_rate(state: FloatArray, rates: FloatArray, travel_rate: FloatArray) -> FloatArray:
    """Of the first twelve states (12, n)."""
    yaw, pitch, roll = state[ANGLES]
    (p, q, r) = rates[W]
    (u, v, w) = rates[V]
    sy = np.sin(yaw)
    cy = np.cos(yaw)
    sp = np.sin(pitch)
    cp = np.cos(pitch)
    sr = np.sin(roll)
    cr = np.cos(roll)
    turning = q * sr + r * cr
    lifting = sr * v + cr * w
    ahead = cp * u + sp * lifting
    left = cr * v - sr * w
    x_rate = ahead * cy - left * sy
    y_rate = ahead * sy + left * cy
    z_rate = cp * lifting - sp * u
    pitch_rate = q * cr - r * sr
    roll_rate = p + turning * sp / cp
    body = np.stack([x_rate, y_rate, z_rate, turning / cp, pitch_rate, roll_rate])
    return np.concatenate([body, rates[TAIL_RATE], travel_rate])


def solve(matrix: FloatArray, force: FloatArray) -> FloatArray:
    """Solution (k, n) of n symmetric positive definite systems (k, k, n) at once.

    The last unknowns are eliminated first: wheels and joints hardly act on one another, so that
    most factors are zero.
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


def _skew(a: FloatArray) -> FloatArray:
    """[a]x with [a]x b = a x b, (3, 3, n)."""
    zero = 0.0 * a[0]
    x, y, z = a
    return np.stack([np.stack([zero, -z, y]), np.stack([z, zero, -x]), np.stack([-y, x, zero])])


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, None] * b[None]


def _apply(matrix: FloatArray, a: FloatArray) -> FloatArray:
    """(3, 3, n) on (3, n)."""
    return np.sum(matrix * a[None], axis=1)


def _body(state: FloatArray, cars: Vehicles) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inertia and weight of all that does not move with the tail."""
    mass, damping = np.zeros_like(state, shape=(2, DEGREES, DEGREES, cars.count))
    force = np.zeros_like(state, shape=(DEGREES, cars.count))
    w = state[RATES][W]
    moment = cars.mass * cars.centre
    mass[W, W] = cars.inertia
    mass[W, V] = _skew(moment)
    for axis in range(3, 6):
        mass[axis, axis] = cars.mass
    weight = cars.gravity * up_in_body(state)
    force[V] = -cars.mass * weight - cross(w, cross(w, moment))
    force[W] = -cross(moment, weight) - cross(w, _apply(cars.inertia, w))
    return mass, force, damping


def _tail(
    state: FloatArray,
    commands: Commands,
    cars: Vehicles,
    mass: FloatArray,
    force: FloatArray,
    damping: FloatArray,
) -> FloatArray:
    """Adds the arm with its joints, motors and air; returns the stiffness of the joints."""
    rates = state[RATES]
    w = rates[W]
    joint_rates = rates[TAIL_RATE]
    x, y, e = tail_axes(state[6], state[7])
    m = cars.tail_mass
    P = cars.mount
    L = cars.tail_centre * e
    J_x, J_y, J_e = cars.tail_inertia
    J = J_x * _outer(x, x) + J_y * _outer(y, y) + J_e * _outer(e, e)
    pitch_axis = np.zeros_like(x)
    pitch_axis[1] = 1.0

    moment = m * (P + L)
    for row in range(3, 6):
        mass[row, row] += m
    mass[W, V] += _skew(moment)
    mass[V, W] = -mass[W, V]
    eye = np.eye(3)[:, :, None]
    PL = _outer(P, L)
    about_mount = (dot(P, P) + 2 * dot(P, L)) * eye - _outer(P, P) - PL - np.swapaxes(PL, 0, 1)
    mass[W, W] += J + m * about_mount
    for place, axis in zip(range(DEGREES)[TAIL_RATE], (pitch_axis, x), strict=True):
        pull = m * cross(axis, L)
        twist = _apply(J, axis)
        mass[V, place] = pull
        mass[place, V] = pull
        both = cross(P, pull) + twist
        mass[W, place] = both
        mass[place, W] = both
        mass[place, place] = dot(axis, twist) + cars.rotor_inertia
    hub = cars.hub_inertia
    mass[1, 10] += hub
    mass[10, 1] += hub
    mass[10, 10] += hub

    pitching = joint_rates[0] * pitch_axis
    rolling = joint_rates[1] * x
    turn = w + pitching + rolling
    alpha = cross(w, pitching) + cross(w + pitching, rolling)
    swept = cross(w, P)
    a_S = cross(w, swept) + cars.gravity * up_in_body(state)
    line = LineMotion(-rates[V] - swept, -cross(turn, e), e, y)
    F_air, M_air = _air(line, x, cars)
    F = m * (a_S + cross(alpha, L) + cross(turn, cross(turn, L))) - F_air
    M = cross(L, m * a_S) + _apply(J, alpha) + cross(turn, _apply(J, turn)) - M_air
    force[V] -= F
    force[W] -= cross(P, F) + M
    force[10] -= M[1]
    force[11] -= dot(x, M)
    return _joints(state, commands, cars, mass, force, damping)


def _air(line: LineMotion, chord: FloatArray, cars: Vehicles) -> tuple[FloatArray, FloatArray]:
    """Force of the air on the sail, and its moment about the joints (3, n); the law of design
    section 5.

    Args:
        line: motion of the sail against the air, in B.
        chord: direction across it, the normal of the plate that stands for its depth.
    """
    total = np.zeros_like(chord, shape=(6, cars.count))
    for normal, coefficient in ((line.n, cars.force_across), (chord, cars.force_chord)):
        areas = tuple(coefficient * cars.section_areas)
        plate = line._replace(n=normal)
        total += plate_force(
            plate, tuple(cars.section_distances), areas, cars.air_density, 1.0, 1.0
        )
    return total[:3], total[3:]


def _joints(
    state: FloatArray,
    commands: Commands,
    cars: Vehicles,
    mass: FloatArray,
    force: FloatArray,
    damping: FloatArray,
) -> FloatArray:
    """Adds motors (design section 6), friction and stops of the tail's joints."""
    found = []
    for joint, limit in enumerate((cars.pitch_limit, cars.roll_stop)):
        place = 10 + joint
        angle = state[6 + joint]
        rate = state[RATES][place]
        target, speed, kp, kd = commands.tail[joint]
        kp = cars.torque_scale * kp
        kd = cars.torque_scale * kd
        asked = kp * (target - angle) + kd * (speed - rate)
        speed_ratio = rate / cars.no_load_speed
        forwards = np.maximum(0.0, cars.stall_torque * (1.0 - speed_ratio))
        backwards = np.maximum(0.0, cars.stall_torque * (1.0 + speed_ratio))
        upper = np.minimum(cars.torque_limit, forwards)
        lower = -np.minimum(cars.torque_limit, backwards)
        free = (asked < upper) & (asked > lower)
        rounded = np.tanh(cars.tanh_gain * rate)
        friction = -(cars.coulomb * rounded + cars.viscous * rate)
        slope = cars.viscous + cars.coulomb * cars.tanh_gain * (1.0 - rounded * rounded)
        beyond = np.maximum(angle - limit, 0.0) + np.minimum(angle + limit, 0.0)
        inertia = mass[place, place]
        stopped = (np.abs(angle) >= limit) * inertia
        stop_damping = 2.0 * STOP_RATE * stopped
        force[place] += np.clip(asked, lower, upper) + friction
        force[place] -= inertia * STOP_RATE**2 * beyond + stop_damping * rate
        damping[place, place] += free * kd + slope + stop_damping
        found.append(free * kp + STOP_RATE**2 * stopped)
    return np.stack(found)


def _tyres(
    state: FloatArray,
    commands: Commands,
    cars: Vehicles,
    mass: FloatArray,
    force: FloatArray,
    damping: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Adds wheels, drive and the forces of the ground; returns rates of the suspensions and loads
    of the wheels.

    Arrays of the edges are (2 edges, 4 wheels, n), after the axis of a vector.
    """
    rates = state[RATES]
    w = rates[W]
    v = rates[V]
    spin = rates[SPIN]
    n = up_in_body(state)
    zero = np.zeros((2, cars.count))
    steer = np.concatenate([commands.steering, zero])
    axle = np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer])  # (3, 4, n)
    n4 = n[:, None]
    tilt = dot(axle, n4)

    # Lowest point of each edge, an ellipsoid, and where it meets the ground.
    R2 = cars.tyre_radius**2
    h2 = cars.tyre_half_width**2
    reach = np.sqrt(R2 * (1.0 - tilt * tilt) + h2 * tilt * tilt)
    down = (-1.0 / reach) * (R2 * (n4 - tilt * axle) + h2 * tilt * axle)
    wheel_x, wheel_y, wheel_z = cars.wheel
    centre = np.stack([wheel_x, wheel_y, wheel_z + state[TRAVEL]])
    sides = np.array([1.0, -1.0])[:, None, None]
    axle_e = axle[:, None]
    middle = centre[:, None] + cars.edge * sides * axle_e  # (3, 2, 4, n)
    n_e = n[:, None, None]
    sunk = np.maximum(reach - state[2] - dot(n_e, middle), 0.0)
    lever = down[:, None] + sunk * n_e
    place = middle + lever
    spinning = cross(axle_e, lever)
    velocity = v[:, None, None] + cross(w[:, None, None], place)

    # Suspension: its rate and the loads follow from one balance per wheel.
    closing = -dot(n_e, velocity)
    slip = velocity + spinning * spin + closing * n_e  # along the ground, as `spinning`
    sliding = cars.friction / np.sqrt(dot(slip, slip) + cars.slip_speed**2)
    n_z = n[2]
    lean = n_z - sliding * slip[2]
    spring = cars.tyre_stiffness * sunk
    undamped = spring * np.maximum(1.0 + cars.tyre_dissipation * closing, 0.0)
    carried = cars.preload + cars.spring * state[TRAVEL] + cars.unsprung * cars.gravity * n_z
    tyre_damping = np.maximum(lean, 0.0) * cars.tyre_dissipation * spring * n_z
    holding = cars.damper + np.sum(tyre_damping, axis=0)
    travel_rate = (np.sum(undamped * lean, axis=0) - carried) / holding
    sinking = closing - n_z * travel_rate
    load = spring * np.maximum(1.0 + cars.tyre_dissipation * sinking, 0.0)

    grip = sliding * load
    push = load * n_e - grip * slip
    _press(place, push, grip, n, force, damping)
    pushed = grip * spinning
    force[SPIN] -= np.sum(dot(pushed, slip), axis=0)
    moments = np.sum(cross(place, pushed), axis=1)
    mixed = np.concatenate([moments, np.sum(pushed, axis=1)])  # (6, 4, n)
    damping[:6, SPIN] += mixed
    damping[SPIN, :6] += np.swapaxes(mixed, 0, 1)
    own = np.sum(dot(pushed, spinning), axis=0)

    # Wheels and drive: the shaft turns at the mean of the rear wheels.
    rounded = np.tanh(spin / ROLLING_RATE)
    resisting = cars.rolling * rounded
    slope = cars.rolling * (1.0 - rounded * rounded) / ROLLING_RATE
    force[SPIN] -= resisting
    shaft_speed = 0.5 * (spin[2] + spin[3])
    asked = cars.shaft_gain * (commands.shaft_speed - shaft_speed) + np.sum(resisting, axis=0)
    limit = cars.shaft_limit
    torque = np.clip(asked, -limit, limit)
    governed = 0.25 * cars.shaft_gain * (np.abs(asked) < limit)
    inertia = cars.wheel_inertia
    for wheel in range(4):
        place = 6 + wheel
        coupling = inertia * axle[:, wheel]
        mass[place, place] = inertia
        mass[W, place] = coupling
        mass[place, W] = coupling
        damping[place, place] += own[wheel] + slope[wheel]
    rear = slice(8, 10)
    mass[rear, rear] += 0.25 * cars.shaft_inertia
    damping[rear, rear] += governed
    force[rear] += 0.5 * torque
    force[W] -= cross(w, inertia * np.sum(axle * spin, axis=1))
    return travel_rate, np.sum(load, axis=0)


def _board(state: FloatArray, cars: Vehicles, force: FloatArray, damping: FloatArray) -> None:
    """Adds the ground's force on the anti-ramp board, which keeps a car that gathers speed from
    tipping over.
    """
    w = state[RATES][W]
    v = state[RATES][V]
    n = up_in_body(state)
    n_e = n[:, None]
    velocity = v[:, None] + cross(w[:, None], cars.board)  # (3, 2, n)
    sunk = np.maximum(-state[2] - dot(n_e, cars.board), 0.0)
    closing = -dot(n_e, velocity)
    load = CAGE_STIFFNESS * sunk * np.maximum(1.0 + BOARD_DISSIPATION * closing, 0.0)
    slip = velocity + closing * n_e
    slip_speed = np.sqrt(dot(slip, slip) + SLIDING**2)
    grip = cars.board_friction * load / slip_speed
    push = load * n_e - grip * slip
    _press(cars.board, push, grip, n, force, damping)


def _press(
    place: FloatArray,
    push: FloatArray,
    grip: FloatArray,
    n: FloatArray,
    force: FloatArray,
    damping: FloatArray,
) -> None:
    """Adds forces of the ground on the body, all in B.

    Args:
        place: (3, ..., n), m.
        push: (3, ..., n), N.
        grip: its slope with the slip in any direction along the ground (..., n), N s/m.
        n: upright (3, n).
    """
    columns = (3, -1, n.shape[-1])
    place = place.reshape(columns)
    push = push.reshape(columns)
    grip = grip.reshape(columns[1:])
    force[W] += np.sum(cross(place, push), axis=1)
    force[V] += np.sum(push, axis=1)
    flat = np.eye(3)[:, :, None] - _outer(n, n)
    damping[V, V] += np.sum(grip, axis=0) * flat
    heavy = grip * place
    arm = cross(place, n[:, None])
    crossed = heavy[:, None] * place + (grip * arm)[:, None] * arm
    damping[W, W] -= np.sum(crossed, axis=2)
    for axis in range(3):
        damping[axis, axis] += np.sum(dot(heavy, place), axis=0)
        turned = cross(np.sum(heavy, axis=1), flat[axis])
        damping[W, 3 + axis] += turned
        damping[3 + axis, W] += turned
