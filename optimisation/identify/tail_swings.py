"""Swings of the robot's tail in the tunnel (thesis section 6.3) for thousands of possible tails at once.

The same pendulum as `pendulum`, over arrays: weight, MIT motor, friction and a sail cut by the jet. A test compares
it with the rig's diagram. Signs as there: angle 0 hanging, positive downstream; rates positive downstream.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import SimpleNamespace

import numpy as np

from aerodima.optimisation.identify.pendulum import runge_kutta_step
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import RigScenario
from aerodima.workbench.plants.joint_friction import smooth_friction
from aerodima.workbench.plants.rig_model import robot_tail_properties

Tails = Mapping[str, FloatArray]
"""Column -> value per tail: the keys of `models/identification/tail_size.yaml`, and `law`.

`law` is 1 where the force goes with cos(gamma) |v|^2 (eq. 6.8), 0 for the normal-force law (cos^2).
"""
STEP, LENGTH = 0.004, 1.2
"""Of the rollout, s: the classical Runge-Kutta method; the first rebound is over by then."""
_HALVINGS = 40


@dataclass(frozen=True)
class SwingExtremes:
    """What the published tables bound, per tail (n).

    Attributes:
        highest, lowest: relative speed at the middle of the sail during the swing (eqs. 6.3-6.5), m/s.
        rest: angle where the motor holds the tail against wind and weight, without friction, rad.
        peak_rate: fastest upstream rate, rad/s.
    """

    highest: FloatArray
    lowest: FloatArray
    rest: FloatArray
    peak_rate: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[SwingExtremes]) -> SwingExtremes:
        """Those of several batches of tails, one behind the other."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def lever(tails: Tails) -> FloatArray:
    """L_cor: from the motor axis to the middle of the sail, m."""
    return np.asarray(tails["length"] - 0.5 * tails["sail_length"])


def cover(tails: Tails, angle: FloatArray | float, slope: float) -> FloatArray:
    """Part of the sail inside the jet at an angle (rad), 0 to 1."""
    edge = tails["jet_edge_depth"] / (np.cos(angle) + slope * np.sin(angle))
    return np.asarray(np.clip((tails["length"] - edge) / tails["sail_length"], 0.0, 1.0))


def inertia_and_weight(tails: Tails, scenario: RigScenario) -> tuple[FloatArray, FloatArray]:
    """Inertia about the motor axis with the rotor (kg m2), and weight torque of the horizontal tail (N m)."""
    names = ("length", "mass", "sail_mass_fraction", "sail_length")
    tail = SimpleNamespace(**{name: tails[name] for name in names}, sail_width=0.0)
    properties = robot_tail_properties(tail)  # type: ignore[arg-type]
    centre = -properties.com[2]
    own = properties.inertia[0] + tails["mass"] * centre**2
    rotor = tails["rotor_inertia"] * scenario.robot_motor.gear_ratio**2
    return np.asarray(own * tails["inertia_factor"] + rotor), tails["mass"] * scenario.environment.gravity * centre


def air_torque(
    tails: Tails, wind: FloatArray | float, scenario: RigScenario, q: FloatArray, w: FloatArray
) -> FloatArray:
    """Torque of the air about the motor axis (n), N m, positive downstream."""
    s, c = np.sin(q), np.cos(q)
    edge = tails["jet_edge_depth"] / (c + scenario.tunnel.jet_slope * s)
    start = np.maximum(tails["length"] - tails["sail_length"], edge)
    number = scenario.aero.sections
    part = np.maximum(tails["length"] - start, 0.0) / number
    along = np.where(tails["law"] > 0.5, wind * s, 0.0) ** 2
    total = np.zeros_like(q)
    for i in range(number):
        arm = start + (i + 0.5) * part
        v = wind * c - arm * w
        total += arm * np.sqrt(v * v + along) * v
    chord = tails["area"] / tails["sail_length"]
    result: FloatArray = 0.5 * scenario.environment.air_density * scenario.aero.normal_force * chord * part * total
    return result


def swing_extremes(tails: Tails, wind: FloatArray | float, kp: float, scenario: RigScenario) -> SwingExtremes:
    """Rolls the swings from the start angle to 0 out.

    Args:
        tails: n tails.
        wind: m/s, one for all or one per tail (n).
        kp: as printed, N m/rad; `kp_factor` of the tails multiplies it.
        scenario: everything that is the same for all tails.
    """
    inertia, weight = inertia_and_weight(tails, scenario)
    kp_n, limit, gain = kp * tails["kp_factor"], scenario.robot_motor.torque_limit, scenario.robot_friction.tanh_gain
    friction = smooth_friction(tails["coulomb"], tails["viscous"], gain, tanh=np.tanh)
    arm = lever(tails)

    def acceleration(q: FloatArray, w: FloatArray, _drive: float) -> FloatArray:
        motor = np.clip(-kp_n * q - tails["kd"] * w, -limit, limit)
        air = air_torque(tails, wind, scenario, q, w)
        result: FloatArray = (motor + friction(w) - weight * np.sin(q) + air) / inertia
        return result

    q, w = tails["start_angle"].copy(), np.zeros_like(inertia)
    highest, lowest, fastest = np.full_like(w, wind), np.full_like(w, wind), np.zeros_like(w)
    for _ in range(math.ceil(LENGTH / STEP)):
        q, w = runge_kutta_step(acceleration, q, w, STEP)
        tail_speed = -arm * w
        speed = np.hypot(wind + tail_speed * np.cos(q), tail_speed * np.sin(q))
        np.maximum(highest, speed, out=highest)
        np.minimum(lowest, speed, out=lowest)
        np.maximum(fastest, -w, out=fastest)
    return SwingExtremes(highest, lowest, _rest(tails, wind, kp_n, weight, scenario), fastest)


def _rest(
    tails: Tails, wind: FloatArray | float, kp: FloatArray, weight: FloatArray, scenario: RigScenario
) -> FloatArray:
    """Where motor and weight hold the wind: one angle, since theirs grows and the wind's falls from 0 on."""
    low, high = np.zeros_like(kp), np.full_like(kp, 0.5 * math.pi)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        downstream = air_torque(tails, wind, scenario, middle, np.zeros_like(kp)) > kp * middle + weight * np.sin(
            middle
        )
        low, high = np.where(downstream, middle, low), np.where(downstream, high, middle)
    return 0.5 * (low + high)
