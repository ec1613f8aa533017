"""From a solution to a swing file: knots, torques, gains, limits, trigger, provenance."""

from __future__ import annotations

from typing import Any

import numpy as np

from optimisation.swing.solve import Solution
from optimisation.swing.transcription import ACCELERATION, ANGLE, RATE, TORQUE, Problem
from workbench.logs.schema import software_versions
from workbench.scenario import Scenario
from workbench.swing_file import SCHEMA, SwingFile, swing_from_dict

HOLD = {"kp": 17.0, "kd": 5.0}
"""Gains of the wait: those of the thesis' hold (Table 6.4)."""
FOLLOW = {"kp": 60.0, "kd": 3.0}
"""Gains along the knots: the tail of 0.05 kg m2 follows within 0.05 rad at 100 Hz."""
KNOT_ROUNDING = 1e-2
"""How far the curve between two knots on a stop may bulge beyond it, rad: the tail then rests on the stop."""

CAR_KEYS = (
    "car.mass", "car.com_height", "car.com_x", "car.gyration_roll", "car.wheelbase", "car.track", "tail.length",
    "tail.mass", "tail.sail_length", "tail.sail_width", "tail.mount_x", "tail.mount_height",
    "tail.normal_force_coefficient", "tail.roll_limit", "tail.pitch_limit",
)  # fmt: skip
"""Parameters that make it another car for a swing."""


def motion_of(problem: Problem, solution: Solution, joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle (rad), rate (rad/s) and acceleration (rad/s2) of a joint at the knots; zeros for one that rests."""
    if joint >= problem.joints:
        return tuple(np.zeros(len(problem.knots)) for _ in range(3))  # type: ignore[return-value]
    units = (ANGLE, RATE, ACCELERATION)
    layout = problem.layout
    return tuple(solution.x[layout.tail(joint, order)] * units[order] for order in range(3))  # type: ignore[return-value]


def torque_of(problem: Problem, solution: Solution, joint: int) -> np.ndarray:
    """Motor torque at the knots, N m, mean over the members."""
    if joint >= problem.joints:
        return np.zeros(len(problem.knots))
    layout = problem.layout
    rows = [solution.x[layout.member(number, 2 + joint)] * TORQUE for number in range(layout.members)]
    return np.mean(rows, axis=0)


def swing_file(
    name: str,
    problem: Problem,
    solution: Solution,
    scenario: Scenario,
    *,
    threshold: float,
    pitch: float,
    provenance: dict[str, Any],
) -> SwingFile:
    """The swing of a solution for the turn direction of its scenario.

    Args:
        name: of the swing.
        problem, solution: found for a left turn; a right turn's file is the mirror image.
        scenario: car and turn.
        threshold: yaw rate that releases it, rad/s.
        pitch: angle that a pitch joint without part in the swing holds, rad.
        provenance: fields of `Provenance`.
    """
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0
    roll, roll_rate, _ = motion_of(problem, solution, 0)
    pitch_angle, pitch_rate, _ = motion_of(problem, solution, 1)
    if problem.joints == 1:
        pitch_angle = pitch_angle + pitch
    limits = problem.limits
    resolved = scenario.resolved()
    data = {key: float(resolved[key.split(".")[0]][key.split(".")[1]]) for key in CAR_KEYS}

    def row(values: np.ndarray) -> tuple[float, ...]:
        return tuple(float(value) for value in np.round(values, 9) + 0.0)

    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": scenario.manoeuvre.direction,
            "trigger": {"kind": "yaw_rate", "threshold_rad_per_s": threshold},
            "knots": {
                "time_s": row(problem.knots),
                "roll_position_rad": row(side * np.clip(roll, -limits.angles[0], limits.angles[0])),
                "roll_velocity_rad_per_s": row(side * roll_rate),
                "pitch_position_rad": row(pitch_angle),
                "pitch_velocity_rad_per_s": row(pitch_rate),
                "roll_torque_n_m": row(side * torque_of(problem, solution, 0)),
                "pitch_torque_n_m": row(torque_of(problem, solution, 1)),
            },
            "gains": {"hold": HOLD, "phases": [{"start_s": 0.0, "roll": FOLLOW, "pitch": FOLLOW}]},
            "limits": {
                "roll_position_rad": limits.angles[0] + KNOT_ROUNDING,
                "pitch_position_rad": scenario.tail.pitch_limit + KNOT_ROUNDING,
                "velocity_rad_per_s": limits.tail_rate,
                "torque_n_m": limits.torque,
            },
            "provenance": {**provenance, "versions": software_versions()},
            "car": data,
        },
        name,
    )
