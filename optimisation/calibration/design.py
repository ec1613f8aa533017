"""What calibration runs tell about cars: the group at which each flips, and whether it meets a bracket of speeds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from optimisation.calibration.plan import Discrepancy
from optimisation.calibration.prior import Prior
from optimisation.calibration.runs import RunStore, Wanted, car_values, flips_in_the_turn, survives
from optimisation.sweep.engine import Engine
from workbench.published import FlipBracket, PublishedFigures

FloatArray = NDArray[np.float64]
Say = Callable[[str], None]

REACH_BELOW = 0.12
"""How far below the critical coordinate of the slow speed that of the fast one is searched; four times its median."""


@dataclass(frozen=True)
class Target:
    """What cars are held to.

    Attributes:
        tail_mode: of the runs.
        bracket: survived and flipped speed, m/s.
        published: metrics of the run at the survived speed; None if only the bracket counts.
        discrepancy: of the metrics.
    """

    tail_mode: str
    bracket: FlipBracket
    published: PublishedFigures | None
    discrepancy: dict[str, Discrepancy]

    @property
    def speeds(self) -> tuple[float, float]:
        """Survived, flipped, m/s."""
        return self.bracket.survived, self.bracket.flipped


@dataclass(frozen=True)
class Runner:
    """Store, engine and voice of a calibration."""

    store: RunStore
    engine: Engine
    say: Say

    def run(self, wanted: list[Wanted], what: str) -> pd.DataFrame:
        """Rows of runs, in their order."""
        return self.store.run(wanted, self.engine, lambda done, of: self.say(f"{what}: {done} of {of} runs"))


@dataclass(frozen=True)
class Design:
    """Critical groups of some cars.

    Attributes:
        coordinates: of the cars (m, n); the one of the group says nothing.
        slow, fast: last trial below and above the critical coordinate of the group at the two speeds (m, 2).
        searched: coordinates of the group that the search began with (m, 2).
        upright: coordinates of the runs that survived the slow speed (k, n).
        rows: of these runs.
        cars: number of the car of each of these runs (k).
    """

    coordinates: FloatArray
    slow: FloatArray
    fast: FloatArray
    searched: FloatArray
    upright: FloatArray
    rows: pd.DataFrame
    cars: NDArray[np.int64]

    @property
    def resolution(self) -> float:
        """Of the searches."""
        return float(np.median(self.slow[:, 1] - self.slow[:, 0]))

    @property
    def windows(self) -> FloatArray:
        """Coordinates of the group (m, 2) outside which the bracket is missed; NaN where no trial flipped fast.

        From the last trial that survived the fast speed to the first that flipped at the slow one.
        """
        empty = self.fast[:, 1] >= self.slow[:, 1]
        return np.where(empty[:, None], np.nan, np.column_stack([self.fast[:, 0], self.slow[:, 1]]))

    @property
    def found(self) -> NDArray[np.bool_]:
        """Cars whose slow search saw a survival and a flip (m): the others flip outside of what was searched."""
        return (self.slow[:, 0] > self.searched[:, 0]) & (self.slow[:, 1] < self.searched[:, 1])

    def merged(self, other: "Design") -> "Design":
        """Both."""
        pairs = zip(self._arrays, other._arrays, strict=True)
        coordinates, slow, fast, searched, upright = (np.vstack(pair) for pair in pairs)
        return Design(
            coordinates,
            slow,
            fast,
            searched,
            upright,
            pd.concat([self.rows, other.rows], ignore_index=True),
            np.concatenate([self.cars, other.cars + len(self.coordinates)]),
        )

    @property
    def _arrays(self) -> tuple[FloatArray, ...]:
        return self.coordinates, self.slow, self.fast, self.searched, self.upright


@dataclass(frozen=True)
class Evaluated:
    """Cars that were run at the speeds of a target.

    Attributes:
        coordinates: (m, n).
        slow, fast: rows of the runs at the survived and at the flipped speed.
    """

    coordinates: FloatArray
    slow: pd.DataFrame
    fast: pd.DataFrame

    @property
    def survive(self) -> NDArray[np.bool_]:
        """Which survive the slow speed (m)."""
        return survives(self.slow)

    @property
    def flip(self) -> NDArray[np.bool_]:
        """Which flip in the turn at the fast speed (m)."""
        return flips_in_the_turn(self.fast)

    @property
    def meet(self) -> NDArray[np.bool_]:
        """Which do both (m)."""
        return self.survive & self.flip

    def merged(self, other: "Evaluated") -> "Evaluated":
        """Both."""
        return Evaluated(
            np.vstack([self.coordinates, other.coordinates]),
            pd.concat([self.slow, other.slow], ignore_index=True),
            pd.concat([self.fast, other.fast], ignore_index=True),
        )


def critical_groups(
    target: Target,
    prior: Prior,
    cars: FloatArray,
    searched: FloatArray,
    halvings: tuple[int, int],
    step: float | None,
    runner: Runner,
) -> Design:
    """Searches the coordinate of the group at which each car flips, by bisection, at both speeds.

    Args:
        target: its tail mode and speeds.
        prior: of the cars.
        cars: (m, n).
        searched: coordinates of the group (m, 2) to begin with at the slow speed; the fast one is searched down from
            what the slow one found.
        halvings: at the slow and at the fast speed.
        step: of the plant, s; None for the default.
        runner: that runs them.
    """
    upright: list[FloatArray] = []
    rows: list[pd.DataFrame] = []
    numbers: list[NDArray[np.int64]] = []
    ends = searched
    found = []
    for speed, count in zip(target.speeds, halvings, strict=True):
        low, high = ends[:, 0], ends[:, 1]
        for halving in range(count):
            trial = cars.copy()
            trial[:, prior.leading] = middle = 0.5 * (low + high)
            values = car_values(prior.keys, prior.values(trial))
            wanted = [Wanted(car, target.tail_mode, speed, step) for car in values]
            done = runner.run(wanted, f"flip at {speed:g} m/s, halving {halving + 1} of {count}")
            flipped = flips_in_the_turn(done)
            low, high = np.where(flipped, low, middle), np.where(flipped, middle, high)
            if speed == target.speeds[0]:
                upright.append(trial[survives(done)])
                rows.append(done[survives(done)])
                numbers.append(np.flatnonzero(survives(done)))
        found.append(np.column_stack([low, high]))
        ends = np.column_stack([np.maximum(low - REACH_BELOW, 0.0), high])
    table = pd.concat(rows, ignore_index=True)
    return Design(cars, found[0], found[1], searched, np.vstack(upright), table, np.concatenate(numbers))


def run_cars(
    coordinates: FloatArray, prior: Prior, target: Target, runner: Runner, step: float | None = None
) -> Evaluated:
    """Runs cars (m, n) at the two speeds of a target; default step without `step`."""
    cars = car_values(prior.keys, prior.values(coordinates))
    wanted = [Wanted(car, target.tail_mode, speed, step) for speed in target.speeds for car in cars]
    rows = runner.run(wanted, f"cars with tail {target.tail_mode}")
    slow, fast = rows[: len(cars)], rows[len(cars) :]
    return Evaluated(coordinates, slow.reset_index(drop=True), fast.reset_index(drop=True))
