"""Logs of cars that another program's single-track model drives, with its published parameters.

Both are Althoff and Wuersching, "CommonRoad: Vehicle Models" (2020), for the F1TENTH car of
f1tenth_gym: the single-track model with linear tyres (`vehicle_dynamics_st`), and the single-track
drift model with the lateral tyre of `parameters_tire.yaml`, whose wheels roll freely.
"""

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from aerodima.workbench.logs.schema import RunLog

G = 9.81
MASS = 3.74
YAW_INERTIA = 0.04712
FRONT = 0.15875
REAR = 0.17145
STEERING_RATE = 3.2
MU = 1.0489
"""Friction: of f1tenth_gym, and p_dy1 of CommonRoad."""
C_SF = 4.718
C_SR = 5.4562
"""Stiffness over friction and load, 1/rad, of f1tenth_gym."""
P_CY1 = 1.3507
P_EY1 = -0.0074722
P_KY1 = -21.92
BASE = FRONT + REAR


def linear_tyres(state, angle):
    """Rates of sideslip, yaw rate and speed: sections 7 of the paper, without acceleration."""
    beta, yaw_rate, speed = state
    front = C_SF * G * REAR
    rear = C_SR * G * FRONT
    turning = MU * MASS / (YAW_INERTIA * BASE)
    yaw = turning * (
        FRONT * front * angle
        + (REAR * rear - FRONT * front) * beta
        - (FRONT**2 * front + REAR**2 * rear) * yaw_rate / speed
    )
    sliding = MU / (speed * BASE)
    slip = sliding * (
        front * angle - (rear + front) * beta + (rear * REAR - front * FRONT) * yaw_rate / speed
    )
    return [slip - yaw_rate, yaw, 0.0]


def lateral_force(slip, load):
    """Magic formula for pure side slip, rad, without camber; section 9."""
    peak = MU * load
    x = load * P_KY1 / (P_CY1 * peak) * slip
    return peak * np.sin(P_CY1 * np.arctan(x - P_EY1 * (x - np.arctan(x))))


def drifting_tyres(state, angle):
    """Rates of sideslip, yaw rate and speed: section 8 of the paper, without longitudinal slip."""
    beta, yaw_rate, speed = state
    ahead = speed * np.cos(beta)
    aside = speed * np.sin(beta)
    front = lateral_force(
        np.arctan((aside + FRONT * yaw_rate) / ahead) - angle, MASS * G * REAR / BASE
    )
    rear = lateral_force(np.arctan((aside - REAR * yaw_rate) / ahead), MASS * G * FRONT / BASE)
    braking = (-front * np.sin(angle - beta) + rear * np.sin(beta)) / MASS
    yaw = (front * np.cos(angle) * FRONT - rear * REAR) / YAW_INERTIA
    turning = (front * np.cos(angle - beta) + rear * np.cos(beta)) / (MASS * speed)
    return [turning - yaw_rate, yaw, braking]


def driven(rates, scenario, speed, angle):
    """The log of a turn to the left from 1.0 to 1.6 s: time, steering, speed, yaw rate, lateral
    acceleration of the centre of mass, at 100 Hz.
    """
    time = np.arange(0.0, 2.2, 0.01)
    command = angle * ((time >= 1.0) & (time < 1.6))

    def steered(t):
        reached = min(angle, STEERING_RATE * max(t - 1.0, 0.0))
        return max(0.0, reached - STEERING_RATE * max(t - 1.6, 0.0))

    solution = solve_ivp(
        lambda t, x: rates(x, steered(t)),
        (0.0, 2.2),
        [0.0, 0.0, speed],
        t_eval=time,
        max_step=0.002,
        rtol=1e-8,
    )
    assert solution.success
    beta, yaw_rate, speeds = solution.y
    slopes = np.array([rates(x, steered(t)) for t, x in zip(time, solution.y.T, strict=True)]).T
    turned = speeds * (slopes[0] + yaw_rate)
    table = pd.DataFrame(
        {
            "time_s": time,
            "steering_command_rad": command,
            "speed_m_per_s": speeds,
            "imu_gyro_z_rad_per_s": yaw_rate,
            "imu_acceleration_y_m_per_s2": turned * np.cos(beta) + slopes[2] * np.sin(beta),
        }
    )
    return RunLog(table, scenario.resolved(), 1, kind="car_log", source="single_track.parquet")
