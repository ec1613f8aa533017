"""Complementary filter for roll and roll rate of the car from its IMU, as plain Python: it runs
without Drake too.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.scenario import Scenario


@dataclass(frozen=True)
class RollFilterSettings:
    """Numbers of the complementary filter.

    Args:
        rate: rate at which the filter is called, Hz.
        time_constant: time constant with which the accelerometer corrects the integrated gyro while
            the car drives calmly, s.
        trust_acceleration: linear acceleration at which the correction has half its weight, m/s2;
            beyond it the weight fades with the fourth power, so that a turn of 5 m/s2 keeps less
            than 1 % of it.
        gravity: acceleration of gravity, m/s2.
    """

    rate: float = 100.0
    time_constant: float = 1.0
    trust_acceleration: float = 1.5
    gravity: float = 9.81

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> Self:
        """Makes the settings of a car: the rate of its IMU, the gravity of its surroundings."""
        return cls(rate=scenario.imu.rate, gravity=scenario.environment.gravity or cls.gravity)


class RollEstimate(NamedTuple):
    """State of the filter.

    Args:
        roll: roll about body x after yaw and pitch, rad, positive to the right.
        pitch: pitch, rad, nose down positive.
        roll_rate: time derivative of roll, rad/s.
        started: 1 once a valid sample has been seen.
    """

    roll: float = 0.0
    pitch: float = 0.0
    roll_rate: float = 0.0
    started: float = 0.0


def estimate_roll(
    estimate: RollEstimate, imu: FloatArray, speed: float, settings: RollFilterSettings
) -> RollEstimate:
    """Ticks the filter once.

    The gyro is integrated through the kinematics of roll and pitch; the direction of gravity, taken
    from the accelerometer less the centripetal acceleration of a car that does not slip sideways,
    corrects slowly:

        d(roll)/dt  = p + tan(pitch) (q sin(roll) + r cos(roll))
        d(pitch)/dt = q cos(roll) - r sin(roll)
        f = a + g up
        (f_x, f_y - v r, f_z + v q) = g (-sin(pitch), sin(roll) cos(pitch), cos(roll) cos(pitch))

    `up` is the vertical that the chip itself used to take gravity off, from its own roll and pitch:
    putting it back gives what the accelerometer measured, whatever error that attitude has. In a
    hard turn the car slips and the GPS speed is late, so the correction fades with the linear
    acceleration and the gyro alone carries the estimate: its error then grows by the gyro bias
    (0.01 rad/s: 0.01 rad per second of turn) and by scale and sampling errors. The estimate is that
    of the instant of the sample, so it is late by the sample's age.

    Args:
        estimate: estimate of the tick before.
        imu: signals of the IMU (9), as `signal_table.IMU`. With a value that is not finite the
            angles are kept and the rate is 0.
        speed: forward speed, m/s; a value that is not finite counts as 0.
        settings: settings of the filter, the same at every tick.
    """
    roll_chip, pitch_chip, _, p, q, r, ax, ay, az = imu.tolist()
    if not math.isfinite(roll_chip + pitch_chip + p + q + r + ax + ay + az):
        return estimate._replace(roll_rate=0.0)
    if not math.isfinite(speed):
        speed = 0.0
    g = settings.gravity
    fx = ax - g * math.sin(pitch_chip)
    fy = ay + g * math.sin(roll_chip) * math.cos(pitch_chip) - speed * r
    fz = az + g * math.cos(roll_chip) * math.cos(pitch_chip) + speed * q
    roll_seen = math.atan2(fy, fz)
    pitch_seen = math.atan2(-fx, math.hypot(fy, fz))
    if not estimate.started:
        estimate = RollEstimate(roll_seen, pitch_seen, 0.0, 1.0)
    roll = estimate.roll
    pitch = estimate.pitch
    tan_pitch = math.sin(pitch) / max(math.cos(pitch), 0.1)
    roll_rate = p + tan_pitch * (q * math.sin(roll) + r * math.cos(roll))
    pitch_rate = q * math.cos(roll) - r * math.sin(roll)
    ratio = (ax * ax + ay * ay + az * az) / settings.trust_acceleration**2
    gain = 1.0 / (settings.rate * settings.time_constant * (1.0 + ratio * ratio))
    roll += roll_rate / settings.rate
    pitch += pitch_rate / settings.rate
    roll += gain * math.remainder(roll_seen - roll, 2.0 * math.pi)
    pitch += gain * (pitch_seen - pitch)
    return RollEstimate(math.remainder(roll, 2.0 * math.pi), pitch, roll_rate, 1.0)
