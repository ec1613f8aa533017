"""Static logs whose truth is known: made by the rig's plant, with or without a rest phase in
front.
"""

import math

from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

CD, CL = 0.9, 0.25
"""Of all logs: inside the bounds, and of the size of the published ones."""


def static_scenario(tail, axis, degrees, speed, psi):
    return load_rig_scenario("static").varied(
        experiment={
            "tail": tail,
            "axis": axis,
            "angle": math.radians(degrees),
            "wind_speed": speed,
        },
        aero={"source": "constant", "drag": CD, "lift": CL},
        tunnel={"psi3": psi},
    )


def log_with_rest(scenario, rig, calm, rest):
    """The hold of `rig`, after `rest` seconds at the same angle without wind (`calm`)."""
    return simulate_static_log(scenario.varied(experiment={"wind_off": rest}), rig, calm)
