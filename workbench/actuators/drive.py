"""Brushless drive on the rear differential (design section 6)."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.config.car_parameters import CarParameters, DriveParameters


def steady_speed(throttle: float, drive: DriveParameters) -> float:
    """Speed (m/s) for a throttle in -1..1: the fitted line, mirrored for reverse, zero inside its dead band.

    Without governor the motor does not overcome its load below `breakaway_throttle` (thesis 6.2).
    """
    if not drive.governor and abs(throttle) < drive.breakaway_throttle:
        return 0.0
    forward = max(0.0, drive.throttle_gain * abs(throttle) + drive.throttle_offset)
    return forward if throttle > 0 else -forward if throttle < 0 else 0.0


def shaft_gain(drive: DriveParameters, car: CarParameters) -> float:
    """Torque per shaft-speed error, N m s/rad: the governor's, or the motor's own from the car's speed response."""
    if drive.governor:
        return drive.governor_gain
    return (car.mass * car.tyre_radius**2 + drive.rotor_inertia) / drive.time_constant


class Drive(LeafSystem):
    """Torque on the differential's shaft: clip(k (w_target - w), +-limit).

    The throttle sets the target through the line of section 6.2. With governor k is stiff, so the wheel speed is held
    through the turn; without, k is the slope of the motor's torque-speed line and the speed droops with load. At
    throttle 0 the drive is off and rolls freely. NaN counts as throttle 0; beyond +-1 is clipped.

    Input ports:
        throttle (1): -1..1.
        shaft_speed (1): rad/s, positive forward.
    Output ports:
        torque (1): N m on the shaft.

    Args:
        drive: line, torque limit.
        gain: k, N m s/rad, from `shaft_gain`.
        rolling_radius: m, of the loaded rear tyres.
    """

    def __init__(self, drive: DriveParameters, gain: float, rolling_radius: float):
        super().__init__()
        self._drive = drive
        self._gain = gain
        self._radius = rolling_radius
        self._throttle = self.DeclareVectorInputPort("throttle", 1)
        self._speed = self.DeclareVectorInputPort("shaft_speed", 1)
        self.DeclareVectorOutputPort(
            "torque", 1, self._calc_torque, prerequisites_of_calc={self.all_input_ports_ticket()}
        )

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        command: Any = self._throttle.Eval(context)
        speed: Any = self._speed.Eval(context)
        throttle = float(command[0])
        limit = self._drive.torque_limit
        torque = 0.0
        if throttle == throttle and throttle != 0.0:
            target = steady_speed(min(max(throttle, -1.0), 1.0), self._drive) / self._radius
            torque = min(max(self._gain * (target - float(speed[0])), -limit), limit)
        output.SetFromVector(np.array([torque]))
