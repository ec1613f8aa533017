"""The curve of a swing: tail commands at any time from the knots of a swing file. Plain NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from aerodima.workbench.config.swing_file import JointGains, SwingFile


@dataclass(frozen=True)
class SwingPoint:
    """Tail commands at one time or at many; each has the shape of the times asked for. rad, rad/s, N m."""

    roll_position: NDArray[np.float64]
    roll_velocity: NDArray[np.float64]
    pitch_position: NDArray[np.float64]
    pitch_velocity: NDArray[np.float64]
    roll_torque: NDArray[np.float64]
    pitch_torque: NDArray[np.float64]


def swing_at(swing: SwingFile, time: ArrayLike, direction: Literal["left", "right"] | None = None) -> SwingPoint:
    """Positions, rates and feed-forward torques at times since the release.

    Positions are cubic Hermite polynomials through the knots, rates their derivatives, torques linear between knots.
    Before 0 the tail rests at the first knot, after the last knot at the last: rates and torques are then zero.

    Args:
        swing: the file.
        time: s, any shape.
        direction: turn to make; when it is not the one the file was made for, roll is mirrored.
    """
    t = np.asarray(time, dtype=np.float64)
    times = np.asarray(swing.knots.time_s)
    side = 1.0 if direction in (None, swing.direction) else -1.0
    roll, roll_rate = hermite(t, times, *swing.knots.states("roll"))
    pitch, pitch_rate = hermite(t, times, *swing.knots.states("pitch"))
    roll_torque = _torque(t, times, swing.knots.roll_torque_n_m)
    return SwingPoint(
        roll_position=side * roll,
        roll_velocity=side * roll_rate,
        pitch_position=pitch,
        pitch_velocity=pitch_rate,
        roll_torque=side * roll_torque,
        pitch_torque=_torque(t, times, swing.knots.pitch_torque_n_m),
    )


def gains_at(swing: SwingFile, time: float) -> tuple[JointGains, JointGains]:
    """Roll and pitch gains at a time since the release, s; before it the hold gains for both."""
    begun = [phase for phase in swing.gains.phases if phase.start_s <= time]
    return (begun[-1].roll, begun[-1].pitch) if begun else (swing.gains.hold, swing.gains.hold)


def hermite(
    t: NDArray[np.float64], times: NDArray[np.float64], position: NDArray[np.float64], velocity: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Value and derivative of the cubic Hermite interpolant; at rest outside the knots.

    Args:
        t: s, any shape.
        times: of the knots, s, strictly increasing, shape (n,).
        position: at the knots, shape (n,).
        velocity: at the knots, per second, shape (n,).
    """
    i = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    h = times[i + 1] - times[i]
    share = np.clip((t - times[i]) / h, 0.0, 1.0)
    value, rate = cubic(share, h, (position[i], position[i + 1]), (velocity[i], velocity[i + 1]))
    return value, np.where((t < times[0]) | (t > times[-1]), 0.0, rate)


def cubic(share: NDArray, h: NDArray, positions: tuple[NDArray, NDArray], velocities: tuple[NDArray, NDArray]) -> Any:
    """Value and derivative of the cubic between two knots; arrays of any shape, complex steps pass through.

    Args:
        share: of the interval that has gone by, 0 to 1.
        h: length of the interval, s.
        positions, velocities: at its two ends.
    """
    rise = positions[1] - positions[0]
    start, end = h * velocities[0], h * velocities[1]
    quadratic, third = 3.0 * rise - 2.0 * start - end, start + end - 2.0 * rise
    value = positions[0] + share * (start + share * (quadratic + share * third))
    return value, (start + share * (2.0 * quadratic + 3.0 * share * third)) / h


def _torque(
    t: NDArray[np.float64], times: NDArray[np.float64], torque: tuple[float, ...] | None
) -> NDArray[np.float64]:
    return np.zeros_like(t) if torque is None else np.interp(t, times, torque, left=0.0, right=0.0)
