"""Log of a car that another program's single-track model drives: that of f1tenth_gym with its own
car, the single-track model with linear tyres (`vehicle_dynamics_st`) of Althoff and Wuersching,
"CommonRoad: Vehicle Models" (2020).
"""

import numpy as np
import pandas as pd
from scipy.signal import lsim

from aerodima.workbench.logs.schema import RunLog

G = 9.81
MASS = 3.74
YAW_INERTIA = 0.04712
FRONT = 0.15875
REAR = 0.17145
STEERING_RATE = 3.2
MU = 1.0489
C_SF = 4.718
C_SR = 5.4562
"""Stiffness over friction and load, 1/rad."""


def driven(scenario, speed, angle):
    """The log of a turn to the left from 1.0 to 1.6 s: time, steering, speed, yaw rate, lateral
    acceleration of the centre of mass, at 100 Hz. At constant speed the model is linear (section 7
    of the paper) in sideslip and yaw rate.
    """
    sliding = MU * G / (speed * (FRONT + REAR)) * np.array([C_SF * REAR, C_SR * FRONT])
    turning = MASS * speed / YAW_INERTIA * sliding * [FRONT, -REAR]
    arms = np.array([FRONT, -REAR]) / speed
    rates = np.array([[-sliding.sum(), -sliding @ arms - 1.0], [-turning.sum(), -turning @ arms]])
    steering = np.array([[sliding[0]], [turning[0]]])
    acceleration = speed * (rates[0] + [0.0, 1.0])
    outputs = [[0.0, 1.0], acceleration], [[0.0], speed * steering[0]]
    time = np.arange(0.0, 2.2, 0.0005)
    reached = angle / STEERING_RATE
    angles = np.interp(time, [1.0, 1.0 + reached, 1.6, 1.6 + reached], [0.0, angle, angle, 0.0])
    _, motion, _ = lsim((rates, steering, *outputs), angles, time)
    table = pd.DataFrame(
        {
            "time_s": time,
            "steering_command_rad": angle * ((time >= 1.0) & (time < 1.6)),
            "speed_m_per_s": speed,
            "imu_gyro_z_rad_per_s": motion[:, 0],
            "imu_acceleration_y_m_per_s2": motion[:, 1],
        }
    )
    table = table.iloc[::20].reset_index(drop=True)
    return RunLog(table, scenario.resolved(), 1, kind="car_log", source="single_track.parquet")
