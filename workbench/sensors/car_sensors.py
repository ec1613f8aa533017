"""What the car feels of its chassis' motion: the BNO055 inertial measurement unit, and ground speed from GPS.

Both read one vector; the plant's own lists cost about 25 us each to read, since every body becomes a Python object.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.systems.framework import Context

from aerodima.workbench.aero.sail import rotation_rows
from aerodima.workbench.config.checked_files import STANDARD_GRAVITY
from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.sensors.sampled import CounterNoise, SampledSensor
from aerodima.workbench.systems.system_ports import vector_of

CHASSIS_MOTION_SIZE = 20
"""Quaternion w, x, y, z; position, m; angular velocity, rad/s, and velocity, m/s, in W; angular velocity and velocity
before the plant's last step; 0 before the first step of a run, when there is no acceleration yet, then 1."""


class ChassisMotion(NamedTuple):
    """Of a body: rows of R_WB (3, 3); in W angular velocity, rad/s, its change, rad/s2, and acceleration, m/s2 (3)."""

    R_WB: Sequence[Sequence[float]]
    w_WB: Sequence[float]
    alpha_WB: Sequence[float]
    a_WB: Sequence[float]


def chassis_motion(values: Any, step: float) -> ChassisMotion:
    """What a vector of `CHASSIS_MOTION_SIZE` says, for a plant of this step, s."""
    x = values.tolist()
    change = [x[19] * (x[7 + k] - x[13 + k]) / step for k in range(6)]
    return ChassisMotion(rotation_rows(x[:4]), x[7:10], change[:3], change[3:])


Vector = tuple[float, float, float]


GYRO_RANGE, FORCE_RANGE = math.radians(2000.0), 4.0 * STANDARD_GRAVITY
"""Where each axis of the BNO055 in fusion mode saturates (Bosch BST-BNO055-DS000): rad/s; m/s2, gravity included."""
STEPS = np.repeat([1.0 / 900.0, 1.0 / 900.0, 0.01], 3)
"""Its resolution: rad of the attitude, rad/s and m/s2 per count."""


def motion_of(X_WB: RigidTransform, V_WB: SpatialVelocity, A_WB: SpatialAcceleration) -> ChassisMotion:
    """Motion of a body B from its pose, its spatial velocity and acceleration at Bo, W axes."""
    R_WB: Any = X_WB.rotation().matrix()
    w, alpha, a = (vector.tolist() for vector in (V_WB.rotational(), A_WB.rotational(), A_WB.translational()))
    return ChassisMotion(R_WB.tolist(), w, alpha, a)


def motion_at_imu(motion: ChassisMotion, p_BoImu_B: Any) -> tuple[Vector, Vector, Vector]:
    """True motion that an IMU fixed to body B feels.

    a_WImu = a_WBo + alpha x p + omega x (omega x p), all turned into B axes. The acceleration is that of the point:
    the chip reports it with gravity removed ("linear acceleration").

    Args:
        motion: of the body.
        p_BoImu_B: position (3) of the IMU, m.

    Returns:
        Roll-pitch-yaw (3) of B in W, rad, yaw in (-pi, pi]; angular velocity (3), rad/s, and acceleration (3), m/s2,
        both in B axes.
    """
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = motion.R_WB

    def in_body(vector: Sequence[float]) -> Vector:
        x, y, z = vector
        return r00 * x + r10 * y + r20 * z, r01 * x + r11 * y + r21 * z, r02 * x + r12 * y + r22 * z

    wx, wy, wz = omega = in_body(motion.w_WB)
    ax, ay, az = in_body(motion.alpha_WB)
    x, y, z = in_body(motion.a_WB)
    px, py, pz = p_BoImu_B
    along = wx * px + wy * py + wz * pz
    square = wx * wx + wy * wy + wz * wz
    acceleration = (
        x + ay * pz - az * py + wx * along - square * px,
        y + az * px - ax * pz + wy * along - square * py,
        z + ax * py - ay * px + wz * along - square * pz,
    )
    roll_pitch_yaw = (math.atan2(r21, r22), math.asin(max(-1.0, min(1.0, -r20))), math.atan2(r10, r00))
    return roll_pitch_yaw, omega, acceleration


class Imu(SampledSensor):
    """BNO055 on the car body: what its fusion mode reports, with noise, bias, range, resolution, rate and delay.

    Gyro and accelerometer saturate per axis, the accelerometer on the specific force, gravity included; gravity is
    then taken off with the true attitude. White noise per sample, and one gyro bias per run. The chip's own slow
    errors of attitude in long turns are not modelled. IMU axes are body axes.

    Input ports:
        chassis_motion (20): see `CHASSIS_MOTION_SIZE`.
    Output ports:
        imu (9): roll, pitch, yaw rad; gyro rad/s; linear acceleration m/s2, in body axes (`signal_table.IMU`).
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.imu`: rate Hz, delay s; standard deviations gyro_noise rad/s, gyro_bias rad/s,
            accelerometer_noise m/s2, attitude_noise rad.
        p_BoImu_B: position (3) of the IMU in the body, m.
        seed: of the run.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.
        gravity: m/s2.

    Raises:
        UserError: rate or delay not allowed.
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
        outputs, rate, delay = {"imu": IMU.size}, settings.rate, settings.delay
        super().__init__(name="imu", outputs=outputs, rate=rate, delay=delay, step=step, discrete=discrete)
        self._step, self._p_BoImu_B = step, list(p_BoImu_B)
        self._gravity = gravity
        self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        self._noise = CounterNoise(seed, "imu", IMU.size)
        self._deviation = np.repeat([settings.attitude_noise, settings.gyro_noise, settings.accelerometer_noise], 3)
        self._bias = self._noise.constant() * np.repeat([0.0, settings.gyro_bias, 0.0], 3)
        self._counts = 1.0 / STEPS

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (9,) of the body's motion."""
        motion = chassis_motion(vector_of(self._motion, context), self._step)
        angles, omega, acceleration = motion_at_imu(motion, self._p_BoImu_B)
        error = (self._bias + self._deviation * self._noise.at(index)).tolist()
        sample = [true + off for true, off in zip(angles, error[:3], strict=True)]
        sample += [min(max(true + off, -GYRO_RANGE), GYRO_RANGE) for true, off in zip(omega, error[3:6], strict=True)]
        for true, off, upwards in zip(acceleration, error[6:], motion.R_WB[2], strict=True):
            reaction = self._gravity * upwards
            sample.append(min(max(true + off + reaction, -FORCE_RANGE), FORCE_RANGE) - reaction)
        return np.rint(np.array(sample) * self._counts) / self._counts


class GpsSpeed(SampledSensor):
    """Horizontal speed of the body origin, as a GPS receiver reports it: slow, late, noisy, without sign.

    speed = max(0, sqrt(vx^2 + vy^2) + noise): driving backwards reads positive. The lever arm from the body origin
    to the antenna is neglected.

    Input ports:
        chassis_motion (20): see `CHASSIS_MOTION_SIZE`.
    Output ports:
        speed (1): m/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.gps`: rate Hz, delay s, noise m/s (standard deviation).
        seed: of the run.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(self, settings: Any, *, seed: int, step: float, discrete: bool = False) -> None:
        outputs, rate, delay = {"speed": 1}, settings.rate, settings.delay
        super().__init__(name="gps", outputs=outputs, rate=rate, delay=delay, step=step, discrete=discrete)
        self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        self._deviation = settings.noise
        self._noise = CounterNoise(seed, "gps", 1)

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (1,): speed in m/s."""
        v_x, v_y = vector_of(self._motion, context)[10:12]
        speed = math.hypot(v_x, v_y) + self._deviation * self._noise.at(index)[0]
        return np.array([max(0.0, speed)])
