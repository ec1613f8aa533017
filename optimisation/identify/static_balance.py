"""The held rig in the wind as a formula: six reactions and the axis torque, linear in C_D, C_L and the current.

The tail hangs from the bar at `angle` in a steady wind that blows towards -y, turned by psi3 about z (design section
4). All of the exposed tail sees the same relative wind, so one section at the middle of the exposed length carries
the force of any number of equal sections. Force law and jet are those of `aerodima.workbench.aero`; a test compares
with the rig's plant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import cos, sin

from aerodima.workbench.aero.jet import Jet
from aerodima.workbench.aero.laws import float_of
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.config.scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.plants.rig_model import bar_layout, pivot_position, tail_layout

Vector3 = tuple[float, float, float]
REACTIONS = ("fx", "fy", "fz", "tx", "ty", "tz")
UPRIGHT_MARGIN = math.radians(0.5)
"""A tail that hangs straight within this has its lift to the root, on whichever side of 0 an encoder reads it."""

_DRAG = PolarLaw(1.0, 0.0)
_LIFT = PolarLaw(0.0, 1.0, lift_blend=0.0)


@dataclass(frozen=True)
class StaticBalance:
    """Masses, places and air of a held rig; everything in W or along the bar, m and kg.

    Attributes:
        pivot: p_WP (3).
        mount_mass, mount_com: kg, and p in W (3).
        bar_mass, bar_com: kg, and distance from the pivot.
        tail_distance: from the pivot to the end of the bar.
        tail_mass, tail_com, gap: kg, centre of mass beyond the root, root beyond the bar's end.
        misalignment: of the tail's axis against the bar's, rad, positive downstream.
        tail, bar: sections, each in its own frame with the axis hanging down.
        bar_drag: C_D of the bar.
        jet_edge_depth, jet_slope: of the jet below the pivot.
        torque_constant: of the motor at the bar, N m/A.
        creep_resistance: torque per speed at rest, N m s/rad: viscous friction + tanh gain x Coulomb friction.
        density, gravity: kg/m3, m/s2.
    """

    pivot: tuple[float, float, float]
    mount_mass: float
    mount_com: tuple[float, float, float]
    bar_mass: float
    bar_com: float
    tail_distance: float
    tail_mass: float
    tail_com: float
    gap: float
    misalignment: float
    tail: SectionLayout
    bar: SectionLayout
    bar_drag: float
    jet_edge_depth: float
    jet_slope: float
    torque_constant: float
    creep_resistance: float
    density: float
    gravity: float

    @classmethod
    def of(cls, scenario: RigScenario) -> StaticBalance:
        """The balance of a scenario with a cheetah tail."""
        if not scenario.has_cheetah_tail:
            raise FitError(f"static fit: experiment {scenario.experiment.kind!r} has no cheetah tail on the rig")
        tail, friction, mount = scenario.cheetah_tail, scenario.friction, scenario.mount
        x, y, z = (float(value) for value in pivot_position(mount))
        return cls(
            pivot=(x, y, z),
            mount_mass=mount.mass,
            mount_com=(mount.com_x, mount.com_y, mount.com_z),
            bar_mass=scenario.bar.mass,
            bar_com=scenario.bar.com_distance,
            tail_distance=scenario.bar.tail_distance,
            tail_mass=tail.mass,
            tail_com=tail.com_distance,
            gap=tail.gap,
            misalignment=scenario.tunnel.misalignment,
            tail=tail_layout(scenario),
            bar=bar_layout(scenario),
            bar_drag=scenario.bar.drag_coefficient,
            jet_edge_depth=scenario.tunnel.jet_edge_depth,
            jet_slope=scenario.tunnel.jet_slope,
            torque_constant=scenario.maxon.torque_constant,
            creep_resistance=friction.viscous + friction.tanh_gain * friction.coulomb,
            density=scenario.environment.air_density,
            gravity=scenario.environment.gravity,
        )

    def hanging(self, angle: float) -> tuple[np.ndarray, float]:
        """Reactions (6: N, N m) and the torque about the motor axis (positive downstream, N m) of the weight alone."""
        a = np.array(hanging_axis(angle))
        root = (self.tail_distance + self.gap) * a
        pivot = np.asarray(self.pivot)
        bodies = [
            (self.mount_mass, np.asarray(self.mount_com)),
            (self.bar_mass, pivot + self.bar_com * a),
            (self.tail_mass, pivot + root + self.tail_com * np.array(hanging_axis(angle + self.misalignment))),
        ]
        mass = sum(m for m, _ in bodies)
        first = np.sum([m * p for m, p in bodies], axis=0)
        g = self.gravity
        swinging = sum(m * (p[1] - pivot[1]) for m, p in bodies[1:])
        return np.array([0.0, 0.0, mass * g, g * first[1], -g * first[0], 0.0]), float(g * swinging)

    def wind_effect(self, angle: float, wind_speed: float, psi: Any) -> list[list[Any]]:
        """What the wind adds: rows bar, unit C_D and unit C_L of the tail; columns reactions (6) and axis torque.

        Args:
            angle: rad; a tail that hangs within half a degree of straight down has its lift to the root.
            wind_speed: m/s.
            psi: rad, float or AutoDiffXd.
        """
        s, c = (math.sin(psi), math.cos(psi)) if isinstance(psi, float) else (sin(psi), cos(psi))
        wind = (wind_speed * s, -wind_speed * c, 0.0 * s)
        jet = Jet.below_pivot(self.pivot, self.jet_edge_depth, float_of(psi), self.jet_slope)
        a, b = hanging_axis(angle), hanging_axis(angle + self.misalignment)
        bar = self._forces((_DRAG,), self.bar, 0.0, a, a, wind, jet)[0]
        tail = self._forces((_DRAG, _LIFT), self.tail, self.tail_distance + self.gap, a, b, wind, jet)
        if -UPRIGHT_MARGIN < angle < 0.0 <= self.misalignment and angle + self.misalignment < 0.0:
            tail[1] = [-value for value in tail[1]]
        return [[self.bar_drag * value for value in bar], *tail]

    def _forces(
        self, laws: Sequence[PolarLaw], layout: SectionLayout, root: float, a: Vector3, b: Vector3, wind: Any, jet: Jet
    ) -> list[list[Any]]:
        """Rows of reactions and axis torque per law, for sections along b that begin at the distance `root` along a."""
        p_WR = tuple(p + root * d for p, d in zip(self.pivot, a, strict=True))
        interval = jet.exposed_interval(layout, p_WR, b)
        if interval is None:
            return [[0.0 * wind[2]] * 7] * len(laws)
        area, middle = (interval[1] - interval[0]) * layout.chord, 0.5 * (interval[0] + interval[1])
        x, y, z = (p + middle * d for p, d in zip(p_WR, b, strict=True))
        arm_y, arm_z = y - self.pivot[1], z - self.pivot[2]
        rows = []
        for law in laws:
            f, g, h = law.section_force(wind, b, layout.normal_B, area, self.density)
            moment = (z * g - y * h, x * h - z * f, y * f - x * g)
            rows.append([-f, -g, -h, *moment, arm_z * g - arm_y * h])
        return rows

    def exposed_length(self, angle: float, psi: float = 0.0) -> float:
        """How much of the tail is in the jet, m."""
        jet = Jet.below_pivot(self.pivot, self.jet_edge_depth, psi, self.jet_slope)
        root = np.asarray(self.pivot) + (self.tail_distance + self.gap) * np.array(hanging_axis(angle))
        interval = jet.exposed_interval(self.tail, root.tolist(), hanging_axis(angle + self.misalignment))
        return 0.0 if interval is None else float(interval[1] - interval[0])

    def holding_current(self, angle: float, wind_speed: float, cd: float, cl: float, psi: float) -> float:
        """The current that holds the tail still, A."""
        effect = np.array(self.wind_effect(angle, wind_speed, float(psi)))
        torque = self.hanging(angle)[1] + float(np.array([1.0, cd, cl]) @ effect[:, 6])
        return torque / self.torque_constant


def hanging_axis(angle: float) -> Vector3:
    """Unit vector from the pivot to the tip in W (3): down at 0, downstream (-y) at 90 degrees."""
    return (0.0, -math.sin(angle), -math.cos(angle))
