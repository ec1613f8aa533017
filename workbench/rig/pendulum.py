"""A rig as a pendulum with one degree of freedom: its motion and its statics in plain floats, for
fits, which ask for them hundreds of times.

inertia x acceleration = weight + air + friction + motor, about the motor axis, positive downstream.
Force law and jet are those of `aerodima.workbench.aero`. `rig_plant` states the same physics as a
Drake plant, with all reactions of a moving rig; a test holds the two together to 1e-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import SpatialInertia

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import LineMotion, SectionLaw, cross
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.car.tail_plant import ADDED_MASS_PARTS
from aerodima.workbench.core.array_types import FloatArray, Pair, Vector3
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.rig.rig_layout import (
    bar_layout,
    pivot_position,
    rig_jet,
    rig_law,
    tail_layout,
)
from aerodima.workbench.rig.rig_model import (
    bar_properties,
    cheetah_tail_properties,
    robot_tail_properties,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario

Torque = Callable[[float, float], float]
"""Function of angle (rad) and rate (rad/s) that returns a torque about the motor axis, N m."""
Motion = Callable[[float, float, float], float]
"""Function of angle (rad), rate (rad/s) and torque of the motor (N m) that returns the
acceleration, rad/s2."""
UPRIGHT_MARGIN = math.radians(0.5)
"""Angle from straight down within which a tail has its lift to the root, on whichever side of 0 an
encoder reads it, rad."""
_UNIT_DRAG = PolarLaw(1.0, 0.0)
"""Law of drag alone, with a coefficient of 1."""
_UNIT_LIFT = PolarLaw(0.0, 1.0, lift_blend=0.0)
"""Law of lift alone, with a coefficient of 1."""


@dataclass(frozen=True)
class AeroStrip:
    """Sections on a straight body of the pendulum.

    Attributes:
        law: force law of a section.
        layout: sections along the body.
        root: distance of the body's origin down the bar from the pivot, m.
        tilt: angle of the body's axis from the bar's, positive downstream, rad.
    """

    law: SectionLaw
    layout: SectionLayout
    root: float = 0.0
    tilt: float = 0.0


@dataclass(frozen=True)
class PendulumModel:
    """Properties of the pendulum that do not change in a swing.

    Attributes:
        mass: mass of all that swings, kg.
        inertia: inertia about the motor axis without added mass, rotor included, kg m2.
        weight_sine, weight_cosine: coefficients of the weight torque = sine x sin(angle) +
            cosine x cos(angle), N m.
        part_distances: distances of the parts that carry the added mass from the pivot, m; empty
            for the bare bar.
        strips: bar and tail in the wind; empty for the bare bar.
        jet: jet of the tunnel.
        wind_speed: speed of the wind in the jet's downstream direction, m/s.
        density: density of the air, kg/m3.
        pivot: position p_WP of the pivot (3), m.
    """

    mass: float
    inertia: float
    weight_sine: float
    weight_cosine: float
    part_distances: tuple[float, ...]
    strips: tuple[AeroStrip, ...]
    jet: Jet
    wind_speed: float
    density: float
    pivot: Vector3

    @classmethod
    def from_scenario(
        cls, scenario: RigScenario, law: SectionLaw | None = None, sections: int | None = None
    ) -> PendulumModel:
        """Makes the pendulum of a rig.

        Args:
            scenario: scenario of the rig.
            law: law of the tail; that of the scenario by default.
            sections: number of sections of the tail; `aero.sections` by default.
        """
        swinging = _swinging_inertia(scenario)
        strips = _strips(scenario, law, sections)
        rotor = scenario.maxon.reflected_inertia
        if scenario.is_robot:
            rotor = scenario.robot_motor.reflected_inertia
        mass = swinging.get_mass()
        _, com_y, com_z = swinging.get_com().tolist()
        weight = scenario.environment.gravity * mass
        part_distances: list[float] = []
        if strips:
            root = strips[-1].root * math.cos(strips[-1].tilt)
            parts = tail_layout(scenario, ADDED_MASS_PARTS)
            part_distances += [root + distance for distance in parts.distances]
        x, y, z = pivot_position(scenario.mount).tolist()
        return cls(
            mass=mass,
            inertia=float(swinging.CalcRotationalInertia().get_moments()[0]) + rotor,
            weight_sine=weight * com_z,
            weight_cosine=weight * com_y,
            part_distances=tuple(part_distances),
            strips=strips,
            jet=rig_jet(scenario),
            wind_speed=scenario.experiment.wind_speed,
            density=scenario.environment.air_density,
            pivot=(x, y, z),
        )

    @property
    def added_arms(self) -> float:
        """Inertia per kilogram of added mass on each part, m2."""
        return sum(distance**2 for distance in self.part_distances)

    @property
    def min_added_mass(self) -> float:
        """Added mass per part that takes away all inertia, kg; the true one lies above it."""
        return -self.inertia / self.added_arms

    def total_inertia(self, mass_per_part: float) -> float:
        """Returns the inertia with added mass, kg m2.

        Raises:
            FitError: the inertia is not above zero; names the least mass that is possible.
        """
        total = self.inertia + mass_per_part * self.added_arms
        if total <= 0.0:
            raise FitError(
                f"an added mass of {mass_per_part:.4g} kg per part takes away more inertia than "
                "there is (M + M_added "
                f"is not positive definite); it must be above {self.min_added_mass:.4g} kg"
            )
        return total

    def weight_torque(self, angle: float) -> float:
        """Returns the torque of the weight about the motor axis at an angle (rad), N m."""
        return self.weight_sine * math.sin(angle) + self.weight_cosine * math.cos(angle)


def _swinging_inertia(scenario: RigScenario) -> SpatialInertia:
    """Returns the inertia of the robot's tail, or of the hanging bar with the tail of the
    experiment, about the pivot, W axes.
    """
    if scenario.is_robot:
        return robot_tail_properties(scenario.robot_tail).about_origin()
    swinging = bar_properties(scenario.bar).about_origin()
    if scenario.has_cheetah_tail:
        tail = scenario.cheetah_tail
        root = scenario.bar.tail_distance + tail.gap
        R_WT = RotationMatrix.MakeXRotation(-scenario.tunnel.misalignment)
        about_root = cheetah_tail_properties(tail).about_origin().ReExpress(R_WT)
        swinging += about_root.Shift(np.array([0.0, 0.0, root]))
    return swinging


def _strips(
    scenario: RigScenario, law: SectionLaw | None, sections: int | None
) -> tuple[AeroStrip, ...]:
    """Returns the strips that the wind meets, the tail last; none on the bare bar."""
    if scenario.experiment.kind == "bar_swing":
        return ()
    if law is None:
        law, _ = rig_law(scenario)
    layout = tail_layout(scenario, sections)
    if scenario.is_robot:
        return (AeroStrip(law, layout),)
    bar = scenario.bar
    root = bar.tail_distance + scenario.cheetah_tail.gap
    tail = AeroStrip(law, layout, root, scenario.tunnel.misalignment)
    return AeroStrip(PolarLaw(bar.drag_coefficient), bar_layout(scenario)), tail


def section_airflow(
    pendulum: PendulumModel, strip: AeroStrip, angle: float, rate: float
) -> tuple[Pair, LineMotion, Sequence[float], Sequence[float]]:
    """Computes how the air meets the sections of a strip at an angle (rad) and a rate (rad/s).

    Returns:
        Root of the strip from the pivot (y, z), m; motion of the strip against the air; distances
        (m) and areas (m2) of its sections in the jet, areas 0 without exposure.
    """
    bar_sine = math.sin(angle)
    bar_cosine = math.cos(angle)
    sine = math.sin(angle + strip.tilt)
    cosine = math.cos(angle + strip.tilt)
    root = strip.root
    y = -root * bar_sine
    z = -root * bar_cosine
    wind_x, wind_y, _ = pendulum.jet.downstream_W
    wind_speed = pendulum.wind_speed
    u_x = wind_speed * wind_x
    u_y = wind_speed * wind_y + rate * root * bar_cosine
    u_z = -rate * root * bar_sine
    change = (0.0, rate * cosine, -rate * sine)
    axis = (0.0, -sine, -cosine)
    normal = (0.0, cosine, -sine)
    line = LineMotion((u_x, u_y, u_z), change, axis, normal)
    pivot_x, pivot_y, pivot_z = pendulum.pivot
    p_WRo = (pivot_x, pivot_y + y, pivot_z + z)
    distances, areas = pendulum.jet.exposed_sections(strip.layout, p_WRo, axis)
    return (y, z), line, distances, areas


def strip_load(
    pendulum: PendulumModel, strip: AeroStrip, angle: float, rate: float
) -> tuple[float, ...]:
    """Returns the air's force on a strip (3), N, and its moment about the pivot (3), N m, in W."""
    (y, z), line, distances, areas = section_airflow(pendulum, strip, angle, rate)
    if areas[0] == 0.0:
        return (0.0,) * 6
    f_x, f_y, f_z, m_x, m_y, m_z = strip.law.line_force(line, distances, areas, pendulum.density)
    return f_x, f_y, f_z, m_x + y * f_z - z * f_y, m_y + z * f_x, m_z - y * f_x


def air_torque(scenario: RigScenario, law: SectionLaw | None = None) -> Torque | None:
    """Returns the torque of the air on tail and bar; None for the bare bar.

    Args:
        law: law of the tail; that of the scenario by default.
    """
    pendulum = PendulumModel.from_scenario(scenario, law)
    strips = pendulum.strips
    if not strips:
        return None

    def torque(angle: float, rate: float) -> float:
        return -sum(strip_load(pendulum, strip, angle, rate)[3] for strip in strips)

    return torque


def friction_torque(coulomb: float, viscous: float, tanh_gain: float) -> Torque:
    """Returns `joint_friction` as a function of angle and rate."""
    return lambda angle, rate: joint_friction(rate, coulomb, viscous, tanh_gain)


def known_friction(scenario: RigScenario) -> Torque:
    """Returns the friction that the scenario states for its bar, or its robot's tail."""
    known = scenario.joint_friction
    return friction_torque(known.coulomb, known.viscous, known.tanh_gain)


def equation_of_motion(
    pendulum: PendulumModel, torques: Sequence[Torque], added_mass: float = 0.0
) -> Motion:
    """Returns the acceleration under weight, some torques and the motor, as a function.

    Args:
        pendulum: pendulum that moves.
        torques: torques of air, friction and a motor that reacts to the state.
        added_mass: added mass of each part, kg.

    Raises:
        FitError: the inertia is not above zero.
    """
    inverse = 1.0 / pendulum.total_inertia(added_mass)

    def acceleration(angle: float, rate: float, motor: float) -> float:
        total = pendulum.weight_torque(angle) + motor
        for torque in torques:
            total += torque(angle, rate)
        return total * inverse

    return acceleration


@dataclass(frozen=True)
class StaticBalance:
    """A held rig with a cheetah tail: the loads of weight and wind on its support.

    Attributes:
        scenario: scenario with masses, places and air.
        pendulum: pendulum with three strips of one section each, since a steady wind is the same
            all along: the bar, and the tail with a unit of drag and with a unit of lift.
    """

    scenario: RigScenario
    pendulum: PendulumModel

    @classmethod
    def from_scenario(cls, scenario: RigScenario) -> StaticBalance:
        """Makes the balance of a scenario; FitError without a cheetah tail."""
        if not scenario.has_cheetah_tail:
            raise FitError(
                f"static fit: experiment {scenario.experiment.kind!r} has no cheetah tail on the "
                "rig"
            )
        pendulum = PendulumModel.from_scenario(scenario, _UNIT_DRAG, sections=1)
        bar, drag = pendulum.strips
        return cls(scenario, replace(pendulum, strips=(bar, drag, replace(drag, law=_UNIT_LIFT))))

    def hanging(self, angle: float) -> tuple[FloatArray, float]:
        """Returns reactions (6: N, N m) and the torque about the motor axis (positive downstream,
        N m) of the weight alone.
        """
        torque = self.pendulum.weight_torque(angle)
        x, y, _ = self.pendulum.pivot
        mount = self.scenario.mount
        gravity = self.scenario.environment.gravity
        swinging = gravity * self.pendulum.mass
        standing = gravity * mount.mass
        about_x = standing * mount.com_y + swinging * y + torque
        about_y = -standing * mount.com_x - swinging * x
        return np.array([0.0, 0.0, standing + swinging, about_x, about_y, 0.0]), torque

    def wind_effect(self, angle: float, wind_speed: float, psi: float) -> FloatArray:
        """Computes the loads that the wind adds: rows bar, unit C_D and unit C_L of the tail;
        columns reactions (6) and axis torque.

        Args:
            angle: angle of the rig, rad; a tail that hangs within half a degree of straight down
                has its lift to the root.
            wind_speed: speed of the wind, m/s.
            psi: direction of the wind, rad.
        """
        pendulum = replace(self.pendulum, jet=rig_jet(self.scenario, psi), wind_speed=wind_speed)
        rows = []
        for strip in pendulum.strips:
            load = strip_load(pendulum, strip, angle, 0.0)
            force, about_pivot = np.split(np.array(load), 2)
            about_origin = about_pivot + cross(pendulum.pivot, load[:3])
            rows.append([*force, *about_origin, about_pivot[0]])
        effect = -np.array(rows)
        misalignment = self.scenario.tunnel.misalignment
        if -UPRIGHT_MARGIN < angle < 0.0 <= misalignment and angle + misalignment < 0.0:
            effect[2] *= -1.0
        return effect

    def exposed_length(self, angle: float) -> float:
        """Measures how much of the tail is in the jet that blows straight to -y, m."""
        pendulum = replace(self.pendulum, jet=rig_jet(self.scenario, 0.0))
        tail = pendulum.strips[-1]
        _, _, _, areas = section_airflow(pendulum, tail, angle, 0.0)
        return areas[0] / tail.layout.chord

    def holding_current(
        self, angle: float, wind_speed: float, cd: float, cl: float, psi: float
    ) -> float:
        """Returns the current that holds the tail still, A."""
        wind = float(np.array([1.0, cd, cl]) @ self.wind_effect(angle, wind_speed, psi)[:, 6])
        return (self.pendulum.weight_torque(angle) + wind) / self.scenario.maxon.torque_constant
