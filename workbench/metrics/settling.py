"""When a car has settled after its turn: nothing of the turn is left to happen.

A car with its tail held to one side goes on along a wide curve, 0.01 to 0.065 rad/s at 4.5 m/s. So a heading change
that is taken at the end of a log depends on the length of the log; taken where the car has settled it is that of the
turn.
"""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import TIME, WHEELS
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.metrics.turn_signals import LOADED_FORCE

EXIT_YAW_RATE = 0.1
"""rad/s; a car that yaws less, its wheels straight, has left the turn. A large tail to one side alone gives 0.065."""
CALM_FOR = 0.1
"""So long must everything have been calm, s: a third of a period of roll on the suspension."""

CALM = {
    "gyro_x_truth_rad_per_s": 0.15,
    "gyro_y_truth_rad_per_s": 0.15,
    "gyro_z_truth_rad_per_s": EXIT_YAW_RATE,
    "velocity_y_truth_m_per_s": 0.2,
    "tilt_truth_rad": math.radians(3.0),
    "tail_pitch_rate_rad_per_s": 0.3,
    "tail_roll_rate_rad_per_s": 0.3,
}
"""Largest magnitudes of a calm row. All wheels bear load in it too, and the law neither swings nor is about to."""

CALM_SPIN = math.hypot(*(limit for name, limit in CALM.items() if name.startswith("gyro")))
"""A car that turns faster than this, rad/s, about whatever axis, is not calm."""

_LOADS = tuple(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS)
_STATE = "controller_state"
_BUSY = (SwingState.DELAY, SwingState.SWING)
_ROUNDING = 1e-9
"""s."""


def settled_row(table: pd.DataFrame | Mapping[str, FloatArray], turn_end: float) -> int | None:
    """First row of a run's table at which the car has been calm for `CALM_FOR`; None if it never was.

    None too where the table lacks a column, as that of a real car does.

    Args:
        table: columns as in a run log.
        turn_end: when the wheels are straight again, s.
    """
    if not {*CALM, *_LOADS, _STATE} <= set(table):
        return None
    time = np.asarray(table[TIME])
    calm = (time >= turn_end) & ~np.isin(table[_STATE], _BUSY)
    for name, limit in CALM.items():
        calm &= np.abs(np.asarray(table[name])) <= limit
    for name in _LOADS:
        calm &= np.asarray(table[name]) > LOADED_FORCE
    restless = np.maximum.accumulate(np.where(calm, turn_end, time))
    settled = time - restless >= CALM_FOR - _ROUNDING
    return int(np.argmax(settled)) if settled.any() else None
