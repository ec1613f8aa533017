"""Brushless drive on the rear differential; steering servo with its linkage (design section 6)."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.car.car_model import axle_statics, rolling_torques
from aerodima.workbench.car.laws import (
    knuckle_motion,
    rolling_resistance,
    servo_frame,
    shaft_gain,
    shaft_torque,
    steering_motion,
)
from aerodima.workbench.core.port_wiring import declare_output, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import WHEELS


class DriveTrain(LeafSystem):
    """The drive on the shaft of the rear differential, and the rolling resistance of the wheels.

    Laws: `shaft_torque` and `rolling_resistance`.

    Input ports:
        throttle (1): throttle, -1..1.
        spins (5): rates of the shaft and of the `WHEELS` about their axles, rad/s.
    Output ports:
        torques (5): torque of the drive on the shaft, then of the ground on each of the `WHEELS`,
            N m.

    Args:
        scenario: scenario with car, drive and gravity.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        self.set_name("drive_train")
        gravity = scenario.environment.gravity
        self._drive = scenario.drive
        self._gain = shaft_gain(scenario.drive, scenario.car)
        self._radius = axle_statics(scenario.car, gravity, "rear").wheel_height
        rolling = rolling_torques(scenario.car, gravity)
        self._rolling = [rolling[wheel.split("_")[0]] for wheel in WHEELS]
        self._throttle = self.DeclareVectorInputPort("throttle", 1)
        self._spins = self.DeclareVectorInputPort("spins", 1 + len(WHEELS))
        declare_output(self, "torques", 1 + len(WHEELS), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        (throttle,) = vector_of(self._throttle, context).tolist()
        shaft_speed, *wheels = vector_of(self._spins, context).tolist()
        rolling = [rolling_resistance(*pair) for pair in zip(wheels, self._rolling, strict=True)]
        torque = shaft_torque(
            throttle, shaft_speed, self._drive, self._gain, self._radius, -sum(rolling)
        )
        output.SetFromVector(np.array([torque, *rolling]))


class SteeringServo(LeafSystem):
    """The servo with its linkage, which sets the targets of the plant's steering joints.

    Laws: `servo_frame`, `steering_motion` and `knuckle_motion`; the joints' own control is Drake's,
    with stiffness and damping of the servo.

    Input ports:
        steering_angle (1): commanded bicycle steering angle, rad, positive to the left.
        last_frame (4): 1, or 0 before the first step of the plant, and the frame of that step.
    Output ports:
        steering (7): angles, rad, then rates, rad/s, of left and right knuckle, and the frame.

    Args:
        scenario: scenario with car and servo.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        self.set_name("steering_servo")
        self._servo = scenario.servo
        self._car = scenario.car
        self._command = self.DeclareVectorInputPort("steering_angle", 1)
        self._last_frame = self.DeclareVectorInputPort("last_frame", 4)
        declare_output(self, "steering", 7, self._calc, timed=True)

    def _calc(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        (command,) = vector_of(self._command, context).tolist()
        stepped, *last = vector_of(self._last_frame, context).tolist()
        frame = servo_frame(last if stepped else None, time, command, self._servo)
        angle, rate = steering_motion(frame, time, self._servo.rate)
        knuckles = knuckle_motion(angle, rate, self._servo, self._car)
        output.SetFromVector(np.array([*knuckles, *frame]))
