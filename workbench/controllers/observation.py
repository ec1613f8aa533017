"""From the station's signals to what a tail law sees, for the Drake system and for the plain loop alike. No Drake."""

import math
from typing import Any

import numpy as np

from aerodima.workbench.config.signal_table import IMU, STATUS, TAIL_STATE
from aerodima.workbench.controllers.tail_law import UNKNOWN_IMU, Observation

AGE_LIMIT = 0.1
"""s; beyond this a signal counts as silent."""


def observe(
    time: float,
    tail_state: np.ndarray,
    imu: np.ndarray,
    status: np.ndarray,
    planned_turn: float,
    speed: np.ndarray | None,
    age_limit: float = AGE_LIMIT,
    *,
    steering_angle: float = math.nan,
) -> Observation:
    """What a law is given at `time` s; a signal that is older than `age_limit` s or has a fault code is unknown.

    A GPS is late by nature: its speed counts until its fault code is set. `speed` is None where there is none.
    `steering_angle` is the driver's command, rad.
    """
    roll_known, pitch_known, imu_valid = (_fresh(status, age, age_limit) for age in (ROLL_AGE, PITCH_AGE, IMU_AGE))
    speed_known = speed is not None and status[SPEED_FAULT] == 0.0
    known: Any = speed
    return Observation(
        time=time,
        yaw_rate=float(imu[GYRO_Z]),
        roll_angle=float(tail_state[ROLL_ANGLE]) if roll_known else math.nan,
        pitch_angle=float(tail_state[PITCH_ANGLE]) if pitch_known else math.nan,
        planned_turn=planned_turn,
        imu_valid=imu_valid,
        roll_rate=float(tail_state[ROLL_RATE]) if roll_known else math.nan,
        pitch_rate=float(tail_state[PITCH_RATE]) if pitch_known else math.nan,
        imu=tuple(imu.tolist()) if imu_valid else UNKNOWN_IMU,
        speed=float(known[0]) if speed_known else math.nan,
        steering_angle=steering_angle,
    )


def _fresh(status: np.ndarray, age_index: int, age_limit: float) -> bool:
    """False for NaN too; the fault code stands right behind the age."""
    return bool(status[age_index] <= age_limit and status[age_index + 1] == 0.0)


GYRO_Z = IMU.index("gyro_z")
ROLL_ANGLE, PITCH_ANGLE, ROLL_RATE, PITCH_RATE = (
    TAIL_STATE.index(name) for name in ("roll_angle", "pitch_angle", "roll_rate", "pitch_rate")
)
SPEED_FAULT = STATUS.index("speed_fault")
ROLL_AGE, PITCH_AGE, IMU_AGE = (STATUS.index(f"{source}_age") for source in ("tail_roll", "tail_pitch", "imu"))
