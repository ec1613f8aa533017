"""The planar reduced model: the car's roll and the tail's roll, driven by the turn.

Seen from behind, the car is a rigid body on two suspended sides that slides sideways on its tyres; the tail turns about
a joint on its deck. Coordinates: sideways motion y of the outer wheels, car roll phi, tail roll q. Vertically the outer
tyres stay on the ground. While the inner tyres bear load the body rolls about its middle on springs and dampers, once
they have lifted it rolls about the outer contact line; the change is smooth. y leaves the equations, since nothing
depends on it: what remains are four states.

The ground's sideways force follows from the yaw balance of the full car in a turn: the front tyres slide, so they push
with `front_ratio` times the load on the front axle, and the rear tyres give what the yaw motion of the turn then
asks for. A force on the tail, which stands over the rear axle, therefore changes the rear tyres' share, not the turn:

    F_front = front_ratio N_front,    F_rear a_r = F_front a_f - T_y (a_r - x_tail) - yaw_force W a_r,

with a_f, a_r the distances of the axles from the centre of mass, T_y the sideways force of the tail on the car and W
the weight. N_front is the load that the vertical forces of this motion put on the front axle; what braking adds to it
is part of `front_ratio`, which the profile measures against the same load. The drag D of a sail that faces the wind, at
height z and y to the left, adds (front_ratio D z - D y) to F_rear a_r (D < 0).

Valid while the outer wheels bear load and the roll is below about 0.6 rad; pitch and heave of the body are left out.
Signs: those of the car (design section 4), written for a left turn: roll positive outwards (to the right), tail roll
-90 degrees inside. A right turn is the mirror image; callers mirror the signs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from aerodima.optimisation.swing.reduced_car import ReducedCar

Array = NDArray  # float64, or complex128 in a complex step

STATES = ("roll", "tail_roll", "roll_rate", "tail_roll_rate")
"""rad, rad, rad/s, rad/s."""
CONTROLS = ("tail_roll_torque",)
"""Torque of the roll motor, N m."""
INPUTS = ("front_ratio", "yaw_force", "speed", "lateral_speed", "yaw_rate", "roll_moment")
"""What the turn does to the car: sideways over vertical force of the front tyres (1, positive to the left); rear tyre
force that the yaw acceleration takes away, over the weight (1); velocity of the body origin forwards and to the left,
m/s; yaw rate, rad/s; moment on the roll that the model does not explain in the run, N m outwards."""

LIFT_WIDTH = 0.012
"""Roll over which the inner tyres leave the ground, rad: width of a smooth step."""
LOAD_ROUNDING = 0.15
"""Rounding of the corner where an inner tyre's load becomes zero, as a share of the load."""
SIDE_BLEND = 0.1
"""Air speed over which a sail with two sides changes its coefficient, m/s."""


def derivative(state: Array, control: Array, inputs: Array, car: ReducedCar) -> Array:
    """Time derivative of the state; arrays broadcast over their leading axes, and complex steps pass through.

    Args:
        state: (..., 4) as `STATES`.
        control: (..., 1) as `CONTROLS`.
        inputs: (..., 6) as `INPUTS`.
        car: numbers.

    Returns:
        (..., 4).
    """
    m11, m12, m21, m22, b1, b2 = _equations(state, control, inputs, car)
    determinant = m11 * m22 - m12 * m21
    roll_acceleration = (m22 * b1 - m12 * b2) / determinant
    tail_acceleration = (m11 * b2 - m21 * b1) / determinant
    return np.stack(np.broadcast_arrays(state[..., 2], state[..., 3], roll_acceleration, tail_acceleration), axis=-1)


def roll_acceleration(state: Array, tail_acceleration: Array, inputs: Array, car: ReducedCar) -> Array:
    """Roll acceleration (rad/s2, shape (...)) while the tail moves as told, whatever torque that takes.

    Args:
        tail_acceleration: of the tail roll, rad/s2, shape (...); zero for a tail held on its stop.
    """
    m11, m12, _, _, b1, _ = _equations(state, np.zeros(1), inputs, car)
    return (b1 - m12 * tail_acceleration) / m11


def holding_torque(state: Array, inputs: Array, car: ReducedCar) -> Array:
    """Torque (N m, shape (...)) of motor or stop that keeps the tail's roll acceleration zero."""
    m11, _, m21, _, b1, b2 = _equations(state, np.zeros(1), inputs, car)
    return m21 * b1 / m11 - b2


def _equations(state: Array, control: Array, inputs: Array, car: ReducedCar) -> tuple[Array, ...]:
    """m11, m12, m21, m22, b1, b2 of M (roll'', tail_roll'') = b, sideways motion eliminated."""
    roll, tail_roll, roll_rate, tail_rate = np.moveaxis(state, -1, 0)
    ratio, yaw_force, speed, lateral_speed, yaw_rate, unexplained = np.moveaxis(inputs, -1, 0)
    alpha, alpha_rate = roll + tail_roll, roll_rate + tail_rate
    s, c = np.sin(roll), np.cos(roll)
    e_y, e_z = -np.sin(alpha), np.cos(alpha)  # along the tail
    n_y, n_z = -e_z, e_y  # direction in which positive roll moves it
    lift = lift_state(roll, car)
    wheel = wheel_height(s, c, car)
    Ay, Az, A2y, A2z = point_slopes(car.com_height - car.tyre_radius, s, c, lift, wheel, car)
    By, Bz, B2y, B2z = point_slopes(car.axis_height - car.tyre_radius, s, c, lift, wheel, car)

    M, m, ml, J = car.mass, car.tail_mass, car.tail_mass * car.tail_com, car.tail_inertia[0]
    air_y, air_z, air_roll, air_tail, drag, drag_lever = _air(
        (By, Bz, n_y, n_z, e_y), roll_rate, alpha_rate, (speed, lateral_speed, yaw_rate), car
    )
    Bn = By * n_y + Bz * n_z
    # Mass matrix in (y, roll, tail roll); the tail's own rows of sideways and upward momentum are t_y and t_z.
    t_y, t_z = m * By + ml * n_y, m * Bz + ml * n_z
    y1, y2 = M * Ay + t_y, ml * n_y
    r1 = M * (Ay * Ay + Az * Az) + car.inertia + m * (By * By + Bz * Bz) + 2 * ml * Bn + J
    r2, t2 = ml * Bn + J, J + car.rotor_inertia
    squared, tail_squared = roll_rate * roll_rate, alpha_rate * alpha_rate
    c_tail_y = m * B2y * squared - ml * e_y * tail_squared
    c_tail_z = m * B2z * squared - ml * e_z * tail_squared
    c_y = M * A2y * squared + c_tail_y
    c_roll = (M * (Ay * A2y + Az * A2z) + m * (By * B2y + Bz * B2z) + ml * (n_y * B2y + n_z * B2z)) * squared
    c_roll = c_roll - ml * (e_y * By + e_z * Bz) * tail_squared
    c_tail = ml * (n_y * B2y + n_z * B2z) * squared

    # Sideways force of the ground F = f0 + f_y y'' + f1 roll'' + f2 tail_roll'', from yaw and pitch balance.
    g, weight = car.gravity, (M + m) * car.gravity
    behind = -car.axis_x / car.com_x
    load0 = M * (g + A2z * squared) - behind * (m * g + c_tail_z - air_z)
    load1, load2 = M * Az - behind * t_z, -behind * ml * n_z
    kappa = 1.0 + behind
    # Drag along the car, at its height and to its side: it unloads the front axle, and yaws.
    drag_up, drag_left = c * car.axis_height * drag + e_z * drag_lever, -s * car.axis_height * drag + e_y * drag_lever
    f0 = ratio * load0 - yaw_force * weight - kappa * (air_y - c_tail_y) + (ratio * drag_up - drag_left) / car.com_x
    f_y, f1, f2 = kappa * m, ratio * load1 + kappa * t_y, ratio * load2 + kappa * ml * n_y

    gyroscopic = car.wheel_spin_inertia * speed / car.tyre_radius * yaw_rate
    spring = suspension_moment(roll, roll_rate, lift[1], car)
    friction = car.coulomb * np.tanh(car.tanh_gain * tail_rate) + car.viscous * tail_rate
    right_y = f0 + air_y - c_y
    right_roll = wheel[0] * f0 - g * (M * Az + t_z) + spring + gyroscopic + air_roll - c_roll + unexplained
    right_tail = control[..., 0] - friction - g * ml * n_z + air_tail - c_tail

    # Sideways acceleration out: y'' = (right_y - a1 roll'' - a2 tail_roll'') / total.
    total, across = M + m - f_y, (y1 - wheel[0] * f_y, y2)
    a1, a2 = y1 - f1, y2 - f2
    m11 = r1 - wheel[0] * f1 - across[0] * a1 / total
    m12 = r2 - wheel[0] * f2 - across[0] * a2 / total
    m21 = r2 - across[1] * a1 / total
    m22 = t2 - across[1] * a2 / total
    b1 = right_roll - across[0] * right_y / total
    b2 = right_tail - across[1] * right_y / total
    return m11, m12, m21, m22, b1, b2


def linearise(state: Array, control: Array, inputs: Array, car: ReducedCar) -> tuple[Array, Array]:
    """A = df/dx (..., 4, 4) and B = df/du (..., 4, 1) by complex steps, exact to rounding.

    Args: as `derivative`, real.
    """
    states, controls = len(STATES), len(CONTROLS)
    step = 1e-30
    shift = step * 1j * np.eye(states + controls)
    moved_state = state + shift[:, :states].reshape(-1, *([1] * (state.ndim - 1)), states)
    moved_control = control + shift[:, states:].reshape(-1, *([1] * (control.ndim - 1)), controls)
    slopes = np.moveaxis(derivative(moved_state, moved_control, inputs, car).imag / step, 0, -1)
    return slopes[..., :states], slopes[..., states:]


def lift_roll(car: ReducedCar) -> float:
    """Roll at which the inner tyres leave the ground in a slow turn, rad."""
    return (car.mass + car.tail_mass) * car.gravity / (2 * car.half_track * car.side_stiffness)


def lift_state(roll: Array, car: ReducedCar) -> tuple[Array, Array, Array]:
    """Compression of the outer side (m), share of the lift (0 inner tyres loaded, 1 lifted) and its slope (1/rad)."""
    x = (roll - lift_roll(car)) / LIFT_WIDTH
    small = np.exp(-np.where(x.real > 0, x, -x))
    above = np.where(x.real > 0, x, 0.0) + np.log(1.0 + small)
    share = np.where(x.real > 0, 1.0, small) / (1.0 + small)
    return car.half_track * (roll - LIFT_WIDTH * above), share, share * (1.0 - share) / LIFT_WIDTH


def wheel_height(s: Array, c: Array, car: ReducedCar) -> tuple[Array, Array, Array]:
    """Height of the outer wheels' centres over the ground for an ellipsoid tyre, m, and its slopes with roll."""
    R2, w2 = car.tyre_radius**2, car.tyre_half_width**2
    height = np.sqrt(R2 * c * c + w2 * s * s)
    slope = -(R2 - w2) * s * c / height
    return height, slope, (-(R2 - w2) * (c * c - s * s) - slope * slope) / height


def suspension_moment(roll: Array, roll_rate: Array, lifted: Array, car: ReducedCar) -> Array:
    """Moment of springs and dampers about the body's middle, N m: load moved outwards, at most all of it."""
    weight = (car.mass + car.tail_mass) * car.gravity
    moved = 2 * car.half_track * (car.side_stiffness * roll + car.side_damping * roll_rate) / weight
    clipped = 0.5 * (np.sqrt((moved + 1) ** 2 + LOAD_ROUNDING**2) - np.sqrt((moved - 1) ** 2 + LOAD_ROUNDING**2))
    return -weight * car.half_track * (1.0 - lifted) * clipped


def point_slopes(
    above_wheels: float, s: Array, c: Array, lift: tuple[Array, ...], wheel: tuple[Array, ...], car: ReducedCar
) -> tuple[Array, Array, Array, Array]:
    """First and second derivatives with roll of a point (y from the outer wheels' centres, z) on the car's middle."""
    b = car.half_track
    compression, share, slope = lift
    height, first, second = above_wheels - compression, b * (1.0 - share), -b * slope
    return (
        -b * s - height * c + first * s,
        wheel[1] + b * c - height * s - first * c,
        -b * c + height * s + 2 * first * c + second * s,
        wheel[2] - b * s - height * c + 2 * first * s - second * c,
    )


def _air(
    geometry: tuple[Array, ...], roll_rate: Array, alpha_rate: Array, motion: tuple[Array, ...], car: ReducedCar
) -> tuple[Array, ...]:
    """Force of the air on the sail (y, z), its moments on car roll and tail roll, drag along x and its first moment."""
    By, Bz, n_y, n_z, e_y = (value[..., None] for value in geometry)
    speed, lateral_speed, yaw_rate = (value[..., None] for value in motion)
    distance = np.array(car.section_distances)
    lever = By * n_y + Bz * n_z
    across = lever * roll_rate[..., None] + distance * alpha_rate[..., None] + lateral_speed * n_y
    along = speed - yaw_rate * distance * e_y
    force, drag = sail_forces(across, along, 1.0, car)
    total, moment = force.sum(-1), (force * distance).sum(-1)
    n_y, n_z, lever = n_y[..., 0], n_z[..., 0], lever[..., 0]
    return total * n_y, total * n_z, total * lever + moment, moment, drag.sum(-1), (drag * distance).sum(-1)


def sail_forces(across: Array, along: Array, side: float, car: ReducedCar) -> tuple[Array, Array]:
    """Force of the air on each section along its normal and along its chord, N (design section 5).

    Args:
        across, along: velocity of the section in the air along normal and chord, m/s, (..., sections).
        side: +1 if the normal is that of `car.normal_side`, -1 if it points the other way.
        car: numbers; only a sail that faces the wind drags along its chord.
    """
    mean, half = 0.5 * (car.force_along + car.force_against), 0.5 * (car.force_along - car.force_against)
    coefficient = mean + side * half * np.tanh(car.normal_side * across / SIDE_BLEND) if half else mean
    speed = np.sqrt(across * across + along * along + 1e-12)
    pressure = -0.5 * car.air_density * np.array(car.section_areas) * speed
    return pressure * coefficient * across, pressure * car.force_chord * along


def motion(
    roll: Array, roll_rate: Array, tail: tuple[Array, Array, Array], inputs: Array, car: ReducedCar
) -> tuple[Array, Array]:
    """What a told tail motion does to the car, and what it asks of the motor.

    Args:
        roll, roll_rate: of the car, (...).
        tail: angle, rate and acceleration of the tail roll, each (..., 1).
        inputs: (..., 6) as `INPUTS`.
        car: numbers.

    Returns:
        Roll acceleration, rad/s2, (...), and motor torque, N m, (..., 1).
    """
    angle, rate, acceleration = (values[..., 0] for values in tail)
    state = np.stack(np.broadcast_arrays(roll, angle, roll_rate, rate), axis=-1)
    m11, m12, m21, m22, b1, b2 = _equations(state, np.zeros(1), inputs, car)
    roll_acceleration = (b1 - m12 * acceleration) / m11
    return roll_acceleration, (m21 * roll_acceleration + m22 * acceleration - b2)[..., None]


def tip_height(roll: Array, angles: Array, car: ReducedCar) -> Array:
    """Height of the tail's tip above the ground, m, (...).

    Args:
        roll: of the car, (...).
        angles: tail roll, (..., 1).
        car: numbers.
    """
    return axis_point_height(roll, car) + car.tail_length * np.cos(roll + angles[..., 0])


def axis_point_height(roll: Array, car: ReducedCar) -> Array:
    """Height of the tail's joints above the ground, m."""
    s, c = np.sin(roll), np.cos(roll)
    above = car.axis_height - car.tyre_radius - lift_state(roll, car)[0]
    return wheel_height(s, c, car)[0] + car.half_track * s + above * c
