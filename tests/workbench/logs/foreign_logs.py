"""Foreign logs made up for the tests: a swing of the rig and a turn of the car, with the truth
beside them.
"""

import numpy as np
import pandas as pd

from aerodima.workbench.scenario.signal_table import rig_columns

WRENCH = tuple(
    column.name for column in rig_columns() if column.name.startswith(("force_", "torque_"))
)
RATE = 500.0
GAP = (9.0, 9.04)
"""The laboratory's program lost the samples between these times, s."""
DRIFT = np.array([0.02, -0.03, 0.04, 1e-3, -2e-3, 3e-3])
"""Drift of the six readings per second, N/s and N m/s; large beside the noise."""
NOISE = np.array([0.01, 0.01, 0.02, 5e-4, 5e-4, 5e-4])
HANGING_UNTIL, LIFTED_AT, RELEASED_AT, LENGTH = 3.0, 4.5, 5.0, 26.0


def swing_truth(time):
    """A tail that hangs, is lifted to 90 degrees, falls and swings out.

    At rest the wrench is zero: a zeroed sensor.
    """
    lift = 0.5 * (
        1 - np.cos(np.pi * np.clip((time - HANGING_UNTIL) / (LIFTED_AT - HANGING_UNTIL), 0, 1))
    )
    since = np.maximum(time - RELEASED_AT, 0.0)
    angle = (
        0.5 * np.pi * np.where(time < RELEASED_AT, lift, np.exp(-0.7 * since) * np.cos(4.0 * since))
    )
    moment = np.sin(angle)
    wrench = np.outer(moment, [0.5, -3.0, 0.0, 0.9, -0.2, 0.1]) + np.outer(
        1 - np.cos(angle), [0, 0, 2.5, 0, 0, 0]
    )
    table = pd.DataFrame(wrench, columns=list(WRENCH))
    table.insert(0, "current_a", np.where(time < RELEASED_AT, 2.0 * moment, 0.0))
    table.insert(0, "angle_rad", angle)
    table.insert(0, "time_s", time)
    return table


def swing_readings():
    """The truth with drift and noise, and with the gap, in our names and units."""
    time = np.arange(round(LENGTH * RATE) + 1) / RATE
    table = swing_truth(time)
    generator = np.random.default_rng(3)
    table[list(WRENCH)] += np.outer(time, DRIFT) + NOISE * generator.standard_normal((time.size, 6))
    table["current_a"] += 0.005 * generator.standard_normal(time.size)
    lost = (time > GAP[0] + 1e-9) & (time < GAP[1] - 1e-9)
    return table[~lost].reset_index(drop=True)


def write_laboratory_csv(path, table):
    """The same in the laboratory's names, units and signs (README, example 1): semicolons, decimal
    commas, a line of text first.
    """
    columns = pd.DataFrame(
        {
            "t_ms": table["time_s"] * 1e3,
            "Winkel": np.rad2deg(table["angle_rad"]),
            "Strom": table["current_a"] * 1e3,
            "Fx": table["force_x_n"],
            "Fy": -table["force_y_n"],
            "Fz": table["force_z_n"],
            "Mx": table["torque_x_n_m"] * 1e3,
            "My": -table["torque_y_n_m"] * 1e3,
            "Mz": table["torque_z_n_m"] * 1e3,
            "Temp": 21.4,
        }
    )
    text = columns.to_csv(sep=";", decimal=",", index=False)
    path.write_text("Wind tunnel, tail 1, major axis\n" + text, encoding="utf-8")


START = 1_700_000_000.0
"""The car's clock at the start, s since 1970."""
TURN = (15.0, 15.5)
YAW_RATE, CAR_SPEED = 2.0, 4.0
IMU_RATE, GPS_RATE, GPS_LATE = 100.0, 10.0, 0.055


def car_files(folder):
    """A left turn with yaw rate 2 rad/s and lateral acceleration v r, as IMU and GPS files (README,
    example 2).
    """
    time = np.arange(round(18.0 * IMU_RATE) + 1) / IMU_RATE
    rate = np.where((time >= TURN[0]) & (time < TURN[1] + 0.14), YAW_RATE, 0.0)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / IMU_RATE])
    imu = pd.DataFrame(
        {
            "stamp": START + time,
            "roll": np.where(rate > 0, 5.0, 0.0),
            "pitch": 0.0,
            "heading": np.mod(350.0 - np.rad2deg(yaw), 360.0),
            "gx": 0.0,
            "gy": 0.0,
            "gz": np.rad2deg(rate),
            "ax": 0.0,
            "ay": CAR_SPEED * rate / 9.80665,
            "az": 0.0,
            "steer": np.where((time >= TURN[0]) & (time < TURN[1]), 30.0, 0.0),
        }
    )
    gps_time = np.arange(round(17.9 * GPS_RATE)) / GPS_RATE + GPS_LATE
    gps = pd.DataFrame(
        {
            "stamp": START + gps_time,
            "speed": 3.6 * CAR_SPEED + 0.36 * np.minimum(gps_time - 10.0, 0.0),
        }
    )
    imu.to_csv(folder / "imu.csv", index=False)
    gps.to_csv(folder / "gps.csv", index=False)
