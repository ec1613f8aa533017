"""The spatial reduced model: the car's roll under a prescribed roll and pitch motion of the tail.

The car is that of `planar_model`: it rolls, and slides sideways on its tyres. The tail is a rigid body on two joints;
forward and yaw motion come from the profile of the turn. The tail's whole wrench acts on the car: its roll moment
directly; its yaw moment through the rear tyres; its pitch moment through the load on the front axle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerodima.optimisation.swing.planar_model import (
    axis_point_height,
    lift_state,
    point_slopes,
    sail_forces,
    suspension_moment,
    wheel_height,
)
from aerodima.optimisation.swing.reduced_car import ReducedCar

Array = NDArray
Vector = tuple[Any, Any, Any]
CORNER_ROUNDING = 1e-4
"""Under the root that keeps the height of the lower corner smooth, so 0.01 of a half width."""


def motion(
    roll: Array, roll_rate: Array, tail: tuple[Array, Array, Array], inputs: Array, car: ReducedCar
) -> tuple[Array, Array]:
    """What a told tail motion does to the car, and what it asks of the motors.

    Args:
        roll, roll_rate: of the car, (...).
        tail: angles, rates and accelerations of roll and pitch, each (..., 2).
        inputs: (..., 6) as `planar_model.INPUTS`.
        car: numbers.

    Returns:
        Roll acceleration, rad/s2, (...), and motor torques of roll and pitch, N m, (..., 2).
    """
    (q, p), (q_rate, p_rate), (q_acc, p_acc) = (np.moveaxis(values, -1, 0) for values in tail)
    ratio, yaw_force, speed, lateral_speed, yaw_rate, unexplained = np.moveaxis(inputs, -1, 0)
    s, c = np.sin(roll), np.cos(roll)
    X, N, e = _tail_axes(s, c, p, q)
    Y = (0.0, c, s)
    lift, wheel = lift_state(roll, car), wheel_height(s, c, car)
    Ay, Az, A2y, A2z = point_slopes(car.com_height - car.tyre_radius, s, c, lift, wheel, car)
    By, Bz, B2y, B2z = point_slopes(car.axis_height - car.tyre_radius, s, c, lift, wheel, car)
    squared = roll_rate * roll_rate

    turning = _sum((roll_rate, 0.0, 0.0), _times(p_rate, Y))
    w = _sum(turning, _times(q_rate, X))
    bias = _sum(
        _sum(_times(p_acc, Y), _times(q_acc, X)),
        _sum(_times(p_rate * roll_rate, (0.0, -s, c)), _times(q_rate, _cross(turning, X))),
    )
    velocity = (speed, lateral_speed + By * roll_rate, Bz * roll_rate)
    F_air, M_air = _air(velocity, (w[0], w[1], w[2] + yaw_rate), X, N, e, car)
    # The wrench of car on tail, at the joints: for no sideways and roll acceleration, and per unit of each.
    m, g = car.tail_mass, car.gravity
    J = (X, N, e)

    def wrench(a_o: Vector, alpha: Vector, spin: bool) -> tuple[Vector, Vector]:
        arm = _times(car.tail_com, e)
        a_com = _sum(a_o, _cross(alpha, arm))
        moment = _sum(_cross(arm, _times(m, a_o)), _inertia(J, alpha, car))
        if spin:
            a_com = _sum(a_com, _cross(w, _cross(w, arm)))
            moment = _sum(moment, _cross(w, _inertia(J, w, car)))
        return _times(m, a_com), moment

    F0, M0 = wrench((0.0, B2y * squared, B2z * squared + g), bias, True)
    F0, M0 = _sum(F0, _times(-1.0, F_air)), _sum(M0, _times(-1.0, M_air))
    Fy, My = wrench((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), False)
    Fr, Mr = wrench((0.0, By, Bz), (1.0, 0.0, 0.0), False)

    # Sideways force of the ground F = f0 + f_y y'' + f_r roll'', from yaw and pitch balance about the rear axle.
    M, height = car.mass, car.axis_height
    r_o = (car.axis_x, -s * height, c * height)

    def tyres(force: Vector, moment: Vector) -> Any:
        """Front axle's and rear axle's answer to the wrench of the tail on the car."""
        on_car = _times(-1.0, force)
        about = _sum(_cross(r_o, on_car), _times(-1.0, moment))
        return ratio * about[1] / car.com_x + about[2] / car.com_x - on_car[1]

    f0 = ratio * M * (g + A2z * squared) + tyres(F0, M0) - yaw_force * (M + m) * g
    f_y = tyres(Fy, My)
    f_r = ratio * M * Az + tyres(Fr, Mr)

    gyroscopic = car.wheel_spin_inertia * speed / car.tyre_radius * yaw_rate
    spring = suspension_moment(roll, roll_rate, lift[1], car)
    # M y'' + ... = F + T_y, and the roll equation; the tail's share of both is -wrench.
    a11 = M + Fy[1] - f_y
    a12 = M * Ay + Fr[1] - f_r
    b1 = f0 - F0[1] - M * A2y * squared
    H = wheel[0]
    a21 = M * Ay - H * f_y + By * Fy[1] + Bz * Fy[2] + My[0]
    a22 = M * (Ay * Ay + Az * Az) + car.inertia - H * f_r + By * Fr[1] + Bz * Fr[2] + Mr[0]
    b2 = H * f0 - g * M * Az + spring + gyroscopic + unexplained - M * (Ay * A2y + Az * A2z) * squared
    b2 = b2 - By * F0[1] - Bz * F0[2] - M0[0]
    determinant = a11 * a22 - a12 * a21
    sideways, acceleration = (b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a21 * b1) / determinant

    moment = _sum(M0, _sum(_times(sideways, My), _times(acceleration, Mr)))
    torque_roll = _dot(moment, X) + car.rotor_inertia * q_acc + _friction(q_rate, car)
    torque_pitch = _dot(moment, Y) + (car.rotor_inertia + car.hub_inertia) * p_acc + _friction(p_rate, car)
    return acceleration, np.stack(np.broadcast_arrays(torque_roll, torque_pitch), axis=-1)


def tip_height(roll: Array, angles: Array, car: ReducedCar) -> Array:
    """Height of the lower corner of the sail's tip above the ground, m, (...).

    Args:
        roll: of the car, (...).
        angles: tail roll and pitch, (..., 2).
        car: numbers.
    """
    s, c = np.sin(roll), np.cos(roll)
    X, _, e = _tail_axes(s, c, angles[..., 1], angles[..., 0])
    corner = car.sail_half_width * np.sqrt(X[2] * X[2] + CORNER_ROUNDING)
    return axis_point_height(roll, car) + car.tail_length * e[2] - corner


def _tail_axes(s: Array, c: Array, p: Array, q: Array) -> tuple[Vector, Vector, Vector]:
    """Chord, normal of the sail and tail axis of a tail with pitch p and roll q on a car with roll (s, c)."""
    sp, cp, sq, cq = np.sin(p), np.cos(p), np.sin(q), np.cos(q)
    return (
        (cp, s * sp, -c * sp),
        (sp * sq, c * cq - s * cp * sq, s * cq + c * cp * sq),
        (sp * cq, -c * sq - s * cp * cq, -s * sq + c * cp * cq),
    )


def _air(velocity: Vector, w: Vector, X: Vector, N: Vector, e: Vector, car: ReducedCar) -> tuple[Vector, Vector]:
    """Force of the air on the sail and its moment about the joints."""
    k = _cross(w, e)
    distance = np.array(car.section_distances)
    across = _dot(velocity, N)[..., None] + distance * _dot(k, N)[..., None]
    along = _dot(velocity, X)[..., None] + distance * _dot(k, X)[..., None]
    normal, chord = sail_forces(across, along, -1.0, car)
    F = _sum(_times(normal.sum(-1), N), _times(chord.sum(-1), X))
    return F, _sum(_times(-(normal * distance).sum(-1), X), _times((chord * distance).sum(-1), N))


def _inertia(axes: tuple[Vector, Vector, Vector], w: Vector, car: ReducedCar) -> Vector:
    """J w about the joints."""
    total: Vector = (0.0, 0.0, 0.0)
    for moment, axis in zip(car.tail_inertia, axes, strict=True):
        total = _sum(total, _times(moment * _dot(axis, w), axis))
    return total


def _friction(rate: Array, car: ReducedCar) -> Array:
    return car.coulomb * np.tanh(car.tanh_gain * rate) + car.viscous * rate


def _dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _times(k: Any, a: Vector) -> Vector:
    return k * a[0], k * a[1], k * a[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
