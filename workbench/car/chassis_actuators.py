"""Brushless drive on the rear differential; steering servo with its linkage (design section 6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, OutputPort

from aerodima.workbench.car.car_model import axle_statics, rolling_torques
from aerodima.workbench.car.laws import governor_torque, rolling_resistance, servo_step
from aerodima.workbench.core.elementwise import clip
from aerodima.workbench.core.port_wiring import add_and_connect, vector_of
from aerodima.workbench.core.system_lifetime import weak_callback
from aerodima.workbench.scenario.signal_table import WHEELS

if TYPE_CHECKING:
    from aerodima.workbench.scenario.car_parameters import (
        CarParameters,
        DriveParameters,
        ServoParameters,
    )
    from aerodima.workbench.scenario.scenario import Scenario

FRAME_TOLERANCE = 1e-4
"""Of a frame of the servo; a step that falls on its begin up to rounding has it begun."""


def steady_speed(throttle: float, drive: DriveParameters) -> float:
    """Returns the speed (m/s) for a throttle in -1..1: the fitted line, mirrored for reverse, zero
    inside its dead band.

    Without governor the motor does not overcome its load below `breakaway_throttle` (thesis 6.2).
    """
    if not drive.governor and abs(throttle) < drive.breakaway_throttle:
        return 0.0
    forward = max(0.0, drive.throttle_gain * abs(throttle) + drive.throttle_offset)
    if throttle > 0:
        return forward
    if throttle < 0:
        return -forward
    return 0.0


def shaft_gain(drive: DriveParameters, car: CarParameters) -> float:
    """Returns the torque per shaft-speed error, N m s/rad: the governor's, or the motor's own from
    the car's speed response.
    """
    if drive.governor:
        return drive.governor_gain
    return (car.mass * car.tyre_radius**2 + drive.rotor_inertia) / drive.time_constant


def shaft_torque(
    throttle: float,
    shaft_speed: float,
    drive: DriveParameters,
    gain: float,
    radius: float,
    loss: float = 0.0,
) -> float:
    """Returns the torque (N m) on the differential's shaft, by `governor_torque`.

    The throttle sets the target through the line of section 6.2. With governor k is stiff, so the
    wheel speed is held through the turn; without, k is the slope of the motor's torque-speed line
    and the speed droops with load. The line is that of the rolling car, so the drive carries its
    rolling resistance; at throttle 0 it is off. NaN counts as throttle 0; beyond +-1 is clipped.

    Args:
        throttle: -1..1.
        shaft_speed: rad/s, positive forward.
        drive: line, torque limit.
        gain: k, N m s/rad, from `shaft_gain`.
        radius: m, of the loaded rear tyres as they roll.
        loss: rolling resistance of all wheels, N m.
    """
    if throttle != throttle or throttle == 0.0:
        return 0.0
    target = steady_speed(clip(throttle, -1.0, 1.0), drive) / radius
    torque: float = governor_torque(target, shaft_speed, gain, loss, drive.torque_limit)
    return torque


def ackermann(steering_angle: float, wheelbase: float, track: float) -> tuple[float, float]:
    """Returns the angles (rad) of the left and right front wheel, positive to the left, that roll
    about one centre of turn.

    `steering_angle` is that of the wheel in the middle of the kinematic bicycle.
    """
    tangent = math.tan(steering_angle)
    half = 0.5 * track / wheelbase * tangent
    return math.atan2(tangent, 1.0 - half), math.atan2(tangent, 1.0 + half)


def knuckle_angles(
    steering_angle: float, servo: ServoParameters, car: CarParameters
) -> tuple[float, float]:
    """Returns the angles (rad) of the left and right front wheel for a steering angle."""
    if servo.linkage == "parallel":
        return steering_angle, steering_angle
    return ackermann(steering_angle, car.wheelbase, car.track)


def steering_motion(frame: Sequence[float], time: float, rate: float) -> tuple[float, float]:
    """Returns the bicycle steering angle, rad, and its rate, rad/s, at `time` s.

    Args:
        frame: begin s, angle at that time rad, angle rad that the servo moves to.
        time: s.
        rate: of the servo, rad/s.
    """
    begin, start, target = frame
    angle = servo_step(start, target, rate * (time - begin))
    if angle == target:
        return angle, 0.0
    return angle, math.copysign(rate, target - start)


def servo_frame(
    last: Sequence[float] | None, time: float, command: float, servo: ServoParameters
) -> Sequence[float]:
    """Returns the servo's frame at `time` s, as `steering_motion` reads it.

    The servo reads its command once per frame and moves towards it at its rate; 30 degrees take
    0.14 s (thesis 7.1.1). The command is clipped to the servo's limit; NaN holds the last angle.

    Args:
        last: the frame of a step before; None at the first step, at which the wheels stand
            straight.
        time: of a step of the plant, s.
        command: bicycle steering angle at that time, rad, positive to the left.
        servo: rate, limit, frame rate.
    """
    begin = math.floor(time * servo.frame_rate + FRAME_TOLERANCE) / servo.frame_rate
    if last is not None and begin <= last[0]:
        return last
    angle, _ = steering_motion(last or (0.0, 0.0, 0.0), begin, servo.rate)
    if math.isnan(command):
        target = angle
    else:
        target = clip(command, -servo.limit, servo.limit)
    return begin, angle, target


def knuckle_motion(
    angle: float, rate: float, servo: ServoParameters, car: CarParameters
) -> tuple[float, float, float, float]:
    """Returns angles (rad) and rates (rad/s) of left and right front wheel, for those of the
    bicycle.
    """
    left, right = knuckle_angles(angle, servo, car)
    if servo.linkage == "parallel":
        return left, right, rate, rate
    tangent = math.tan(angle)
    half = 0.5 * car.track / car.wheelbase
    turning = rate * (1.0 + tangent**2)
    inner = 1.0 - half * tangent
    outer = 1.0 + half * tangent
    return left, right, turning / (inner**2 + tangent**2), turning / (outer**2 + tangent**2)


class DriveTrain(LeafSystem):
    """The drive on the shaft of the rear differential, and the rolling resistance of the wheels.

    Laws: `shaft_torque` and `rolling_resistance`.

    Input ports:
        throttle (1): -1..1.
        spins (5): rates of the shaft and of the `WHEELS` about their axles, rad/s.
    Output ports:
        torques (5): of the drive on the shaft, then of the ground on the `WHEELS`, N m.

    Args:
        scenario: with car, drive and gravity.
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
        inputs = {self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("torques", 1 + len(WHEELS), weak_callback(self._calc), inputs)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, scenario: Scenario, *, spins: OutputPort
    ) -> DriveTrain:
        """Adds a drive train to the plant with these spins."""
        return add_and_connect(builder, cls(scenario), spins=spins)

    def _calc(self, context: Context, output: BasicVector) -> None:
        (throttle,) = vector_of(self._throttle, context).tolist()
        shaft_speed, *wheels = vector_of(self._spins, context).tolist()
        rolling = [rolling_resistance(*pair) for pair in zip(wheels, self._rolling, strict=True)]
        torque = shaft_torque(
            throttle, shaft_speed, self._drive, self._gain, self._radius, -sum(rolling)
        )
        output.SetFromVector(np.array([torque, *rolling]))


class SteeringServo(LeafSystem):
    """The servo with its linkage: where the plant's steering joints are asked to stand.

    Laws: `servo_frame`, `steering_motion` and `knuckle_motion`; the joints' own control is Drake's,
    with stiffness and damping of the servo.

    Input ports:
        steering_angle (1): commanded bicycle steering angle, rad, positive to the left.
        last_frame (4): 1, or 0 before the first step of the plant, and the frame of that step.
    Output ports:
        steering (7): angles, rad, then rates, rad/s, of left and right knuckle, and the frame.

    Args:
        scenario: with car and servo.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        self.set_name("steering_servo")
        self._servo = scenario.servo
        self._car = scenario.car
        self._command = self.DeclareVectorInputPort("steering_angle", 1)
        self._last_frame = self.DeclareVectorInputPort("last_frame", 4)
        inputs = {self.time_ticket(), self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("steering", 7, weak_callback(self._calc), inputs)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, scenario: Scenario, *, last_frame: OutputPort
    ) -> SteeringServo:
        """Adds a servo that goes on from its frame in the plant's last step."""
        return add_and_connect(builder, cls(scenario), last_frame=last_frame)

    def _calc(self, context: Context, output: BasicVector) -> None:
        time = context.get_time()
        (command,) = vector_of(self._command, context).tolist()
        stepped, *last = vector_of(self._last_frame, context).tolist()
        frame = servo_frame(last if stepped else None, time, command, self._servo)
        angle, rate = steering_motion(frame, time, self._servo.rate)
        knuckles = knuckle_motion(angle, rate, self._servo, self._car)
        output.SetFromVector(np.array([*knuckles, *frame]))
