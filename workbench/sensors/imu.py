"""The BNO055 inertial measurement unit: attitude, angular velocity and linear acceleration of the car body."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from aerodima.workbench.config.signal_table import IMU
from aerodima.workbench.sensors.chassis_motion import CHASSIS_MOTION_SIZE, ChassisMotion, chassis_motion
from aerodima.workbench.sensors.sampled import SampledSensor
from aerodima.workbench.systems.noise import CounterNoise

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class ImuRange:
    """Ranges and resolutions of the chip; the defaults are the BNO055 in fusion mode (Bosch BST-BNO055-DS000).

    Args:
        gyro: rad/s, each axis saturates here (2000 deg/s).
        specific_force: m/s2, each accelerometer axis, gravity included, saturates here (4 g of 9.80665 m/s2).
        angle_step: rad per count of the attitude (900 counts per rad).
        gyro_step: rad/s per count (900 counts per rad/s).
        acceleration_step: m/s2 per count (100 counts per m/s2).
    """

    gyro: float = math.radians(2000.0)
    specific_force: float = 4.0 * 9.80665
    angle_step: float = 1.0 / 900.0
    gyro_step: float = 1.0 / 900.0
    acceleration_step: float = 0.01


BNO055 = ImuRange()

PLANT_PORTS = {
    "body_poses": Value[list[RigidTransform]](),
    "body_spatial_velocities": Value[list[SpatialVelocity]](),
    "body_spatial_accelerations": Value[list[SpatialAcceleration]](),
}
"""Of a plant, with the motion of all its bodies."""


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
        body_poses: list[RigidTransform], from the plant.
        body_spatial_velocities: list[SpatialVelocity], from the plant.
        body_spatial_accelerations: list[SpatialAcceleration], from the plant.
        chassis_motion (20): in place of these three where `body_index` is None, see `chassis_motion`.
    Output ports:
        imu (9): roll, pitch, yaw rad; gyro rad/s; linear acceleration m/s2, in body axes (`signal_table.IMU`).
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.imu`: rate Hz, delay s; standard deviations gyro_noise rad/s, gyro_bias rad/s,
            accelerometer_noise m/s2, attitude_noise rad.
        body_index: of the car body in the plant; None for a vector that has its motion.
        p_BoImu_B: position (3) of the IMU in the body, m.
        seed: of the run.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.
        gravity: m/s2.
        limits: range and resolution of the chip.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(
        self,
        settings: Any,
        *,
        body_index: BodyIndex | int | None,
        p_BoImu_B: np.ndarray,
        seed: int,
        step: float | None = None,
        discrete: bool = False,
        gravity: float = 9.81,
        limits: ImuRange = BNO055,
    ) -> None:
        super().__init__(
            name="imu",
            outputs={"imu": IMU.size},
            rate=settings.rate,
            delay=settings.delay,
            step=step,
            discrete=discrete,
        )
        self._body, self._step = body_index, step
        self._p_BoImu_B = np.array(p_BoImu_B, dtype=float).tolist()
        self._gravity = gravity
        self._limits = limits
        if body_index is None:
            self._motion = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        else:
            self._poses, self._velocities, self._accelerations = (
                self.DeclareAbstractInputPort(name, value) for name, value in PLANT_PORTS.items()
            )
        self._noise = CounterNoise(seed, "imu", IMU.size)
        self._deviation = np.repeat([settings.attitude_noise, settings.gyro_noise, settings.accelerometer_noise], 3)
        self._bias = self._noise.constant() * np.repeat([0.0, settings.gyro_bias, 0.0], 3)
        self._counts = 1.0 / np.repeat([limits.angle_step, limits.gyro_step, limits.acceleration_step], 3)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        settings: Any,
        *,
        plant: MultibodyPlant,
        body: RigidBody,
        p_BoImu_B: np.ndarray,
        seed: int,
        motion: OutputPort | None = None,
    ) -> "Imu":
        """Adds the IMU on a body of a plant and connects it; step and gravity are the plant's.

        `motion` gives the body's motion in the plant's place, see `chassis_motion`.
        """
        imu = cls(
            settings,
            body_index=body.index() if motion is None else None,
            p_BoImu_B=p_BoImu_B,
            seed=seed,
            step=plant.time_step() or None,
            discrete=plant.time_step() > 0.0,
            gravity=-float(plant.gravity_field().gravity_vector()[2]),
        )
        builder.AddSystem(imu)
        sources = (
            {name: plant.GetOutputPort(name) for name in PLANT_PORTS} if motion is None else {"chassis_motion": motion}
        )
        for name, source in sources.items():
            builder.Connect(source, imu.GetInputPort(name))
        return imu

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (9,) of the body's motion."""
        motion = self._body_motion(context)
        angles, omega, acceleration = motion_at_imu(motion, self._p_BoImu_B)
        error = (self._bias + self._deviation * self._noise.at(index)).tolist()
        gyro, force = self._limits.gyro, self._limits.specific_force
        sample = [true + off for true, off in zip(angles, error[:3], strict=True)]
        sample += [min(max(true + off, -gyro), gyro) for true, off in zip(omega, error[3:6], strict=True)]
        for true, off, upwards in zip(acceleration, error[6:], motion.R_WB[2], strict=True):
            reaction = self._gravity * upwards
            sample.append(min(max(true + off + reaction, -force), force) - reaction)
        return np.rint(np.array(sample) * self._counts) / self._counts

    def _body_motion(self, context: Context) -> ChassisMotion:
        if self._body is None:
            return chassis_motion(self._motion.Eval(context), self._step or math.nan)
        index = int(self._body)
        poses: Any = self._poses.Eval(context)
        velocities: Any = self._velocities.Eval(context)
        accelerations: Any = self._accelerations.Eval(context)
        return motion_of(poses[index], velocities[index], accelerations[index])
