"""The rig in the wind: pivot, jet, the sections of bar and tail, and the law of the tail."""

from functools import cache

import numpy as np

from aerodima.workbench.aero.coefficient_files import PolarTable, load_coefficients
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import NormalForceLaw, SectionLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.rig_scenario import MountParameters, RigScenario

DOWN = (0.0, 0.0, -1.0)
"""Downward direction in world axes."""
UPSTREAM = (0.0, 1.0, 0.0)
"""Direction in world axes against the wind, which blows to -y."""


def pivot_position(mount: MountParameters) -> FloatArray:
    """Returns p_WP, the point of the motor axis above the bar (3), m."""
    return np.array(
        [mount.com_x + mount.pivot_x, mount.com_y + mount.pivot_y, mount.com_z + mount.pivot_z]
    )


def rig_jet(scenario: RigScenario, psi: float | None = None) -> Jet:
    """Makes the jet as the rig stands in it, its wind turned by psi (rad), by default psi3."""
    tunnel = scenario.tunnel
    if psi is None:
        psi = tunnel.psi3
    pivot = pivot_position(scenario.mount)
    return Jet.below_pivot(pivot, tunnel.jet_edge_depth, psi, tunnel.jet_slope)


def rig_law(scenario: RigScenario) -> tuple[SectionLaw, float | None]:
    """Returns the force law of the tail under test, and the relative speed (m/s) up to which it was
    shown to hold, None for constant coefficients of the scenario.
    """
    aero = scenario.aero
    experiment = scenario.experiment
    if aero.source == "constant":
        if scenario.is_robot:
            return NormalForceLaw(aero.normal_force), None
        return PolarLaw(aero.drag, aero.lift, lift_blend=aero.lift_blend), None
    name = f"cheetah_tail_{experiment.tail}_{experiment.axis}"
    if scenario.is_robot:
        name = "robot_tail_line"
    return _measured_law(name, aero.lift_blend)


@cache
def _measured_law(name: str, lift_blend: float) -> tuple[SectionLaw, float | None]:
    """Reads a law once: a fit that varies constants of the rig makes its pendulum hundreds of
    times.
    """
    coefficients = load_coefficients(name)
    law = coefficients.law()
    if isinstance(coefficients, PolarTable):
        law = PolarLaw(coefficients.table("cd"), coefficients.table("cl"), lift_blend=lift_blend)
    return law, coefficients.quasi_steady_limit


def tail_layout(scenario: RigScenario, sections: int | None = None) -> SectionLayout:
    """Makes sections over the whole tail under test, in the frame of the body `tail`; the jet cuts
    them to its exposed part.

    Args:
        scenario: scenario with a tail.
        sections: number of equal parts; `aero.sections` by default.
    """
    number = sections or scenario.aero.sections
    if scenario.is_robot:
        arm = scenario.robot_tail
        root = arm.length - arm.sail_length
        return _hanging_strip(root, arm.sail_length, arm.sail_width, number)
    tail = scenario.cheetah_tail
    return _hanging_strip(0.0, tail.length, tail.major_axis, number)


def bar_layout(scenario: RigScenario) -> SectionLayout:
    """Makes the bar as one section, in the frame of the body `bar`."""
    bar = scenario.bar
    return _hanging_strip(0.0, bar.tail_distance, bar.width, 1)


def _hanging_strip(start: float, length: float, width: float, number: int) -> SectionLayout:
    """Makes equal sections of a strip that hangs down and faces the wind."""
    return SectionLayout.strip(
        start=start, length=length, width=width, number=number, axis_B=DOWN, normal_B=UPSTREAM
    )
