"""Where a car begins to flip, as far as its runs tell: a density of the critical group of each car.

A run tells more than whether the car flipped. Near the critical group the car comes to rest at the tipping point, or
leaves it exponentially: a roll that stops short of it lacks an energy that grows with the distance to the critical
group, and a flip takes the longer the smaller that distance is. Both give the distance within a factor of about two, so
two or three runs find a critical group where bisection would take six.

The estimates only say where a car is run next. What is run there counts by its own outcome.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import log_ndtr

from aerodima.optimisation.calibration.calibration_runs import flips_in_the_turn, survives
from aerodima.workbench.config.array_types import FloatArray

GRID = np.linspace(-0.3, 1.3, 1601)
"""Critical coordinates that densities are kept at; a car may flip outside of what its group may be."""

TIPPING = 0.655
STIFFNESS = 0.04
"""Group = -STIFFNESS (TIPPING - peak roll)^2 below the critical one; fitted to 350 survivors of 89 cars whose critical
groups had been found by bisection, as are the constants below."""
GROWTH = 3.1
FIRST = -3.4
"""Logarithm of the distance above it = FIRST - GROWTH (time of the flip - end of the steering command)."""
FAR = 0.02
"""Distance beyond which roll and time tell no more than that it is larger."""
EARLY, FLAT = 0.2, 0.06
"""Flips within this time (s) and rolls below this angle (rad) are far."""
FACTOR = 0.65
"""Standard deviation of the logarithm of a distance."""
NEVER = -60.0
"""Logarithm that stands for impossible."""


@dataclass(frozen=True)
class Closeness:
    """How far runs were from the critical group.

    Attributes:
        side: 1 where the critical group lies above that of the run, -1 below, 0 where the run says nothing (m).
        distance: of the group (m); a lower bound where `is_far`.
        is_far: (m).
    """

    side: NDArray[np.int64]
    distance: FloatArray
    is_far: NDArray[np.bool_]


def closeness(rows: pd.DataFrame, steering_end: float) -> Closeness:
    """Reads runs; a car that tips over before its turn is far above.

    Args:
        rows: of the runs.
        steering_end: time at which the command goes straight again, s.
    """
    survived, flipped = survives(rows), flips_in_the_turn(rows)
    tipped = np.asarray(rows["outcome"] == "flipped", bool) & ~flipped
    roll = _numbers(rows, "peak_roll_rad", TIPPING)
    late = _numbers(rows, "stopped_at_flip_s", steering_end + 1.5) - steering_end
    below = STIFFNESS * np.maximum(TIPPING - roll, 0.05) ** 2
    above = np.exp(FIRST - GROWTH * late)
    side = np.where(survived, 1, np.where(flipped | tipped, -1, 0))
    is_far = np.where(survived, roll < FLAT, (late < EARLY) | tipped)
    return Closeness(side, np.where(is_far, FAR, np.where(survived, below, above)), is_far)


@dataclass(frozen=True)
class Edge:
    """Densities of the critical coordinates of cars.

    Attributes:
        log_density: over `GRID`, up to a constant per car (m, k).
    """

    log_density: FloatArray

    @classmethod
    def around(cls, middle: FloatArray, deviation: FloatArray) -> "Edge":
        """What a surrogate says: its prediction (m) and its error (m), with the tails of Student's t (5 degrees)."""
        z = (GRID - middle[:, None]) / deviation[:, None]
        return cls(-3.0 * np.log1p(z**2 / 5.0))

    def after(self, trial: FloatArray, found: Closeness, scale: float) -> "Edge":
        """What is known after one more run of each car at the coordinate `trial` (m).

        Args:
            trial: coordinate of the group of the run.
            found: in it.
            scale: of the group over its coordinate.
        """
        gap = scale * found.side[:, None] * (GRID - trial[:, None])
        z = np.log(np.maximum(gap, 1e-5) / found.distance[:, None]) / FACTOR
        near = -2.5 * np.log1p(z**2 / 4.0)
        likelihood = np.where(gap > 0.0, np.where(found.is_far[:, None], log_ndtr(z), near), NEVER)
        return Edge(self.log_density + np.where(found.side[:, None] == 0, 0.0, likelihood))

    def quantile(self, level: float) -> FloatArray:
        """Quantile (m) of each car's critical coordinate."""
        density = np.exp(self.log_density - np.max(self.log_density, axis=1, keepdims=True))
        cumulative = np.cumsum(density, axis=1)
        cumulative /= cumulative[:, -1:]
        return np.array([np.interp(level, row, GRID) for row in cumulative])

    @property
    def middle(self) -> FloatArray:
        """Median (m)."""
        return self.quantile(0.5)

    @property
    def deviation(self) -> FloatArray:
        """Half of the middle two thirds (m)."""
        return 0.5 * (self.quantile(0.84) - self.quantile(0.16))


def _numbers(rows: pd.DataFrame, name: str, otherwise: float) -> FloatArray:
    if name not in rows:
        return np.full(len(rows), otherwise)
    return np.asarray(pd.to_numeric(rows[name], errors="coerce").fillna(otherwise), float)
