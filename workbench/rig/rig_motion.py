"""The rig as the pendulum that it is, in plain floats: for fits, which ask for it hundreds of
times.

J angle'' = weight + air + friction + motor, with the force law and the jet of
`aerodima.workbench.aero`. It equals the motion of `aerodima.workbench.rig.rig_plant` to rounding (a
test holds the two together). `dataclasses.replace` varies friction, laws, added mass;
`aerodima.optimisation.identify.pendulum` rolls swings out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from aerodima.workbench.aero.coefficient_files import PolarTable, load_coefficients
from aerodima.workbench.aero.laws import LineMotion, NormalForceLaw, SectionLaw
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.car.tail_plant import ADDED_MASS_PARTS, FrictionLaw, smooth_friction
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.sdf_model import Inertial
from aerodima.workbench.rig.rig_layout import bar_layout, pivot_position, tail_layout
from aerodima.workbench.rig.rig_model import (
    bar_properties,
    cheetah_tail_properties,
    robot_tail_properties,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario


def rig_jet(scenario: RigScenario) -> Jet:
    """The tunnel's jet as the rig of a scenario stands in it."""
    tunnel = scenario.tunnel
    return Jet.below_pivot(
        pivot_position(scenario.mount),
        tunnel.jet_edge_depth,
        psi=tunnel.psi3,
        slope=tunnel.jet_slope,
    )


def rig_law(scenario: RigScenario) -> tuple[SectionLaw, float | None]:
    """Force law of the tail under test, and the relative speed (m/s) up to which it was shown to
    hold.
    """
    aero = scenario.aero
    experiment = scenario.experiment
    if aero.source == "constant":
        if scenario.is_robot:
            return NormalForceLaw(aero.normal_force), None
        return PolarLaw(aero.drag, aero.lift, lift_blend=aero.lift_blend), None
    if scenario.is_robot:
        name = "robot_tail_line"
    else:
        name = f"cheetah_tail_{experiment.tail}_{experiment.axis}"
    return _measured_law(name, aero.lift_blend)


@cache
def _measured_law(name: str, lift_blend: float) -> tuple[SectionLaw, float | None]:
    """Kept: a fit that varies constants of the rig builds its motion hundreds of times."""
    found = load_coefficients(name)
    if name == "robot_tail_line":
        return found.law(), found.quasi_steady_limit
    assert isinstance(found, PolarTable)
    return PolarLaw(
        found.table("cd"), found.table("cl"), lift_blend=lift_blend
    ), found.quasi_steady_limit


@dataclass(frozen=True)
class SwingingMass:
    """A body that swings: mass kg, centre of mass about the pivot (m, and rad from the bar), own
    inertia kg m2.
    """

    mass: float
    radius: float
    phase: float
    inertia: float


@dataclass(frozen=True)
class Blade:
    """Sections on a straight body: their law, their places along it, its origin below the pivot
    (m), its tilt (rad).
    """

    law: SectionLaw
    layout: SectionLayout
    root: float
    tilt: float


@dataclass(frozen=True)
class RigMotion:
    """Everything that decides how a rig swings.

    Attributes:
        bodies: that swing.
        rotor: reflected inertia about the motor axis, kg m2.
        added_mass: of each part, kg.
        added_distances: of the parts from the pivot along the axis of the tail, m; empty for the
            bare bar.
        friction: rate to torque.
        blades: tail and bar in the wind.
        jet: of the tunnel.
        wind_speed: in its downstream direction, m/s.
        density: of the air, kg/m3.
        gravity: m/s2.
        pivot: p_WP (3), m.
    """

    bodies: tuple[SwingingMass, ...]
    rotor: float
    added_mass: float
    added_distances: tuple[float, ...]
    friction: FrictionLaw
    blades: tuple[Blade, ...]
    jet: Jet
    wind_speed: float
    density: float
    gravity: float
    pivot: tuple[float, float, float]

    @classmethod
    def of(cls, scenario: RigScenario) -> RigMotion:
        """The motion of the rig of a scenario."""
        robot = scenario.is_robot
        friction = scenario.robot_friction if robot else scenario.friction
        motor = scenario.robot_motor
        bodies, blades = _parts(scenario)
        x, y, z = pivot_position(scenario.mount).tolist()
        if robot:
            rotor = motor.rotor_inertia * motor.gear_ratio**2
        else:
            rotor = scenario.maxon.reflected_inertia
        added_mass = 0.0
        added_distances = []
        if blades:
            tail = blades[-1]
            added_mass = scenario.aero.added_mass
            for distance in tail_layout(scenario, ADDED_MASS_PARTS).distances:
                added_distances.append(tail.root * math.cos(tail.tilt) + distance)
        return cls(
            bodies=bodies,
            rotor=rotor,
            added_mass=added_mass,
            added_distances=tuple(added_distances),
            friction=smooth_friction(friction.coulomb, friction.viscous, friction.tanh_gain),
            blades=blades,
            jet=rig_jet(scenario),
            wind_speed=scenario.experiment.wind_speed,
            density=scenario.environment.air_density,
            gravity=scenario.environment.gravity,
            pivot=(x, y, z),
        )

    @property
    def inertia(self) -> float:
        """About the motor axis, with rotor and added mass, kg m2; UserError when the added mass
        leaves none.
        """
        own = sum(body.inertia + body.mass * body.radius**2 for body in self.bodies) + self.rotor
        squares = sum(s * s for s in self.added_distances)
        total = own + self.added_mass * squares
        if not total > 0.0:
            raise UserError(
                f"added_mass: {self.added_mass:g} kg per part; allowed on this rig: above "
                f"{-own / squares:.4g} kg"
            )
        return total

    def air(self, angle: float, rate: float) -> tuple[float, ...]:
        """Force of the air on what swings and its moment about the pivot (6), W axes, N and N m."""
        x = y = z = mx = my = mz = 0.0
        for blade in self.blades:
            (ry, rz), line, distances, areas = self._met(blade, angle, rate)
            if areas[0] == 0.0:
                continue
            fx, fy, fz, tx, ty, tz = blade.law.line_force(line, distances, areas, self.density)
            x = x + fx
            y = y + fy
            z = z + fz
            mx = mx + tx + ry * fz - rz * fy
            my = my + ty + rz * fx
            mz = mz + tz - ry * fx
        return x, y, z, mx, my, mz

    def _met(self, blade: Blade, angle: float, rate: float) -> tuple[Any, ...]:
        """Root of a blade from the pivot (y, z), its motion against the air, distances and areas of
        its sections.
        """
        s = math.sin(angle)
        c = math.cos(angle)
        st = math.sin(angle + blade.tilt)
        ct = math.cos(angle + blade.tilt)
        root = blade.root
        (px, py, pz) = self.pivot
        (wx, wy, _) = self.jet.downstream_W
        a = (0.0, -st, -ct)
        arm = (-root * s, -root * c)
        u = (self.wind_speed * wx, self.wind_speed * wy + rate * root * c, -rate * root * s)
        met = self.jet.exposed_sections(blade.layout, (px, py + arm[0], pz + arm[1]), a)
        return arm, LineMotion(u, (0.0, rate * ct, -rate * st), a, (0.0, ct, -st)), *met

    def load(self, angle: float, rate: float) -> float:
        """Torque of weight, air and friction along the joint axis, N m."""
        weight = sum(body.mass * body.radius * math.sin(angle + body.phase) for body in self.bodies)
        return -self.gravity * weight - self.air(angle, rate)[3] + self.friction(rate)

    def acceleration(self, angle: float, rate: float, torque: float) -> float:
        """Acceleration of the angle, rad/s2, at a motor torque (N m)."""
        return (self.load(angle, rate) + torque) / self.inertia


def _parts(scenario: RigScenario) -> tuple[tuple[SwingingMass, ...], tuple[Blade, ...]]:
    """What swings, and what of it the wind meets; the tail is the last of both."""
    law, _ = rig_law(scenario)
    if scenario.is_robot:
        arm = _swinging(robot_tail_properties(scenario.robot_tail), 0.0, 0.0)
        return (arm,), (Blade(law, tail_layout(scenario), 0.0, 0.0),)
    bar = scenario.bar
    hanging = _swinging(bar_properties(bar), 0.0, 0.0)
    if not scenario.has_cheetah_tail:
        return (hanging,), ()
    root = bar.tail_distance + scenario.cheetah_tail.gap
    misalignment = scenario.tunnel.misalignment
    tail = _swinging(cheetah_tail_properties(scenario.cheetah_tail), root, misalignment)
    return (hanging, tail), (
        Blade(PolarLaw(bar.drag_coefficient), bar_layout(scenario), 0.0, 0.0),
        Blade(law, tail_layout(scenario), root, misalignment),
    )


def _swinging(properties: Inertial, root: float, tilt: float) -> SwingingMass:
    """A body with its origin `root` below the pivot along the bar and its axis tilted from it."""
    beyond = -properties.com[2]
    along = root + beyond * math.cos(tilt)
    across = beyond * math.sin(tilt)
    return SwingingMass(
        properties.mass, math.hypot(along, across), math.atan2(across, along), properties.moments[0]
    )
