"""The air that a rig stands in: the tunnel's jet and the force law of the tail."""

from functools import cache

from aerodima.workbench.aero.coefficient_files import PolarTable, load_coefficients
from aerodima.workbench.aero.laws import NormalForceLaw, SectionLaw
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.plants.rig_model import pivot_position


def rig_jet(scenario: RigScenario) -> Jet:
    """The tunnel's jet as the rig of a scenario stands in it."""
    tunnel = scenario.tunnel
    return Jet.below_pivot(
        pivot_position(scenario.mount), tunnel.jet_edge_depth, psi=tunnel.psi3, slope=tunnel.jet_slope
    )


def rig_law(scenario: RigScenario) -> tuple[SectionLaw, float | None]:
    """Force law of the tail under test, and the relative speed (m/s) up to which it was shown to hold."""
    aero, experiment = scenario.aero, scenario.experiment
    if aero.source == "constant":
        if scenario.is_robot:
            return NormalForceLaw(aero.normal_force), None
        return PolarLaw(aero.drag, aero.lift, lift_blend=aero.lift_blend), None
    name = "robot_tail_line" if scenario.is_robot else f"cheetah_tail_{experiment.tail}_{experiment.axis}"
    return _measured_law(name, aero.lift_blend)


@cache
def _measured_law(name: str, lift_blend: float) -> tuple[SectionLaw, float | None]:
    """Kept: a fit that varies constants of the rig builds its motion hundreds of times."""
    found = load_coefficients(name)
    if name == "robot_tail_line":
        return found.law(), found.quasi_steady_limit
    assert isinstance(found, PolarTable)
    return PolarLaw(found.table("cd"), found.table("cl"), lift_blend=lift_blend), found.quasi_steady_limit
