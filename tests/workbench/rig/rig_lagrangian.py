"""The bare rig derived by Lagrange's method with SymPy: an oracle that shares nothing with the
plant.

The support is let go: it may move by (x, y, z) and turn by (a, b, c) about the sensor point W. The
force sensor is the constraint that holds all six at zero, so its wrench is the six generalised
forces of Lagrange's equations there. The motor's torque acts between mount and bar: on the angle
alone.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import sympy as sp

# Thesis Tables 4.2, 4.5 and 4.6, in SI, typed here again so that the model files are checked too.
GRAVITY = 9.81
MOUNT_MASS, MOUNT_COM = 1.189, np.array([-0.00569, -0.00011, 0.03149])
PIVOT = MOUNT_COM + np.array([0.10145, 0.0, 0.13989])
BAR_MASS, BAR_DISTANCE, BAR_INERTIA = 0.313, 0.100, 1.9198e-3
ROTOR = 6.731e-3
TAILS = {
    1: (0.0982, 0.390, 0.270 + 0.163),
    2: (0.0975, 0.365, 0.295 + 0.181),
    3: (0.0937, 0.365, 0.295 + 0.182),
}
"""Mass, length, distance of the centre of mass from the motor axis."""
ROOTS = {1: 0.270, 2: 0.295, 3: 0.295}
"""Distance of the tail's root, where the misalignment angle bends it, from the motor axis."""

Motion = Callable[..., tuple[float, ...]]


def derived(tail, angle, rate, torque, misalignment=0.0):
    """Acceleration of the angle (rad/s2) and the support's wrench at W (6): force (N) and moment (N
    m).
    """
    mass, length, distance = TAILS[tail]
    root = ROOTS[tail]
    numbers = (mass, mass * length**2 / 12, root, distance - root)
    acceleration, *wrench = _equations()(angle, rate, torque, misalignment, *numbers)
    return float(acceleration), np.array(wrench, float)


@cache
def _equations():
    """Acceleration and wrench as a function of (angle, rate, torque, misalignment, the four numbers
    of the tail).
    """
    q, w, torque, misalignment = sp.symbols("q w torque misalignment")
    mass, inertia, root, beyond = sp.symbols("mass inertia root beyond")
    support = sp.symbols("x y z a b c")
    speeds = sp.symbols("vx vy vz va vb vc")
    shift = sp.Matrix(support[:3])
    (a, b, c) = support[3:]
    # First order is all that the equations need where the support is held.
    turn = sp.eye(3) + sp.Matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])

    def rate_of(vector):
        return vector.jacobian([*support, q]) * sp.Matrix([*speeds, w])

    def along(phase):
        """Hanging straight down at zero, downstream (-y) with a growing angle; turned with the
        support.
        """
        return turn * sp.Matrix([0, -sp.sin(q + phase), -sp.cos(q + phase)])

    pivot = shift + turn * sp.Matrix([sp.Float(v, 17) for v in PIVOT])
    bar = along(sp.Integer(0))
    bent = along(misalignment)
    bodies = [
        (MOUNT_MASS, shift + turn * sp.Matrix([sp.Float(v, 17) for v in MOUNT_COM]), None, 0),
        (BAR_MASS, pivot + BAR_DISTANCE * bar, bar, BAR_INERTIA),
        (mass, pivot + root * bar + beyond * bent, bent, inertia),
    ]
    # The mount's own inertia does not matter, since it is held. Bar and tail are slender: their
    # turning has the kinetic energy I |d axis / dt|^2 / 2. The rotor's inertia, reflected through
    # its gear, goes with the angle alone.
    lagrangian = ROTOR * w**2 / 2
    for m, place, axis, own in bodies:
        lagrangian += m * rate_of(place).dot(rate_of(place)) / 2 - m * GRAVITY * place[2]
        if axis is not None:
            lagrangian += own * rate_of(axis).dot(rate_of(axis)) / 2

    held = dict.fromkeys([*support, *speeds], 0)
    acceleration = sp.Symbol("acceleration")

    def generalised_force(coordinate, speed):
        """D/dt (dL/dspeed) - dL/dcoordinate with the support held: only the angle moves."""
        momentum = lagrangian.diff(speed)
        change = momentum.diff(q) * w + momentum.diff(w) * acceleration
        return (change - lagrangian.diff(coordinate)).subs(held)

    own_equation = generalised_force(q, w)
    coefficient = own_equation.diff(acceleration)
    solved = (torque - own_equation.subs(acceleration, 0)) / coefficient
    wrench = [
        generalised_force(s, v).subs(acceleration, solved)
        for s, v in zip(support, speeds, strict=True)
    ]
    symbols = (q, w, torque, misalignment, mass, inertia, root, beyond)
    return sp.lambdify(symbols, (solved, *wrench), modules="math", cse=True)
