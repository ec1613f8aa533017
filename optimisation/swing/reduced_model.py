"""The reduced model: the car's roll under a prescribed motion of the tail, driven by the turn.

Seen from behind, the car is a rigid body on two suspended sides that slides sideways on its tyres; the tail is a rigid
body on a pitch and a roll joint on its deck, whose motion is prescribed, or on a roll joint alone with the pitch at
zero. Coordinates: sideways motion y of the outer wheels, car roll phi. Vertically the outer tyres stay on the ground.
While the inner tyres bear load the body rolls about its middle on springs and dampers, once they have lifted it rolls
about the outer contact line; the change is smooth. y leaves the equations, since nothing depends on it.

Forward and yaw motion come from the profile of the turn. The ground's sideways force follows from the yaw balance of
the full car in a turn: the front tyres slide, so they push with `front_ratio` times the load on the front axle, and the
rear tyres give what the yaw motion of the turn then asks for. A force on the tail, which stands over the rear axle,
therefore changes the rear tyres' share, not the turn:

    F_front = front_ratio N_front,    F_rear a_r = F_front a_f - T_y (a_r - x_tail) - yaw_force W a_r,

with a_f, a_r the distances of the axles from the centre of mass, T_y the sideways force of the tail on the car and W
the weight. N_front is the load that the vertical forces of this motion put on the front axle; what braking adds to it
is part of `front_ratio`, which the profile measures against the same load. The tail's whole wrench acts on the car: its
roll moment directly; its yaw moment through the rear tyres; its pitch moment through the load on the front axle. So a
sail that drags on the inside of the turn costs rear grip as well, and one that is pitched into the wind presses down.

Valid while the outer wheels bear load and the roll is below about 0.6 rad; pitch and heave of the body are left out, as
are the gyroscopic terms of a tail that yaws with the car. Axes: x forwards, y to the left, z up, not rolled with the
car. Signs: those of the car (design section 4), written for a left turn: roll positive outwards (to the right), tail
roll -90 degrees inside. A right turn is the mirror image; callers mirror the signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from aerodima.optimisation.swing.reduced_car import ReducedCar, lift_state, suspension_moment, wheel_height
from aerodima.optimisation.swing.straight_line import written_out
from aerodima.workbench.plants.joint_friction import smooth_friction

Array = NDArray  # float64, or complex128 in a complex step

STATES = ("roll", "tail_roll", "roll_rate", "tail_roll_rate")
"""Of the model with the tail's roll alone, driven by the torque of its motor; rad, rad, rad/s, rad/s."""
INPUTS = ("front_ratio", "yaw_force", "speed", "lateral_speed", "yaw_rate", "roll_moment")
"""What the turn does to the car: sideways over vertical force of the front tyres (1, positive to the left); rear tyre
force that the yaw acceleration takes away, over the weight (1); velocity of the body origin forwards and to the left,
m/s; yaw rate, rad/s; moment on the roll that the model does not explain in the run, N m outwards."""

SIDE_BLEND = 0.1
"""Air speed over which a sail with two sides changes its coefficient, m/s."""
CORNER_ROUNDING = 1e-4
"""Under the root that keeps the height of the lower corner smooth, so 0.01 of a half width."""
COMPLEX_STEP = 1e-30
"""Of values and torques alike: derivatives without a difference of close numbers, exact to rounding."""


@dataclass(slots=True)
class Vector:
    """Three components, numbers or symbols of a calculation that is written out."""

    x: Any = 0.0
    y: Any = 0.0
    z: Any = 0.0

    __array_ufunc__ = None  # a NumPy number * Vector is a Vector

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vector) -> Vector:
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __rmul__(self, k: Any) -> Vector:
        return Vector(k * self.x, k * self.y, k * self.z)

    def dot(self, other: Vector) -> Any:
        """Scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vector) -> Vector:
        """Vector product."""
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )


def motion(
    roll: Array, roll_rate: Array, tail: tuple[Array, Array, Array], inputs: Array, car: ReducedCar
) -> tuple[Array, Array]:
    """What a prescribed tail motion does to the car, and what it asks of the motors; complex steps pass through.

    Args:
        roll, roll_rate: of the car, (...).
        tail: angles, rates and accelerations of roll and pitch, each (..., 2), or of roll alone, (..., 1).
        inputs: (..., 6) as `INPUTS`.
        car: numbers.

    Returns:
        Roll acceleration, rad/s2, (...), and motor torques of the joints, N m, (..., joints).
    """
    joints = tail[0].shape[-1]
    columns = [roll, roll_rate, *np.moveaxis(inputs, -1, 0)]
    for values in tail:
        columns.extend(np.moveaxis(values, -1, 0))
    acceleration, *torques = written_out(_motion, 8 + 3 * joints, car)(*columns)
    return acceleration, np.stack(np.broadcast_arrays(*torques), axis=-1)


def _motion(car: ReducedCar, *numbers: Any) -> tuple[Any, ...]:
    """As `motion`, of numbers: roll acceleration and torques."""
    roll, roll_rate, ratio, yaw_force, speed, lateral_speed, yaw_rate, unexplained, *tail = numbers
    joints = len(tail) // 3
    (q, p), (q_rate, p_rate), (q_acc, p_acc) = (_joints(tail[k * joints : (k + 1) * joints]) for k in range(3))
    s, c = np.sin(roll), np.cos(roll)
    X, N, e = _tail_axes(s, c, p, q)
    Y, Z = Vector(0.0, c, s), Vector(0.0, -s, c)
    lift, wheel = lift_state(roll, car), wheel_height(s, c, car)
    A, A2 = point_slopes(car.com_height - car.tyre_radius, s, c, lift, wheel, car)
    B, B2 = point_slopes(car.axis_height - car.tyre_radius, s, c, lift, wheel, car)
    squared = roll_rate * roll_rate

    turning = Vector(roll_rate) + p_rate * Y
    w = turning + q_rate * X
    bias = p_acc * Y + q_acc * X + (p_rate * roll_rate * Z + q_rate * turning.cross(X))
    velocity = Vector(speed, lateral_speed) + roll_rate * B
    F_air, M_air = _air(velocity, w + Vector(z=yaw_rate), X, N, e, car)
    # The wrench of car on tail, at the joints: for no sideways and roll acceleration, and per unit of each.
    m, g, arm = car.tail_mass, car.gravity, car.tail_com * e

    def inertia(turn: Vector) -> Vector:
        total = Vector()
        for moment, axis in zip(car.tail_inertia, (X, N, e), strict=True):
            total = total + moment * axis.dot(turn) * axis
        return total

    def wrench(a_o: Vector, alpha: Vector, spin: Vector) -> tuple[Vector, Vector]:
        acceleration = a_o + alpha.cross(arm) + spin.cross(spin.cross(arm))
        return m * acceleration, arm.cross(m * a_o) + inertia(alpha) + spin.cross(inertia(spin))

    F0, M0 = wrench(squared * B2 + Vector(z=g), bias, w)
    F0, M0 = F0 - F_air, M0 - M_air
    Fy, My = wrench(Vector(y=1.0), Vector(), Vector())
    Fr, Mr = wrench(B, Vector(1.0), Vector())

    # Sideways force of the ground F = f0 + f_y y'' + f_r roll'', from yaw and pitch balance about the rear axle.
    M = car.mass
    r_o = Vector(car.axis_x) + car.axis_height * Z

    def tyres(force: Vector, moment: Vector) -> Any:
        """Front axle's and rear axle's answer to the wrench of the tail on the car."""
        about = r_o.cross(-1.0 * force) - moment
        return ratio * about.y / car.com_x + about.z / car.com_x + force.y

    f0 = ratio * M * (g + A2.z * squared) + tyres(F0, M0) - yaw_force * (M + m) * g
    f_y = tyres(Fy, My)
    f_r = ratio * M * A.z + tyres(Fr, Mr)

    gyroscopic = car.wheel_spin_inertia * speed / car.tyre_radius * yaw_rate
    spring = suspension_moment(roll, roll_rate, lift[1], car)
    # M y'' + ... = F + T_y, and the roll equation; the tail's share of both is -wrench.
    H = wheel[0]
    a11 = M + Fy.y - f_y
    a12 = M * A.y + Fr.y - f_r
    b1 = f0 - F0.y - M * A2.y * squared
    a21 = M * A.y - H * f_y + B.dot(Fy) + My.x
    a22 = M * A.dot(A) + car.inertia - H * f_r + B.dot(Fr) + Mr.x
    b2 = H * f0 - g * M * A.z + spring + gyroscopic + unexplained - M * A.dot(A2) * squared - B.dot(F0) - M0.x
    determinant = a11 * a22 - a12 * a21
    sideways, acceleration = (b1 * a22 - a12 * b2) / determinant, (a11 * b2 - a21 * b1) / determinant

    friction = smooth_friction(car.coulomb, car.viscous, car.tanh_gain, tanh=np.tanh)
    moment = M0 + (sideways * My + acceleration * Mr)
    torques = [moment.dot(X) + car.rotor_inertia * q_acc - friction(q_rate)]
    if joints == 2:
        torques.append(moment.dot(Y) + (car.rotor_inertia + car.hub_inertia) * p_acc - friction(p_rate))
    return acceleration, *torques


def tip_height(roll: Array, angles: Array, car: ReducedCar) -> Array:
    """Height of the lowest point of the sail's tip above the ground, m, (...): of its lower corner when it is pitched.

    Args:
        roll: of the car, (...).
        angles: tail roll and pitch, (..., 2), or roll alone, (..., 1).
        car: numbers.
    """
    return np.asarray(written_out(_tip_height, 1 + angles.shape[-1], car)(roll, *np.moveaxis(angles, -1, 0))[0])


def _tip_height(car: ReducedCar, roll: Any, *angles: Any) -> tuple[Any]:
    q, p = _joints(angles)
    s, c = np.sin(roll), np.cos(roll)
    X, _, e = _tail_axes(s, c, p, q)
    corner = 0.0 if len(angles) == 1 else car.sail_half_width * np.sqrt(X.z * X.z + CORNER_ROUNDING)
    above = car.axis_height - car.tyre_radius - lift_state(roll, car)[0]
    return (wheel_height(s, c, car)[0] + car.half_track * s + above * c + car.tail_length * e.z - corner,)


def derivative(state: Array, torque: Array, inputs: Array, car: ReducedCar) -> Array:
    """Time derivative (..., 4) of the state when the motor of the tail's roll gives a torque and the pitch rests.

    Args:
        state: (..., 4) as `STATES`; arrays broadcast over their leading axes, and complex steps pass through.
        torque: of the roll motor, N m, (..., 1).
        inputs: (..., 6) as `INPUTS`.
        car: numbers.
    """
    roll, tail_roll, roll_rate, tail_rate = np.moveaxis(state, -1, 0)
    angle, rate, still = tail_roll[..., None], tail_rate[..., None], np.zeros(1)
    # Both answers are linear in the tail's acceleration, so two of them give the one that the torque makes.
    (held, holding), (moved, moving) = (
        motion(roll, roll_rate, (angle, rate, still + one), inputs, car) for one in (0.0, 1.0)
    )
    tail_acceleration = (torque - holding)[..., 0] / (moving - holding)[..., 0]
    rolling = held + tail_acceleration * (moved - held)
    return np.stack(np.broadcast_arrays(roll_rate, tail_rate, rolling, tail_acceleration), axis=-1)


def linearise(state: Array, torque: Array, inputs: Array, car: ReducedCar) -> tuple[Array, Array]:
    """A = df/dx (..., 4, 4) and B = df/du (..., 4, 1) by complex steps, exact to rounding.

    Args: as `derivative`, real.
    """
    n = len(STATES)
    steps = 1j * COMPLEX_STEP * np.eye(n + 1)
    shape = (n + 1, *([1] * (state.ndim - 1)), -1)
    moved = derivative(state + steps[:, :n].reshape(shape), torque + steps[:, n:].reshape(shape), inputs, car)
    slopes = np.moveaxis(moved.imag / COMPLEX_STEP, 0, -1)
    return slopes[..., :n], slopes[..., n:]


def point_slopes(
    above_wheels: float, s: Array, c: Array, lift: tuple[Array, ...], wheel: tuple[Array, ...], car: ReducedCar
) -> tuple[Vector, Vector]:
    """First and second derivatives with roll of a point (from the outer wheels' centres) on the car's middle."""
    b = car.half_track
    compression, share, slope = lift
    height, first, second = above_wheels - compression, b * (1.0 - share), -b * slope
    return (
        Vector(0.0, -b * s - height * c + first * s, wheel[1] + b * c - height * s - first * c),
        Vector(
            0.0,
            -b * c + height * s + 2 * first * c + second * s,
            wheel[2] - b * s - height * c + 2 * first * s - second * c,
        ),
    )


def _joints(values: Sequence[Any]) -> tuple[Any, Any]:
    """Of roll and pitch; the number 0 for a pitch that is not there."""
    return values[0], values[1] if len(values) == 2 else 0.0


def _tail_axes(s: Array, c: Array, p: Any, q: Any) -> tuple[Vector, Vector, Vector]:
    """Chord, normal of the sail and tail axis of a tail with pitch p and roll q on a car with roll (s, c)."""
    sp, cp, sq, cq = np.sin(p), np.cos(p), np.sin(q), np.cos(q)
    forwards, left, up = Vector(1.0), Vector(0.0, c, s), Vector(0.0, -s, c)
    X, W = cp * forwards - sp * up, sp * forwards + cp * up
    return X, cq * left + sq * W, cq * W - sq * left


def _air(velocity: Vector, w: Vector, X: Vector, N: Vector, e: Vector, car: ReducedCar) -> tuple[Vector, Vector]:
    """Force of the air on the sail and its moment about the joints."""
    k = w.cross(e)
    distance = np.array(car.section_distances)

    def component(axis: Vector) -> Array:
        return np.asarray(velocity.dot(axis))[..., None] + distance * np.asarray(k.dot(axis))[..., None]

    normal, chord = sail_forces(component(N), component(X), car)
    F = normal.sum(-1) * N + chord.sum(-1) * X
    return F, chord @ distance * N - normal @ distance * X


def sail_forces(across: Array, along: Array, car: ReducedCar) -> tuple[Array, Array]:
    """Force of the air on each section along N and along its chord, N (design section 5).

    Args:
        across, along: velocity of the section in the air along N (left, upright) and chord, m/s, (..., sections).
        car: numbers; only a sail that faces the wind drags along its chord.
    """
    mean, half = 0.5 * (car.force_along + car.force_against), 0.5 * (car.force_along - car.force_against)
    coefficient = mean - half * np.tanh(car.normal_side * across / SIDE_BLEND) if half else mean
    speed = np.sqrt(across * across + along * along + 1e-12)
    pressure = -0.5 * car.air_density * np.array(car.section_areas) * speed
    return pressure * coefficient * across, pressure * car.force_chord * along
