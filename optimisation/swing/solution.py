"""Swing files of solutions: motion of the tail, steering, car, floor, aim and claimed value."""

from collections.abc import Sequence

import numpy as np

from aerodima.optimisation.swerve.steering import steering_settings
from aerodima.optimisation.swing.bound import Bound
from aerodima.optimisation.swing.swerve_shooting import (
    FOLLOW_GAINS,
    KNOTS,
    knot_rates,
    within_reach,
)
from aerodima.workbench.car.laws import torque_speed_limits
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.swing_file import SCHEMA, SwingFile, swing_from_dict

RELEASE_STEERING = 0.01
"""Steering command that releases the swing, rad: less than any first level."""
AIM = "aim"
"""Name of the aim under `found` of a solution."""
AIM_VALUE = "aim_value"
"""Name of the aim's value on the full car under `found` of a solution."""
LIMITS_OPTION = "limits"
"""Name of the limits of the search under `options` of a solution."""
KNOT_ROUNDING = 1e-2
"""Angle by which the curve between two knots on a stop may bulge beyond it, rad; the tail then
lies on the stop."""
CAR_KEYS = (
    "car.mass",
    "car.com_height",
    "car.com_x",
    "car.gyration_roll",
    "car.wheelbase",
    "car.track",
    "tail.length",
    "tail.mass",
    "tail.sail_length",
    "tail.sail_width",
    "tail.mount_x",
    "tail.mount_height",
    "tail.normal_force_coefficient",
    "tail.roll_limit",
    "tail.pitch_limit",
)
"""Parameters by which a swing identifies its car; a difference in any makes it another car."""


def solution_swing(
    name: str,
    settings: Sequence[str],
    bound: Bound,
    aim: str,
) -> SwingFile:
    """Returns a solution as the file of a swing to the left that the steering releases.

    Its settings hold the steering of the first car and the numbers of its tail that the search
    chose. `found` holds its claims. No torques are fed forward.

    Args:
        name: name of the swing.
        settings: settings of the first car on `swerve`, its floor and speed, without its steering.
        bound: bound whose solution is written.
        aim: name of the aim.
    """
    solution = bound.solution
    shooting = bound.program.shooting
    variables = shooting.variables
    pitch, *rolls = (solution.x * variables.units)[: variables.motion]
    waiting = [0.0] * (len(KNOTS) - len(rolls))
    found: Json = {
        AIM: aim,
        "aim_reduced": float(np.mean(solution.aims)),
        "cars": variables.members,
        "evaluations": solution.evaluations,
    }
    roll = np.array([*waiting, *rolls])
    rate = knot_rates() @ roll
    scenario = bound.scenarios[0]
    resolved = scenario.resolved()
    keys = [key.split(".") for key in CAR_KEYS]
    angle = scenario.tail.roll_limit
    given = dict(shooting.scenarios[0].tail)
    chosen = [f"tail.{key}={value}" for key, value in scenario.tail if value != given[key]]
    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": "left",
            "trigger": {"kind": "steering", "threshold_rad": RELEASE_STEERING},
            "knots": _knots(np.clip(roll, -angle, angle), rate, pitch),
            "gains": {
                "hold": FOLLOW_GAINS,
                "phases": [{"start_s": 0.0, "roll": FOLLOW_GAINS, "pitch": FOLLOW_GAINS}],
            },
            "limits": _limits(scenario, rate),
            "provenance": {
                "source": "aerodima swing search",
                "scenario": "swerve",
                "settings": (*settings, *chosen, *steering_settings(bound.steering())),
                "found": found,
                "versions": software_versions(),
            },
            "car": {f"{section}.{key}": float(resolved[section][key]) for section, key in keys},
        },
        name,
    )


def with_tail(swing: SwingFile, tail: FloatArray) -> SwingFile:
    """Returns a solution with another pitch of its tail and other rolls at the knots after the
    first (`KNOTS`,), rad; all rolls are scaled down where the curve goes beyond a stop.
    """
    stop = swing.limits.roll_position_rad - KNOT_ROUNDING
    far = swing.limits.pitch_position_rad - KNOT_ROUNDING
    pitch = float(np.clip(tail[0], -far, far))
    roll = np.append(0.0, within_reach(tail[None, 1:], stop))
    rate = knot_rates() @ roll
    data = swing.plain()
    data["knots"] = _knots(roll, rate, pitch)
    data["limits"]["velocity_rad_per_s"] = max(
        swing.limits.velocity_rad_per_s, *np.abs(rate).tolist()
    )
    return swing_from_dict(data, swing.name)


def _knots(roll: FloatArray, rate: FloatArray, pitch: float) -> Json:
    """Returns the knots of a roll, rad, with its rate, rad/s, at a pitch, rad."""
    still = np.zeros(len(roll))
    return {
        "time_s": KNOTS,
        "roll_position_rad": _rounded(roll),
        "roll_velocity_rad_per_s": _rounded(rate),
        "pitch_position_rad": _rounded(still + pitch),
        "pitch_velocity_rad_per_s": _rounded(still),
    }


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple((np.round(values, 9) + 0.0).tolist())


def _limits(scenario: Scenario, rate: FloatArray) -> Json:
    """Returns the limits of a car's swing from its rates at the knots, rad/s."""
    stall, no_load = torque_speed_limits(scenario.tail_motor)
    torque = scenario.tail_motor.torque_limit
    return {
        "roll_position_rad": scenario.tail.roll_limit + KNOT_ROUNDING,
        "pitch_position_rad": scenario.tail.pitch_limit + KNOT_ROUNDING,
        "velocity_rad_per_s": max(no_load * (1.0 - torque / stall), float(np.max(np.abs(rate)))),
        "torque_n_m": torque,
    }
