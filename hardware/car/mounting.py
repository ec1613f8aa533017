"""Every sign swap between the devices of the real car and the car's frame, in one table.

Body frame B: x forward, y left, z up; steering and yaw positive to the left; tail roll positive to
the right (design section 4). The functions go both ways: the car's computer reads with them, an
emulator writes with them.
"""

import math
from functools import cache
from typing import Literal

import numpy as np

from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.motor_limits import clip
from aerodima.hardware.devices.teensy_link import pulse
from aerodima.hardware.protocol.teensy import SERVO_PULSES, THROTTLE_PULSES
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.elementwise import roll_pitch_yaw
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario_file import load_section

AXES = {
    f"{sign}{axis}": factor * np.eye(3)["xyz".index(axis)]
    for axis in "xyz"
    for sign, factor in (("+", 1), ("-", -1))
}
_TURN = 2.0 * math.pi
"""A full turn, rad."""
Sign = Literal[1, -1]


class Mounting(QuantityModel):
    """Directions (+1 or -1) and zeros of what is bolted to the car."""

    tail_pitch_direction: Sign = quantity("1", "sign of the pitch motor's angle")
    tail_roll_direction: Sign = quantity("1", "sign of the roll motor's angle")
    sail_direction: Sign = quantity("1", "sign of the sail encoder")
    sail_zero: float = quantity("rad", "encoder angle at sail angle 0", "[-7, 7]")
    steering_direction: Sign = quantity(
        "1", "sign of the steering; +1: a longer pulse steers to the left"
    )
    steering_range: float = quantity(
        "rad", "steering angle at the least and most pulse", "(0, 1.2]"
    )
    throttle_direction: Sign = quantity(
        "1", "sign of the throttle; +1: a longer pulse drives forward"
    )
    imu_x: str = quantity("1", "chip axis along B's x, such as +x or -y")
    imu_y: str = quantity("1", "chip axis along B's y")

    @property
    def chip_to_body(self) -> FloatArray:
        """Rotation R_BI (3, 3), which turns chip axes into body axes.

        Raises `HardwareError` if imu_x and imu_y are not two axes.
        """
        return _chip_to_body(self.imu_x, self.imu_y)

    # -- read by the car's computer

    def imu_reading(self, sample: Bno055Sample) -> FloatArray:
        """Converts a sample to a reading (9,) as `signal_table.IMU`: roll, pitch, yaw rad; gyro
        rad/s; linear acceleration m/s2; in body axes.
        """
        R_BI = self.chip_to_body
        attitude = roll_pitch_yaw(sample.rotation @ R_BI.T)
        return np.array([*attitude, *(R_BI @ sample.gyro), *(R_BI @ sample.acceleration)])

    def sail_angle(self, encoder: float) -> float:
        """Returns the sail angle in [0, 2 pi) rad that belongs to an encoder angle, rad."""
        return self.sail_direction * (encoder - self.sail_zero) % _TURN

    def servo_pulse(self, steering_angle: float) -> int:
        """Returns the pulse (us) for a steering angle (rad, left positive), clipped to the servo's
        reach.
        """
        share = clip(steering_angle / self.steering_range, 1.0)
        return pulse(self.steering_direction * share, SERVO_PULSES)

    def throttle_pulse(self, throttle: float) -> int:
        """Returns the pulse (us) for a throttle, clipped to -1..1."""
        return pulse(self.throttle_direction * clip(throttle, 1.0), THROTTLE_PULSES)

    # -- written by an emulator, which has Drake

    def imu_sample(self, reading: FloatArray) -> Bno055Sample:
        """Converts a reading (9,) in body axes to the chip's sample; inverts `imu_reading`."""
        from pydrake.math import RollPitchYaw, RotationMatrix

        R_BI = self.chip_to_body
        R_WB = RollPitchYaw(reading[:3]).ToRotationMatrix()
        q = R_WB.multiply(RotationMatrix(R_BI)).ToQuaternion()
        gyro = R_BI.T @ reading[3:6]
        acceleration = R_BI.T @ reading[6:9]
        return Bno055Sample(
            (q.w(), q.x(), q.y(), q.z()), tuple(gyro.tolist()), tuple(acceleration.tolist())
        )

    def encoder_angle(self, sail_angle: float) -> float:
        """Returns the encoder angle in [0, 2 pi) rad that belongs to a sail angle, rad."""
        return (self.sail_zero + self.sail_direction * sail_angle) % _TURN

    def steering_angle(self, servo_pulse: int) -> float:
        """Returns the steering angle (rad, positive to the left) that a pulse (us) asks for."""
        return self.steering_direction * self.steering_range * _share(servo_pulse, SERVO_PULSES)

    def throttle(self, throttle_pulse: int) -> float:
        """Returns the throttle (-1 to 1) that a pulse (us) asks for."""
        return self.throttle_direction * _share(throttle_pulse, THROTTLE_PULSES)


def load_mounting() -> Mounting:
    """Loads the table of `models/parameters/hardware/mounting.yaml`; a `UserError` names what is
    wrong in it.
    """
    mounting = load_section(model_path("parameters/hardware/mounting.yaml"), Mounting)
    mounting.chip_to_body  # noqa: B018 - raises if the axes are none
    return mounting


@cache
def _chip_to_body(imu_x: str, imu_y: str) -> FloatArray:
    if imu_x not in AXES or imu_y not in AXES:
        raise HardwareError(f"imu_x {imu_x!r}, imu_y {imu_y!r}; allowed: {', '.join(AXES)}")
    x = AXES[imu_x]
    y = AXES[imu_y]
    if x @ y != 0.0:
        raise HardwareError(f"imu_x {imu_x!r} and imu_y {imu_y!r} lie on one axis of the chip")
    return np.array([x, y, np.cross(x, y)])


def _share(value: int, pulses: tuple[int, int, int]) -> float:
    return float(np.interp(value, pulses, (-1.0, 0.0, 1.0)))
