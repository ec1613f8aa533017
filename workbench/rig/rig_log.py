"""Metadata of a rig's log, and the values that its fits should find."""

import math
from typing import Any

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.schema import run_metadata
from aerodima.workbench.rig.rig_layout import rig_law
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.signal_table import (
    names_of,
    rig_columns,
)

RIG_COLUMN_NAMES = tuple(names_of(rig_columns()))


def rig_log_metadata(scenario: RigScenario, **facts: Any) -> Json:
    """Makes the metadata of a rig log: kind, and in `extra` tail, axis, wind speed, offsets,
    current sampling and more facts.
    """
    experiment = scenario.experiment
    extra = {
        "tail": scenario.tail_name,
        "axis": experiment.axis if scenario.has_cheetah_tail else "none",
        "wind_speed_m_per_s": experiment.wind_speed,
        "offsets_to_add": list(scenario.sensor_offsets),
        "current_sampling": "mean",
        **facts,
    }
    return run_metadata(scenario.resolved(), scenario.seed, kind=experiment.kind, extra=extra)


def known_truth(scenario: RigScenario) -> dict[str, float]:
    """Returns the values that the fits of a simulated log should find, by their names; without the
    holding current.
    """
    experiment = scenario.experiment
    aero = scenario.aero
    if experiment.kind == "static":
        drag, lift = static_coefficients(scenario)
        return {"cd": drag, "cl": lift, "psi3": scenario.tunnel.psi3}
    if experiment.kind == "swing":
        return {"added_mass": aero.added_mass}
    friction = scenario.joint_friction
    return {"coulomb": friction.coulomb, "viscous": friction.viscous}


def static_coefficients(scenario: RigScenario) -> Pair:
    """Returns C_D and C_L at the wind speed and the angle of attack of a static hold."""
    speed = scenario.experiment.wind_speed
    tunnel = scenario.tunnel
    sine = abs(math.sin(scenario.experiment.angle + tunnel.misalignment))
    attack = math.asin(sine * math.cos(tunnel.psi3))
    law, _ = rig_law(scenario)
    assert isinstance(law, PolarLaw)
    drag, lift = (
        float(value(speed, attack) if callable(value) else value) for value in (law.drag, law.lift)
    )
    return drag, lift
