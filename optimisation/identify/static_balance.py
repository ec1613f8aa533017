"""A held rig: what weight and wind do to its support and its motor; algebraic, not simulated (thesis section 4.8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.plants.rig_layout import bar_layout, pivot_position, tail_layout

Vector3 = tuple[float, float, float]
REACTIONS = ("fx", "fy", "fz", "tx", "ty", "tz")
UPRIGHT_MARGIN = math.radians(0.5)
"""A tail that hangs straight within this has its lift to the root, on whichever side of 0 an encoder reads it."""

_DRAG = PolarLaw(1.0, 0.0)
_LIFT = PolarLaw(0.0, 1.0, lift_blend=0.0)


@dataclass(frozen=True)
class StaticBalance:
    """A held rig.

    Attributes:
        scenario: masses, places, air.
        pivot: p_WP (3), m.
        tail, bar: sections, each in its own frame with the axis hanging down.
    """

    scenario: RigScenario
    pivot: Vector3
    tail: SectionLayout
    bar: SectionLayout

    @classmethod
    def of(cls, scenario: RigScenario) -> StaticBalance:
        """The balance of a scenario with a cheetah tail."""
        if not scenario.has_cheetah_tail:
            raise FitError(f"static fit: experiment {scenario.experiment.kind!r} has no cheetah tail on the rig")
        x, y, z = pivot_position(scenario.mount).tolist()
        return cls(scenario, (x, y, z), tail_layout(scenario), bar_layout(scenario))

    @property
    def torque_constant(self) -> float:
        """Of the motor at the bar, N m/A."""
        return self.scenario.maxon.torque_constant

    @property
    def creep_resistance(self) -> float:
        """Torque per speed at rest, N m s/rad: viscous friction + tanh gain x Coulomb friction."""
        friction = self.scenario.friction
        return friction.viscous + friction.tanh_gain * friction.coulomb

    @property
    def root_distance(self) -> float:
        """From the pivot to the root of the tail, m."""
        return self.scenario.bar.tail_distance + self.scenario.cheetah_tail.gap

    def tail_axis(self, angle: float) -> Vector3:
        """Unit vector from root to tip in W (3): that of the bar and the misalignment."""
        return hanging_axis(angle + self.scenario.tunnel.misalignment)

    def jet(self, psi: float) -> Jet:
        """The jet below the pivot, turned by psi (rad) about z."""
        tunnel = self.scenario.tunnel
        return Jet.below_pivot(self.pivot, tunnel.jet_edge_depth, psi, tunnel.jet_slope)

    def hanging(self, angle: float) -> tuple[np.ndarray, float]:
        """Reactions (6: N, N m) and the torque about the motor axis (positive downstream, N m) of the weight alone."""
        a = np.array(hanging_axis(angle))
        root, pivot = self.root_distance * a, np.asarray(self.pivot)
        mount, bar, tail = self.scenario.mount, self.scenario.bar, self.scenario.cheetah_tail
        bodies = [
            (mount.mass, np.array([mount.com_x, mount.com_y, mount.com_z])),
            (bar.mass, pivot + bar.com_distance * a),
            (tail.mass, pivot + root + tail.com_distance * np.array(self.tail_axis(angle))),
        ]
        mass = sum(m for m, _ in bodies)
        first = np.sum([m * p for m, p in bodies], axis=0)
        g = self.scenario.environment.gravity
        swinging = sum(m * (p[1] - pivot[1]) for m, p in bodies[1:])
        return np.array([0.0, 0.0, mass * g, g * first[1], -g * first[0], 0.0]), float(g * swinging)

    def wind_effect(self, angle: float, wind_speed: float, psi: float) -> np.ndarray:
        """What the wind adds: rows bar, unit C_D and unit C_L of the tail; columns reactions (6) and axis torque.

        Args:
            angle: rad; a tail that hangs within half a degree of straight down has its lift to the root.
            wind_speed: m/s.
            psi: rad.
        """
        wind = (wind_speed * math.sin(psi), -wind_speed * math.cos(psi), 0.0)
        jet, misalignment = self.jet(psi), self.scenario.tunnel.misalignment
        a, b = hanging_axis(angle), self.tail_axis(angle)
        bar = self._forces((_DRAG,), self.bar, 0.0, a, a, wind, jet)[0]
        tail = self._forces((_DRAG, _LIFT), self.tail, self.root_distance, a, b, wind, jet)
        if -UPRIGHT_MARGIN < angle < 0.0 <= misalignment and angle + misalignment < 0.0:
            tail[1] = [-value for value in tail[1]]
        return np.array([[self.scenario.bar.drag_coefficient * value for value in bar], *tail])

    def _forces(
        self,
        laws: Sequence[PolarLaw],
        layout: SectionLayout,
        root: float,
        a: Vector3,
        b: Vector3,
        wind: Vector3,
        jet: Jet,
    ) -> list[list[float]]:
        """Rows of reactions and axis torque per law, for sections along b that begin at the distance `root` along a."""
        p_WR = tuple(p + root * d for p, d in zip(self.pivot, a, strict=True))
        interval = jet.exposed_interval(layout, p_WR, b)
        if interval is None:
            return [[0.0] * 7] * len(laws)
        area, middle = (interval[1] - interval[0]) * layout.chord, 0.5 * (interval[0] + interval[1])
        x, y, z = (p + middle * d for p, d in zip(p_WR, b, strict=True))
        arm_y, arm_z = y - self.pivot[1], z - self.pivot[2]
        rows = []
        for law in laws:
            f, g, h = law.section_force(wind, b, layout.normal_B, area, self.scenario.environment.air_density)
            moment = (z * g - y * h, x * h - z * f, y * f - x * g)
            rows.append([-f, -g, -h, *moment, arm_z * g - arm_y * h])
        return rows

    def exposed_length(self, angle: float, psi: float = 0.0) -> float:
        """How much of the tail is in the jet, m."""
        root = np.asarray(self.pivot) + self.root_distance * np.array(hanging_axis(angle))
        interval = self.jet(psi).exposed_interval(self.tail, root.tolist(), self.tail_axis(angle))
        return 0.0 if interval is None else float(interval[1] - interval[0])

    def holding_current(self, angle: float, wind_speed: float, cd: float, cl: float, psi: float) -> float:
        """The current that holds the tail still, A."""
        effect = self.wind_effect(angle, wind_speed, psi)
        torque = self.hanging(angle)[1] + float(np.array([1.0, cd, cl]) @ effect[:, 6])
        return torque / self.torque_constant


def hanging_axis(angle: float) -> Vector3:
    """Unit vector from the pivot to the tip in W (3): down at 0, downstream (-y) at 90 degrees."""
    return (0.0, -math.sin(angle), -math.cos(angle))
