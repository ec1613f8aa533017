"""Run logs made by hand: a straight run at 3 m/s in which every signal is zero unless a test says
otherwise.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.logs.schema import run_log_from_metadata, run_metadata
from aerodima.workbench.scenario.signal_table import (
    plant_position_columns,
    sensor_columns,
    truth_columns,
)

STEP = 0.002
DURATION = 4.0
SPEED = 3.0
GRAVITY = 9.81
TAIL_MASS = 0.15
COM_X = 0.12
"""Centre of mass of the car without tail arm ahead of the rear axle, m."""


both_sides = pytest.mark.parametrize(("direction", "side"), [("left", 1.0), ("right", -1.0)])
"""Runs a test with a turn to the left and to the right; `side` is the sign of its yaw rate."""


def car_run_columns(position_names=()):
    """The whole table of a simulated run with a tail."""
    return [*sensor_columns(), *truth_columns(), *plant_position_columns(position_names)]


def times():
    return np.arange(round(DURATION / STEP) + 1) * STEP


def made_up_scenario(direction="left", tail_mode="swing", **manoeuvre):
    return {
        "name": "made up",
        "manoeuvre": {
            "kind": "turn",
            "direction": direction,
            "turn_start": 2.0,
            "turn_hold": 0.5,
            "steer_angle": math.radians(30.0),
            "speed": SPEED,
            **manoeuvre,
        },
        "car": {"com_x": COM_X},
        "servo": {"rate": math.radians(30.0) / 0.14},
        "environment": {"gravity": GRAVITY},
        "tail": {"mode": tail_mode},
    }


def changed(log, **columns):
    """The log with other values in these columns."""
    return replace(log, table=log.table.assign(**columns))


def stating(**facts):
    """What gives a log with other values of these facts."""
    return lambda log: replace(log, extra={**log.extra, **facts})


def made_up_run(
    signals=None,
    direction="left",
    truth=True,
    tail_mode="swing",
    **manoeuvre,
):
    """A run of 4 s at 500 Hz, four loaded wheels, with these columns set."""
    columns = car_run_columns(("x", "y")) if truth else sensor_columns()
    table = pd.DataFrame({column.name: np.zeros(times().size) for column in columns})
    table["time_s"] = times()
    table["speed_m_per_s"] = SPEED
    if truth:
        table["velocity_x_truth_m_per_s"] = SPEED
        for wheel in ("front_left", "front_right", "rear_left", "rear_right"):
            table[f"wheel_force_{wheel}_z_truth_n"] = 15.0
    for name, values in (signals or {}).items():
        assert name in table.columns, name
        table[name] = values
    scenario = made_up_scenario(direction, tail_mode, **manoeuvre)
    return run_log_from_metadata(
        table, run_metadata(scenario, seed=7, extra={"tail_mass_kg": TAIL_MASS})
    )


def awkward_run(truth=False):
    """Signals that a text loses easily: neighbours of 1, the smallest number, minus zero, NaN."""
    run = made_up_run(
        {"imu_gyro_x_rad_per_s": np.nextafter(1.0, 2.0), "throttle_command": -0.0}, truth=truth
    )
    run.table.loc[3, "roll_estimate_rad"] = np.nan
    run.table["imu_gyro_z_rad_per_s"] = (
        np.random.default_rng(1).standard_normal(len(run.table)) * 1e-5
    )
    run.table.loc[4, "imu_gyro_y_rad_per_s"] = 5e-324
    return run


def signals_equal(a, b):
    """Whether two runs have the same columns in the same order with the same bits (NaN equals
    itself, 0 is not -0).
    """
    if list(a.table.columns) != list(b.table.columns) or len(a.table) != len(b.table):
        return False
    return all(a.signal(name).tobytes() == b.signal(name).tobytes() for name in a.table.columns)
