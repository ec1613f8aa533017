"""Test of one motor: its joint moves by five degrees and back while the other is held."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.hardware.car.car_ports import JOINTS
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarCommand
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.driving.held_car import holding, run_cycles
from aerodima.hardware.driving.speaker import Say
from aerodima.workbench.car.laws import pd_torque
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.signal_table import TAIL_STATE

_DIRECTIONS = {"tail_pitch": ("forward", "back"), "tail_roll": ("to the right", "to the left")}
"""Words for the positive and the negative direction of each joint (design section 4)."""
_STEP = math.radians(5.0)
"""Angle by which a joint is moved in the test of its motor, rad."""
_MAX_ERROR = math.radians(2.0)
"""Largest error of that movement, rad."""
_KP = 60.0
"""Position gain of the test, N m/rad: five degrees ask for 5 N m at most, and the weight of a tail
that lies on its side (1.2 N m on the emulated car) costs one degree; with the soft gains that hold
it, it would cost four."""
_KD = 5.0
"""Velocity gain of the test, N m s/rad."""
_MOVE_TIME = 1.0
"""Time of the movement, s."""
_SETTLE_TIME = 0.5
"""Time after the movement until the joint is at rest, s."""
_AVERAGED_CYCLES = 20
"""Number of cycles over which the torque is averaged."""
_TORQUE_TOLERANCE = 0.5
"""Allowed difference of the reported torque, N m: a motor reads its current, not its torque."""
_RELATIVE_TORQUE_TOLERANCE = 0.4
"""Further allowed difference, as a share of the torque that the gains ask for."""
_TEMPERATURE_MARGIN = 20.0
"""Margin below the temperature limit of a drive, K, for a motor that has done nothing yet."""


@dataclass(frozen=True)
class MotorTest:
    """Result of the test of one joint.

    Attributes:
        joint: joint that was moved, one of `JOINTS`.
        moved: angle by which the joint moved, rad.
        torque: mean torque that the motor reported at the end of the movement, N m.
        wanted: mean torque that its gains ask for there, N m.
        temperature: temperature of the motor, degrees Celsius; None if it does not report it.
    """

    joint: str
    moved: float
    torque: float
    wanted: float
    temperature: float | None


def run_motor_test(
    car: WiredCar, joint: str, say: Say, confirm: Callable[[str], bool]
) -> MotorTest:
    """Moves one joint by five degrees and back while the other is held, on a car that is not
    started yet.

    Args:
        joint: joint to move, one of `JOINTS`.
        confirm: function that asks somebody beside the car, once the motors are off, whether the
            tail went the announced way (design section 4: pitch forward and roll to the right are
            positive). What the motor itself reports cannot tell.

    Raises:
        HardwareError: the motors cannot be armed or have a fault, the joint moved by other than
            five degrees, give or take two, the reported torque is not that of its gains, the motor
            is too warm, or the tail went the other way.
    """
    index = JOINTS.index(joint)
    angle_index = TAIL_STATE.index(("pitch_angle", "roll_angle")[index])
    with holding(car):
        start = float(car.reading.tail_state[angle_index])
        step = _STEP if start + _STEP < car.motors[index].settings.high else -_STEP
        direction = _DIRECTIONS[joint][step < 0.0]
        say(f"{joint}: now 5 degrees {direction}")

        def command(since: float) -> CarCommand:
            target = start + step * min(max(since / _MOVE_TIME, 0.0), 1.0)
            row = np.array([target, 0.0, _KP, _KD, 0.0])
            joints: dict[str, Any] = {joint: row}
            return replace(CarCommand(), **joints)

        run_cycles(car, command, _MOVE_TIME + _SETTLE_TIME)
        reported = []
        wanted = []
        for _ in range(_AVERAGED_CYCLES):
            run_cycles(car, command(_MOVE_TIME))
            angle, rate = car.reading.tail_state[[angle_index, angle_index + 3]]
            reported.append(float(car.reading.tail_torque[index]))
            wanted.append(float(pd_torque(angle, rate, start + step, 0.0, _KP, _KD)))
        fault = car.reading.fault_text
        moved = float(car.reading.tail_state[angle_index] - start)
        temperature = car.motors[index].temperature
        run_cycles(car, lambda since: command(_MOVE_TIME - since), _MOVE_TIME + _SETTLE_TIME)
    test = MotorTest(joint, moved, float(np.mean(reported)), float(np.mean(wanted)), temperature)
    _refuse_failed(test, step, fault)
    if not confirm(f"Did the tail go {direction}?"):
        raise HardwareError(
            f"motor test of {joint}: it went the other way; change the sign of "
            f"{joint}.direction (1, -1) in the ports file"
        )
    return test


def _refuse_failed(test: MotorTest, step: float, fault: str) -> None:
    """Raises `HardwareError` for a fault, and for a result that does not match `step` (rad)."""
    name = f"motor test of {test.joint}"
    if fault:
        raise HardwareError(f"{name}: {fault}")
    if abs(test.moved - step) > _MAX_ERROR:
        degrees, expected, error = map(math.degrees, (test.moved, step, _MAX_ERROR))
        raise HardwareError(
            f"{name}: moved by {degrees:+.1f} degrees; allowed is {expected:+g}, give or take "
            f"{error:g}"
        )
    tolerance = _TORQUE_TOLERANCE + _RELATIVE_TORQUE_TOLERANCE * abs(test.wanted)
    if abs(test.torque - test.wanted) > tolerance:
        raise HardwareError(
            f"{name}: reports {test.torque:+.2f} N m where its gains ask for {test.wanted:+.2f}; "
            "is the profile right?"
        )
    warmest = load_motor_safety().temperature_limit - _TEMPERATURE_MARGIN
    if test.temperature is not None and test.temperature > warmest:
        raise HardwareError(f"{name}: {test.temperature:g} degC; allowed is {warmest:g}")
