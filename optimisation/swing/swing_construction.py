"""Makes swing files: of a solution, at a constant rate, and from another swing by a handful of changes.

The changes are what a refinement on the full car searches:

    yaw rate of the release x exp(0.15 x_0),   duration x exp(0.15 x_1),   roll + 0.25 rad x_k,   pitch + 0.3 rad x_k

Roll and pitch are moved at `PLACES` of the movement and smoothly between.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.solver import SwingSolution
from aerodima.optimisation.swing.swing_problem import SwingLimits, SwingProblem
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SCHEMA, SwingFile, swing_from_dict
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import software_versions

HOLD = {"kp": 17.0, "kd": 5.0}
"""Gains of the wait: those of the thesis' hold (Table 6.4)."""
FOLLOW = {"kp": 60.0, "kd": 3.0}
"""Gains along the knots: the tail of 0.05 kg m2 follows within 0.05 rad at 100 Hz."""
RAMP = 0.06
"""Time within which a constant-rate swing reaches its rate, s: to 8 rad/s the tail of the parameter files (0.051 kg m2,
rotor 0.004) asks for 7.4 N m, less than a third of what its motor gives."""
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


def swing_file(
    name: str,
    problem: SwingProblem,
    solution: SwingSolution,
    scenario: Scenario,
    *,
    provenance: dict[str, Any],
) -> SwingFile:
    """The swing of a solution for the turn direction of its scenario.

    Args:
        name: of the swing.
        problem, solution: found for a left turn; a right turn's file is the mirror image.
        scenario: car, turn and controller: its yaw rate releases the swing, its pitch is held by a joint that rests.
        provenance: fields of `Provenance`.
    """
    angles, rates, _ = problem.tail_motion(solution.x)
    still = np.zeros(len(problem.knots))
    pitch_motion = (angles[1], rates[1]) if problem.joints == 2 else (still + scenario.controller.pitch_angle, still)
    motion = (problem.knots, angles[0], rates[0], *pitch_motion)
    members = np.array([car.torque for car in problem.layout.cars])
    torque = np.mean((solution.x * problem.units)[members], axis=0)
    torques = (torque[0], torque[1] if problem.joints == 2 else still)
    return _file(name, scenario, motion, torques, problem.limits, provenance)


def constant_rate_swing(
    name: str, scenario: Scenario, *, length: float, knots: int, provenance: dict[str, Any]
) -> SwingFile:
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
    return _file(name, scenario, motion, None, limits, provenance)


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
    still = np.zeros(len(time))
    motion = (time, roll, rate, still + scenario.controller.pitch_angle, still)
    limits = SwingLimits.of(ReducedCar.of(scenario), 1)
    release = {"kind": "steering", "threshold_rad": RELEASE_STEERING}
    return _file(name, scenario, motion, None, limits, provenance, release)


def _file(
    name: str,
    scenario: Scenario,
    motion: tuple[np.ndarray, ...],
    torques: tuple[np.ndarray, np.ndarray] | None,
    limits: SwingLimits,
    provenance: dict[str, Any],
    trigger: dict[str, Any] | None = None,
) -> SwingFile:
    """Of a motion (time, roll, its rate, pitch, its rate) for a left turn and the motor torques of roll and pitch.

    Without a trigger it is released by the yaw rate of the scenario's controller.
    """
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0
    time, roll, roll_rate, pitch, pitch_rate = motion

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
            "trigger": trigger or {"kind": "yaw_rate", "threshold_rad_per_s": scenario.controller.trigger_yaw_rate},
            "knots": knots,
            "gains": {"hold": HOLD, "phases": [{"start_s": 0.0, "roll": FOLLOW, "pitch": FOLLOW}]},
            "limits": {
                "roll_position_rad": limits.angles[0] + KNOT_ROUNDING,
                "pitch_position_rad": scenario.tail.pitch_limit + KNOT_ROUNDING,
                "velocity_rad_per_s": limits.tail_rate,
                "torque_n_m": limits.torque,
            },
            "provenance": {**provenance, "versions": software_versions()},
            "car": _car_of(scenario),
        },
        name,
    )


def tied_to(swing: SwingFile, scenario: Scenario, name: str, settings: tuple[str, ...]) -> SwingFile:
    """A swing that is for the car and turn of a scenario from now on; `name` and `settings` are what made that."""
    made = swing.provenance.model_copy(update={"scenario": name, "settings": settings})
    return swing.model_copy(update={"car": _car_of(scenario), "provenance": made})


def _car_of(scenario: Scenario) -> dict[str, float]:
    resolved = scenario.resolved()
    return {key: float(resolved[key.split(".")[0]][key.split(".")[1]]) for key in CAR_KEYS}


PLACES = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Where roll is moved, as shares of the movement's duration; pitch also where it begins."""
RELEASE, DURATION, ROLL, PITCH = 0.15, 0.15, 0.25, 0.3
"""What one unit of a change is: logarithms, rad."""
AT_REST = 0.02
"""Share of its largest rate below which the tail counts as arrived."""


def changes(dof: int) -> int:
    """Number of changes that are searched."""
    return 2 + len(PLACES) + (1 + len(PLACES) if dof == 2 else 0)


def changed(swing: SwingFile, x: FloatArray, dof: int = 1) -> SwingFile:
    """A swing with other release and shape; feed-forward torques and feedback, which no longer fit, are left out.

    Args:
        swing: released by a yaw rate.
        x: changes, (`changes(dof)`,), in their units.
        dof: 2 moves pitch too.

    Raises:
        SwingFileError: the changed swing leaves its own limits.
        SwingError: the swing is released by something else.
    """
    threshold = swing.trigger.threshold_rad_per_s
    if threshold is None:
        raise SwingError(f"swing {swing.name}: trigger.kind: {swing.trigger.kind!r}; a refinement knows: yaw_rate")
    time = np.array(swing.knots.time_s) * math.exp(DURATION * x[1])
    roll, rate = swing.knots.states("roll")
    moving = np.flatnonzero(np.abs(rate) > AT_REST * np.max(np.abs(rate)))
    end = float(time[min(int(moving[-1]) + 1, len(time) - 1)])
    side = 1.0 if swing.direction == "left" else -1.0
    offset = ROLL * np.concatenate([[0.0], x[2 : 2 + len(PLACES)]])
    roll = roll + side * _offset(time, end, offset)
    limit = swing.limits.roll_position_rad
    roll = np.clip(roll, -min(limit, math.pi / 2), min(limit, math.pi / 2))
    pitch, pitch_rate = swing.knots.states("pitch")
    if dof == 2:
        pitch = pitch + _offset(time, end, PITCH * x[2 + len(PLACES) :])
        pitch = np.clip(pitch, -swing.limits.pitch_position_rad, swing.limits.pitch_position_rad)
    data = swing.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["trigger"]["threshold_rad_per_s"] = float(round(threshold * math.exp(RELEASE * x[0]), 9))
    data["knots"] = {
        "time_s": _row(time),
        "roll_position_rad": _row(roll),
        "roll_velocity_rad_per_s": _row(_rates(time, roll)),
        "pitch_position_rad": _row(pitch),
        "pitch_velocity_rad_per_s": _row(_rates(time, pitch) if dof == 2 else pitch_rate),
    }
    data["gains"].pop("feedback", None)
    return swing_from_dict(data, swing.name)


def _offset(time: FloatArray, end: float, values: FloatArray) -> FloatArray:
    """Smooth offsets through `values` at the start and at `PLACES` of the movement, constant after it."""
    curve = PchipInterpolator(end * np.concatenate([[0.0], PLACES]), values)
    return np.asarray(curve(np.minimum(time, end)))


def _rates(time: FloatArray, angle: FloatArray) -> FloatArray:
    """Rates at the knots whose curve stays between the knots; at rest at both ends."""
    rates = np.asarray(PchipInterpolator(time, angle).derivative()(time))
    rates[0] = rates[-1] = 0.0
    return rates


def _row(values: FloatArray) -> list[float]:
    return [float(value) for value in np.round(values, 9) + 0.0]
