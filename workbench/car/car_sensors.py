"""Sensors of the car: inertial measurement unit, ground speed from GPS, encoders of sail and tail
motors.

IMU and GPS read one vector. The plant's own lists would cost about 25 us each to read, since every
body becomes a Python object.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context

from aerodima.workbench.aero.section_laws import add_cross, cross, rotated
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.elementwise import roll_pitch_yaw, rotation_rows
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.core.sampled import TURN, AngleEncoder, CounterNoise, SampledSensor
from aerodima.workbench.scenario.signal_table import IMU
from aerodima.workbench.scenario.tail_parameters import TailMotorParameters

CHASSIS_MOTION_SIZE = 20
"""Size of the vector of the chassis' motion: quaternion w, x, y, z; position, m; angular velocity,
rad/s, and velocity, m/s, in W; angular velocity and velocity before the plant's last step; 0 before
the first step of a run, when there is no acceleration yet, then 1."""
Vector = tuple[Any, Any, Any]
GYRO_RANGE = math.radians(2000.0)
"""Rate at which a gyroscope axis saturates, rad/s; BNO055 in fusion mode (Bosch
BST-BNO055-DS000)."""
FORCE_RANGE = 4.0 * STANDARD_GRAVITY
"""Value at which an axis of its accelerometer saturates, m/s2, gravity included."""
POSITION_BITS = 16
"""Bits of a position in the AK70-10's reply in MIT mode (design section 14)."""
SPEED_BITS = 12
"""Bits of a speed in that reply."""
RATE_WINDOW = 0.02
"""Time over which the sail's encoder computes its rate, s."""
STEPS = np.repeat([1.0 / 900.0, 1.0 / 900.0, 0.01], 3)
"""Resolution of the BNO055: rad of the attitude, rad/s and m/s2 per count."""


class ChassisMotion(NamedTuple):
    """Motion of a body: rows of R_WB (3, 3); in W angular velocity, rad/s, its rate, rad/s2,
    acceleration, m/s2 (3).
    """

    R_WB: Any
    w_WB: Any
    alpha_WB: Any
    a_WB: Any


def chassis_motion(values: Any, step: float) -> ChassisMotion:
    """Reads the motion from a vector of `CHASSIS_MOTION_SIZE`, for a plant with this step, s."""
    x = values.tolist()
    change = [x[19] * (x[7 + k] - x[13 + k]) / step for k in range(6)]
    return ChassisMotion(rotation_rows(x[:4]), x[7:10], change[:3], change[3:])


def in_body(R_WB: Any, vector: Any) -> Vector:
    """Turns a vector in W into the axes of a body with these rows of its rotation; numbers or
    arrays of one shape.
    """
    return rotated(tuple(zip(*R_WB, strict=True)), vector)


def felt_at(motion: ChassisMotion, p_BoImu_B: Any) -> tuple[Vector, Vector]:
    """Returns angular velocity (3), rad/s, and acceleration (3), m/s2, of a point of body B, both
    in B axes.

    a_WImu = a_WBo + alpha x p + omega x (omega x p), all turned into B axes. The acceleration is
    that of the point: the chip reports it with gravity removed ("linear acceleration").

    Args:
        motion: motion of the body; its numbers may be arrays of one shape.
        p_BoImu_B: position (3) of the point in the body, m.
    """
    omega = in_body(motion.R_WB, motion.w_WB)
    alpha = in_body(motion.R_WB, motion.alpha_WB)
    a_tangential = add_cross(in_body(motion.R_WB, motion.a_WB), alpha, p_BoImu_B)
    return omega, add_cross(a_tangential, omega, cross(omega, p_BoImu_B))


def motion_at_imu(motion: ChassisMotion, p_BoImu_B: Any) -> tuple[Vector, Vector, Vector]:
    """Returns the true motion that an IMU fixed to body B feels, see `felt_at`.

    Returns:
        Roll-pitch-yaw (3) of B in W, rad, yaw in (-pi, pi]; angular velocity (3), rad/s, and
        acceleration (3), m/s2, both in B axes.
    """
    return roll_pitch_yaw(motion.R_WB), *felt_at(motion, p_BoImu_B)


class Imu(SampledSensor):
    """BNO055 on the car body: the reports of its fusion mode, with noise, bias, range, resolution,
    rate and delay.

    Gyro and accelerometer saturate per axis, the accelerometer on the specific force, gravity
    included; gravity is then taken off with the true attitude. White noise per sample, and one gyro
    bias per run. The chip's own slow errors of attitude in long turns are not modelled. IMU axes
    are body axes.

    Input ports:
        chassis_motion (20): motion of the chassis, see `CHASSIS_MOTION_SIZE`.
    Output ports:
        imu (9): roll, pitch, yaw rad; gyro rad/s; linear acceleration m/s2, in body axes
            (`signal_table.IMU`).
        sample_time (1): time of the sample, s, see `SampledSensor`.

    Args:
        settings: `scenario.imu`: rate Hz, delay s; standard deviations gyro_noise rad/s, gyro_bias
            rad/s, accelerometer_noise m/s2, attitude_noise rad.
        p_BoImu_B: position (3) of the IMU in the body, m.
        seed: seed of the run.
        step: step of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.
        gravity: acceleration of gravity, m/s2.
    """

    def __init__(
        self,
        settings: Any,
        *,
        p_BoImu_B: Sequence[float],
        seed: int,
        step: float,
        discrete: bool = False,
        gravity: float = 9.81,
    ) -> None:
        super().__init__(
            name="imu",
            outputs={"imu": IMU.size},
            rate=settings.rate,
            delay=settings.delay,
            discrete=discrete,
        )
        self._step = step
        self._p_BoImu_B = list(p_BoImu_B)
        self._gravity = gravity
        self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        self._noise = CounterNoise(seed, "imu", IMU.size)
        self._deviation = np.repeat(
            [settings.attitude_noise, settings.gyro_noise, settings.accelerometer_noise], 3
        )
        self._bias = self._noise.constant() * np.repeat([0.0, settings.gyro_bias, 0.0], 3)
        self._counts = 1.0 / STEPS

    def measure(self, context: Context, index: int) -> FloatArray:
        """Takes one sample (9,) of the body's motion."""
        motion = chassis_motion(vector_of(self._motion, context), self._step)
        angles, omega, acceleration = motion_at_imu(motion, self._p_BoImu_B)
        error = (self._bias + self._deviation * self._noise.at(index)).tolist()
        sample = [true + off for true, off in zip(angles, error[:3], strict=True)]
        sample += [
            min(max(true + off, -GYRO_RANGE), GYRO_RANGE)
            for true, off in zip(omega, error[3:6], strict=True)
        ]
        for true, off, upwards in zip(acceleration, error[6:], motion.R_WB[2], strict=True):
            reaction = self._gravity * upwards
            sample.append(min(max(true + off + reaction, -FORCE_RANGE), FORCE_RANGE) - reaction)
        return np.rint(np.array(sample) * self._counts) / self._counts


class GpsSpeed(SampledSensor):
    """Horizontal speed of the body origin, as a GPS receiver reports it: slow, late, noisy, without
    sign.

    speed = max(0, sqrt(vx^2 + vy^2) + noise): driving backwards reads positive. The lever arm from
    the body origin to the antenna is neglected.

    Input ports:
        chassis_motion (20): motion of the chassis, see `CHASSIS_MOTION_SIZE`.
    Output ports:
        speed (1): ground speed, m/s.
        sample_time (1): time of the sample, s, see `SampledSensor`.

    Args:
        settings: `scenario.gps`: rate Hz, delay s, noise m/s (standard deviation).
        seed: seed of the run.
        discrete: whether the plant is discrete, see `SampledSensor`.
    """

    def __init__(self, settings: Any, *, seed: int, discrete: bool = False) -> None:
        super().__init__(
            name="gps",
            outputs={"speed": 1},
            rate=settings.rate,
            delay=settings.delay,
            discrete=discrete,
        )
        self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        self._deviation = settings.noise
        self._noise = CounterNoise(seed, "gps", 1)

    def measure(self, context: Context, index: int) -> FloatArray:
        """Takes one sample (1,): speed in m/s."""
        v_x, v_y = vector_of(self._motion, context)[10:12]
        speed = math.hypot(v_x, v_y) + self._deviation * self._noise.at(index)[0]
        return np.array([max(0.0, speed)])


class SailEncoder(AngleEncoder):
    """Absolute magnetic encoder of the freely turning sail.

    A word of n bits has 2^n equal steps per turn; the reading is the step that the angle with its
    noise lies in, from 0 to below 2 pi (thesis 5.4.5 maps it to 0-360 degrees; 12 bit there, the
    named part has 10, ERRATA E30).

    Args:
        settings: `scenario.sail_encoder`: rate Hz, delay s, bits, noise rad (standard deviation
            before quantisation).
        seed: seed of the noise.
        discrete: whether the plant is discrete, see `SampledSensor`.
    """

    def __init__(
        self,
        settings: Any,
        *,
        seed: int = 0,
        discrete: bool = False,
    ) -> None:
        super().__init__("sail_encoder", settings.rate, settings.delay, RATE_WINDOW, discrete)
        self._steps = 2**settings.bits
        self._noise = CounterNoise(seed, "sail_encoder", 1)
        self._deviation = settings.noise

    def reading(self, angle: float, index: int) -> float:
        """See `AngleEncoder.reading`; in [0, 2 pi)."""
        noisy = angle + self._deviation * float(self._noise.at(index)[0])
        return noisy / TURN * self._steps // 1.0 % self._steps * (TURN / self._steps)


def quantise_symmetric(value: float, limit: float, bits: int) -> float:
    """Returns a value as read back from an unsigned word of `bits` that spans [-limit, limit].

    It is rounded to the nearest of 2^bits - 1 steps and clipped. The number of steps is odd, so
    zero itself cannot be sent: a motor at rest reports half a step.
    """
    step = 2.0 * limit / (2**bits - 1)
    return round((min(max(value, -limit), limit) + limit) / step) * step - limit


class MotorEncoder(SampledSensor):
    """Angle and speed of the two tail joints as their motors report them over the bus.

    The station puts `tail_state` together: angles, sail angle, rates and sail rate.

    Input ports:
        joints (4): angles of pitch and roll, rad, then their rates, rad/s.
    Output ports:
        angles (2): angles of pitch and roll, rad.
        rates (2): rates of pitch and roll, rad/s.
        sample_time (1): time of the sample, s, see `SampledSensor`.

    Args:
        rate: rate of the replies, one per command, Hz.
        motor: parameters of the motor, with the ranges of its reply.
        discrete: whether the plant is discrete, see `SampledSensor`.
    """

    def __init__(
        self,
        rate: float,
        motor: TailMotorParameters,
        *,
        discrete: bool = False,
    ) -> None:
        super().__init__(
            name="tail_encoders",
            outputs={"angles": 2, "rates": 2},
            rate=rate,
            delay=0.0,
            discrete=discrete,
        )
        self._joints = self.DeclareVectorInputPort("joints", 4)
        angle = (motor.position_range, POSITION_BITS)
        speed = (motor.speed_range, SPEED_BITS)
        self._words = (angle, angle, speed, speed)

    def measure(self, context: Context, index: int) -> FloatArray:
        """Takes one sample (4,)."""
        values = vector_of(self._joints, context).tolist()
        return np.array(
            [
                quantise_symmetric(value, *word)
                for value, word in zip(values, self._words, strict=True)
            ]
        )
