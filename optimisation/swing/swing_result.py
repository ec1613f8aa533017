"""From a solution, or from an even rate, to a swing file: knots, torques, gains, limits, trigger, provenance."""

from __future__ import annotations

from typing import Any

import numpy as np

from aerodima.optimisation.fit.fit_errors import SwingError
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.solver import Solution
from aerodima.optimisation.swing.transcription import ACCELERATION, ANGLE, RATE, TORQUE, Problem, SwingLimits
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SCHEMA, SwingFile, swing_from_dict
from aerodima.workbench.logs.schema import software_versions

HOLD = {"kp": 17.0, "kd": 5.0}
"""Gains of the wait: those of the thesis' hold (Table 6.4)."""
FOLLOW = {"kp": 60.0, "kd": 3.0}
"""Gains along the knots: the tail of 0.05 kg m2 follows within 0.05 rad at 100 Hz."""
RAMP = 0.06
"""Time within which an even swing reaches its rate, s: to 8 rad/s the tail of the parameter files (0.051 kg m2, rotor
0.004) asks for 7.4 N m, less than a third of what its motor gives."""
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
    roll, roll_rate, _ = motion_of(problem, solution, 0)
    pitch_angle, pitch_rate, _ = motion_of(problem, solution, 1)
    if problem.joints == 1:
        pitch_angle = pitch_angle + pitch
    torques = torque_of(problem, solution, 0), torque_of(problem, solution, 1)
    motion = (problem.knots, roll, roll_rate, pitch_angle, pitch_rate)
    return _file(name, scenario, motion, torques, problem.limits, threshold, provenance)


def even_swing(name: str, scenario: Scenario, *, length: float, knots: int, provenance: dict[str, Any]) -> SwingFile:
    """A swing from the side of the wait to the other one with the roll rate and release of a scenario's controller.

    The rate is reached, and left at the end, within `RAMP`; pitch stays at the angle of the wait. No torques.

    Args:
        name: of the swing.
        scenario: car, turn and controller.
        length, knots: of the file, s.
        provenance: fields of `Provenance`.

    Raises:
        SwingError: the rate is too slow to arrive within `length`, or faster than the motor gives its torque.
    """
    controller, limits = scenario.controller, SwingLimits.of(ReducedCar.of(scenario), 1)
    rate, travel = controller.swing_speed, 2.0 * abs(controller.hold_angle)
    slowest = travel / (length - RAMP)
    if not slowest <= rate <= limits.tail_rate:
        raise SwingError(
            f"controller.swing_speed: {rate:g} rad/s; allowed for a swing of {length:g} s: {slowest:.2f} to "
            f"{limits.tail_rate:.2f} rad/s"
        )
    time = np.linspace(0.0, length, knots)
    corners = np.array([0.0, RAMP, travel / rate, travel / rate + RAMP])
    rates = np.interp(time, corners, [0.0, rate, rate, 0.0])
    # The angle is the integral of the trapezoid: what has gone by of its two ramps.
    rising, falling = (np.clip(time - begin, 0.0, RAMP) ** 2 / (2.0 * RAMP) for begin in (0.0, travel / rate))
    gone = rate * (rising + np.maximum(time - RAMP, 0.0) - falling - np.maximum(time - travel / rate - RAMP, 0.0))
    still = np.zeros(knots)
    motion = (time, gone - 0.5 * travel, rates, still + controller.pitch_angle, still)
    return _file(name, scenario, motion, None, limits, controller.trigger_yaw_rate, provenance)


def _file(
    name: str,
    scenario: Scenario,
    motion: tuple[np.ndarray, ...],
    torques: tuple[np.ndarray, np.ndarray] | None,
    limits: SwingLimits,
    threshold: float,
    provenance: dict[str, Any],
) -> SwingFile:
    """Of a motion (time, roll, its rate, pitch, its rate) for a left turn and the motor torques of roll and pitch."""
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0
    time, roll, roll_rate, pitch, pitch_rate = motion
    resolved = scenario.resolved()
    data = {key: float(resolved[key.split(".")[0]][key.split(".")[1]]) for key in CAR_KEYS}

    def row(values: np.ndarray) -> tuple[float, ...]:
        return tuple(float(value) for value in np.round(values, 9) + 0.0)

    knots = {
        "time_s": row(time),
        "roll_position_rad": row(side * np.clip(roll, -limits.angles[0], limits.angles[0])),
        "roll_velocity_rad_per_s": row(side * roll_rate),
        "pitch_position_rad": row(pitch),
        "pitch_velocity_rad_per_s": row(pitch_rate),
    }
    if torques is not None:
        knots |= {"roll_torque_n_m": row(side * torques[0]), "pitch_torque_n_m": row(torques[1])}
    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": scenario.manoeuvre.direction,
            "trigger": {"kind": "yaw_rate", "threshold_rad_per_s": threshold},
            "knots": knots,
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
