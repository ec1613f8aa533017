"""A swing with another release and another shape: the handful of changes that a polish searches.

    yaw rate of the release x exp(0.15 x_0),   duration x exp(0.15 x_1),   roll + 0.25 rad x_k,   pitch + 0.3 rad x_k

Roll and pitch are moved at `PLACES` of the movement and smoothly between.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import PchipInterpolator

from aerodima.optimisation.fit.fit_errors import SwingError
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.swing_file import SwingFile, swing_from_dict

PLACES = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Where roll is moved, as shares of the movement's duration; pitch also where it begins."""
RELEASE, DURATION, ROLL, PITCH = 0.15, 0.15, 0.25, 0.3
"""What one unit of a change is: logarithms, rad."""
AT_REST = 0.02
"""Share of its largest rate below which the tail counts as arrived."""


def changes(dof: int) -> int:
    """Number of changes that are searched."""
    return 2 + len(PLACES) + (1 + len(PLACES) if dof == 2 else 0)


def changed(swing: SwingFile, x: FloatArray, dof: int = 1) -> SwingFile:
    """A swing with other release and shape; feed-forward torques and feedback, which no longer fit, are left out.

    Args:
        swing: released by a yaw rate.
        x: changes, (`changes(dof)`,), in their units.
        dof: 2 moves pitch too.

    Raises:
        SwingFileError: the changed swing leaves its own limits.
        SwingError: the swing is released by something else.
    """
    threshold = swing.trigger.threshold_rad_per_s
    if threshold is None:
        raise SwingError(f"swing {swing.name}: trigger.kind: {swing.trigger.kind!r}; a polish knows: yaw_rate")
    time = np.array(swing.knots.time_s) * math.exp(DURATION * x[1])
    roll, rate = swing.knots.states("roll")
    moving = np.flatnonzero(np.abs(rate) > AT_REST * np.max(np.abs(rate)))
    end = float(time[min(int(moving[-1]) + 1, len(time) - 1)])
    side = 1.0 if swing.direction == "left" else -1.0
    offset = ROLL * np.concatenate([[0.0], x[2 : 2 + len(PLACES)]])
    roll = roll + side * _offset(time, end, offset)
    limit = swing.limits.roll_position_rad
    roll = np.clip(roll, -min(limit, math.pi / 2), min(limit, math.pi / 2))
    pitch, pitch_rate = swing.knots.states("pitch")
    if dof == 2:
        pitch = pitch + _offset(time, end, PITCH * x[2 + len(PLACES) :])
        pitch = np.clip(pitch, -swing.limits.pitch_position_rad, swing.limits.pitch_position_rad)
    data = swing.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["trigger"]["threshold_rad_per_s"] = float(round(threshold * math.exp(RELEASE * x[0]), 9))
    data["knots"] = {
        "time_s": _row(time),
        "roll_position_rad": _row(roll),
        "roll_velocity_rad_per_s": _row(_rates(time, roll)),
        "pitch_position_rad": _row(pitch),
        "pitch_velocity_rad_per_s": _row(_rates(time, pitch) if dof == 2 else pitch_rate),
    }
    data["gains"].pop("feedback", None)
    return swing_from_dict(data, swing.name)


def _offset(time: FloatArray, end: float, values: FloatArray) -> FloatArray:
    """Smooth offsets through `values` at the start and at `PLACES` of the movement, constant after it."""
    curve = PchipInterpolator(end * np.concatenate([[0.0], PLACES]), values)
    return np.asarray(curve(np.minimum(time, end)))


def _rates(time: FloatArray, angle: FloatArray) -> FloatArray:
    """Rates at the knots whose curve stays between the knots; at rest at both ends."""
    rates = np.asarray(PchipInterpolator(time, angle).derivative()(time))
    rates[0] = rates[-1] = 0.0
    return rates


def _row(values: FloatArray) -> list[float]:
    return [float(value) for value in np.round(values, 9) + 0.0]
