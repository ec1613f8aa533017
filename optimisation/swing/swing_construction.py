"""Makes swing files: of a roll motion that the steering releases, and at a constant rate."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.actuators.ak70 import torque_speed_limits
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
    controller, limits = scenario.controller, JointLimits.of(scenario)
    rate, travel = controller.swing_speed, 2.0 * abs(controller.hold_angle)
    slowest = travel / (length - RAMP)
    if not slowest <= rate <= limits.rate:
        raise SwingError(
            f"controller.swing_speed: {rate:g} rad/s; allowed for a swing of {length:g} s: {slowest:.2f} to "
            f"{limits.rate:.2f} rad/s"
        )
    time = np.linspace(0.0, length, knots)
    corners = np.array([0.0, RAMP, travel / rate, travel / rate + RAMP])
    rates = np.interp(time, corners, [0.0, rate, rate, 0.0])
    # The angle is the integral of the trapezoid: what has gone by of its two ramps.
    rising, falling = (np.clip(time - begin, 0.0, RAMP) ** 2 / (2.0 * RAMP) for begin in (0.0, travel / rate))
    gone = rate * (rising + np.maximum(time - RAMP, 0.0) - falling - np.maximum(time - travel / rate - RAMP, 0.0))
    still = np.zeros(knots)
    motion = (time, gone - 0.5 * travel, rates, still + controller.pitch_angle, still)
    return _file(name, scenario, motion, limits, provenance)


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
    release = {"kind": "steering", "threshold_rad": RELEASE_STEERING}
    return _file(name, scenario, motion, JointLimits.of(scenario), provenance, release)


def _file(
    name: str,
    scenario: Scenario,
    motion: tuple[np.ndarray, ...],
    limits: JointLimits,
    provenance: dict[str, Any],
    trigger: dict[str, Any] | None = None,
) -> SwingFile:
    """Of a motion (time, roll, its rate, pitch, its rate) for a left turn.

    Without a trigger it is released by the yaw rate of the scenario's controller.
    """
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0
    time, roll, roll_rate, pitch, pitch_rate = motion

    def row(values: np.ndarray) -> tuple[float, ...]:
        return tuple(float(value) for value in np.round(values, 9) + 0.0)

    knots = {
        "time_s": row(time),
        "roll_position_rad": row(side * np.clip(roll, -limits.angle, limits.angle)),
        "roll_velocity_rad_per_s": row(side * roll_rate),
        "pitch_position_rad": row(pitch),
        "pitch_velocity_rad_per_s": row(pitch_rate),
    }
    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": scenario.manoeuvre.direction,
            "trigger": trigger or {"kind": "yaw_rate", "threshold_rad_per_s": scenario.controller.trigger_yaw_rate},
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
