"""Static logs whose truth is known: made by the rig's plant, with or without a rest phase in
front.
"""

import math

import numpy as np

from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

ANGLES_DEG = (0, 15, 30, 45, 60, 75)
SPEEDS = (10.0, 20.0, 30.0)
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


def static_logs(tests, rest, duration, seed):
    """Three tails, two axes, six angles, three speeds, `tests` logs each: 540 logs with five."""
    rng = np.random.default_rng(seed)
    number = 1000 * seed
    for tail in (1, 2, 3):
        for axis in ("major", "minor"):
            for degrees in ANGLES_DEG:
                for speed in SPEEDS:
                    scenario = static_scenario(
                        tail, axis, degrees, speed, float(rng.uniform(-0.1, 0.1))
                    )
                    scenario = scenario.varied(experiment={"duration": duration})
                    rig = Rig(scenario)
                    calm = Rig(scenario.varied(experiment={"wind_speed": 0.0}))
                    for _ in range(tests):
                        number += 1
                        yield log_with_rest(scenario.varied(seed=number), rig, calm, rest)
