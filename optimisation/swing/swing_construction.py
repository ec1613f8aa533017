"""Makes swing files of a roll motion that the steering releases."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.actuators.ak70 import torque_speed_limits
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SCHEMA, SwingFile, swing_from_dict
from aerodima.workbench.logs.schema import software_versions

HOLD = {"kp": 17.0, "kd": 5.0}
"""Gains of the wait: those of the thesis' hold (Table 6.4)."""
FOLLOW = {"kp": 60.0, "kd": 3.0}
"""Gains along the knots: the tail of 0.05 kg m2 follows within 0.05 rad at 100 Hz."""
RELEASE_STEERING = 0.01
"""Steering command that releases a swing which goes by the steering, rad: less than any turn's."""
KNOT_ROUNDING = 1e-2
"""How far the curve between two knots on a stop may bulge beyond it, rad: the tail then rests on the stop."""

CAR_KEYS = (
    "car.mass", "car.com_height", "car.com_x", "car.gyration_roll", "car.wheelbase", "car.track", "tail.length",
    "tail.mass", "tail.sail_length", "tail.sail_width", "tail.mount_x", "tail.mount_height",
    "tail.normal_force_coefficient", "tail.roll_limit", "tail.pitch_limit",
)  # fmt: skip
"""Parameters that make it another car for a swing."""


class JointLimits(NamedTuple):
    """What a car's roll joint can do: rad to either side, N m, and the rate at which it still gives that, rad/s."""

    angle: float
    torque: float
    rate: float

    @classmethod
    def of(cls, scenario: Scenario) -> JointLimits:
        """Of the tail and its motor."""
        stall, no_load = torque_speed_limits(scenario.tail_motor)
        most = scenario.tail_motor.torque_limit
        return cls(scenario.tail.roll_limit, most, no_load * (1.0 - most / stall))


def steered_swing(
    name: str, scenario: Scenario, time: FloatArray, roll: FloatArray, rate: FloatArray, *, provenance: dict[str, Any]
) -> SwingFile:
    """A swing that the steering releases; pitch stays at the angle of the wait, no torques.

    Args:
        name: of the swing.
        scenario: car, turn and controller.
        time, roll, rate: of the tail at the knots in a turn to the left, s since the steering command, rad and rad/s.
        provenance: fields of `Provenance`.
    """
    limits, still = JointLimits.of(scenario), np.zeros(len(time))
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0

    def row(values: np.ndarray) -> tuple[float, ...]:
        return tuple(float(value) for value in np.round(values, 9) + 0.0)

    knots = {
        "time_s": row(time),
        "roll_position_rad": row(side * np.clip(roll, -limits.angle, limits.angle)),
        "roll_velocity_rad_per_s": row(side * rate),
        "pitch_position_rad": row(still + scenario.controller.pitch_angle),
        "pitch_velocity_rad_per_s": row(still),
    }
    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": scenario.manoeuvre.direction,
            "trigger": {"kind": "steering", "threshold_rad": RELEASE_STEERING},
            "knots": knots,
            "gains": {"hold": HOLD, "phases": [{"start_s": 0.0, "roll": FOLLOW, "pitch": FOLLOW}]},
            "limits": {
                "roll_position_rad": limits.angle + KNOT_ROUNDING,
                "pitch_position_rad": scenario.tail.pitch_limit + KNOT_ROUNDING,
                "velocity_rad_per_s": limits.rate,
                "torque_n_m": limits.torque,
            },
            "provenance": {**provenance, "versions": software_versions()},
            "car": _car_of(scenario),
        },
        name,
    )


def _car_of(scenario: Scenario) -> dict[str, float]:
    resolved = scenario.resolved()
    return {key: float(resolved[key.split(".")[0]][key.split(".")[1]]) for key in CAR_KEYS}
