"""What calibration runs tell about cars: mu/SSF at which each flips, and whether it meets a bracket of speeds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.calibration.calibration_runs import (
    Datum,
    RunStore,
    Turn,
    Wanted,
    car_values,
    flips_in_the_turn,
    joined,
    log_likelihood,
    survives,
)
from aerodima.optimisation.calibration.car_prior import Prior
from aerodima.optimisation.calibration.surrogates import Edge, closeness
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.metrics.published_values import FlipBracket

TAIL_MODE = "none"
"""Of the runs of a target."""
SHARP = 0.003
"""Standard deviation of a critical mu/SSF that is known well enough."""
BELOW, BELOW_DEVIATION = 0.012, 0.006
"""Critical mu/SSF of the fast speed below that of the slow one, where no surrogate knows better."""
LEVELS = (np.arange(16) + 0.5) / 16
"""Places within a window at which it is asked whether a car is plausible."""
ENDS = (0.01, 0.99)
"""Quantiles of the critical coordinates at which a window ends."""


@dataclass(frozen=True)
class Target:
    """What cars without tail are held to.

    Attributes:
        bracket: survived and flipped speed, m/s.
        data: fitted figures of the run at the survived speed.
    """

    bracket: FlipBracket
    data: tuple[Datum, ...]

    @property
    def speeds(self) -> tuple[float, float]:
        """Survived, flipped, m/s."""
        return self.bracket.survived, self.bracket.flipped

    @property
    def turns(self) -> tuple[Turn, Turn]:
        """At these speeds."""
        return Turn(TAIL_MODE, self.bracket.survived), Turn(TAIL_MODE, self.bracket.flipped)


@dataclass(frozen=True)
class Runner:
    """Store and engine of a calibration, and where its progress is told."""

    store: RunStore
    engine: Engine
    progress: ProgressLine

    def run(self, wanted: list[Wanted], what: str) -> pd.DataFrame:
        """Rows of runs, in their order."""
        return self.store.run(wanted, self.engine, self.progress, what)


@dataclass(frozen=True)
class Design:
    """Critical mu/SSF of some cars.

    Attributes:
        coordinates: of the cars (m, n); the one of mu/SSF says nothing.
        edges: critical coordinate of mu/SSF at the two speeds (m, 2).
        deviations: of these (m, 2).
        windows: ends of the coordinate outside which the bracket is missed (m, 2); they lie a little outside
            of the edges, so that the bracket may be missed within as well.
        upright: coordinates of the runs that survived the slow speed (k, n).
        rows: of these runs.
        cars: number of the car of each of these runs (k).
    """

    coordinates: FloatArray
    edges: FloatArray
    deviations: FloatArray
    windows: FloatArray
    upright: FloatArray
    rows: pd.DataFrame
    cars: NDArray[np.int64]

    def merged(self, other: "Design") -> "Design":
        """Both."""
        return joined(self, replace(other, cars=other.cars + len(self.coordinates)))

    def kept(self, cars: NDArray[np.bool_]) -> "Design":
        """Only some of the cars."""
        places = np.flatnonzero(cars)
        runs = np.isin(self.cars, places)
        by_car = [array[places] for array in (self.coordinates, self.edges, self.deviations, self.windows)]
        rows = self.rows[runs].reset_index(drop=True)
        numbers = np.searchsorted(places, self.cars[runs])
        coordinates, edges, deviations, windows = by_car
        return Design(coordinates, edges, deviations, windows, self.upright[runs], rows, numbers)


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

    def log_likelihood(self, target: Target) -> FloatArray:
        """Log likelihood (m) of the target from the runs themselves, up to a constant; -inf where it is not met."""
        values = {datum.name: datum.values(self.slow) for datum in target.data}
        return np.where(self.meet, log_likelihood(target.data, values, len(self.coordinates)), -np.inf)

    def kept(self, cars: NDArray[np.bool_]) -> "Evaluated":
        """Only some of the cars."""
        slow, fast = (rows[cars].reset_index(drop=True) for rows in (self.slow, self.fast))
        return Evaluated(self.coordinates[cars], slow, fast)


def critical_ratios(
    target: Target,
    prior: Prior,
    cars: FloatArray,
    guess: tuple[Edge, FloatArray],
    pilots: tuple[int, int],
    step: float | None,
    runner: Runner,
) -> Design:
    """Searches the coordinate of mu/SSF at which each car flips at the two speeds of a target.

    Args:
        target: its speeds.
        prior: of the cars.
        cars: (m, n).
        guess: what is known before at the slow speed, and how far below it the fast one is expected (m).
        pilots: most runs per car at the slow and at the fast speed; a car that is known well enough takes fewer, but
            one at either; one that cannot be plausible where it flips takes no more.
        step: of the plant, s; None for the default.
        runner: that runs them.
    """
    slow, below = guess
    scale = prior.ratio_scale
    known: list[Edge] = []
    upright: list[FloatArray] = [np.empty((0, cars.shape[1]))]
    rows: list[pd.DataFrame] = []
    numbers: list[NDArray[np.int64]] = [np.empty(0, np.int64)]
    edge = slow
    for speed, count in zip(target.speeds, pilots, strict=True):
        for pilot in range(count):
            lowest, highest = _plausible_ends(prior, cars, edge, below)
            open_ = np.flatnonzero(((edge.deviation * scale > SHARP) | (pilot == 0)) & np.isfinite(lowest))
            if not len(open_):
                break
            trial = cars[open_].copy()
            trial[:, prior.leading] = np.clip(edge.middle, lowest, highest)[open_]
            values = car_values(prior.keys, prior.values(trial))
            wanted = [Wanted(car, TAIL_MODE, speed, step) for car in values]
            done = runner.run(wanted, f"flip at {speed:g} m/s, pilot {pilot + 1} of at most {count}")
            density = edge.log_density.copy()
            found = closeness(done, steering_end(prior.base))
            density[open_] = Edge(density[open_]).after(trial[:, prior.leading], found, scale).log_density
            edge = Edge(density)
            if speed == target.speeds[0]:
                upright.append(trial[survives(done)])
                rows.append(done[survives(done)])
                numbers.append(open_[survives(done)])
        known.append(edge)
        if len(known) == 1:
            edge = Edge.around(edge.middle - below, np.hypot(edge.deviation, BELOW_DEVIATION / scale))
    edges = np.column_stack([each.middle for each in known])
    deviations = np.column_stack([each.deviation for each in known])
    windows = np.column_stack([known[1].quantile(ENDS[0]), known[0].quantile(ENDS[1])])
    table = pd.concat(rows, ignore_index=True) if rows else pd.DataFrame()
    return Design(cars, edges, deviations, windows, np.vstack(upright), table, np.concatenate(numbers))


def _plausible_ends(prior: Prior, cars: FloatArray, edge: Edge, below: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least and largest coordinate (m), (m) of plausible cars where the bracket may be met; NaN for none."""
    low, high = (np.clip(edge.quantile(level), 0.0, 1.0) for level in ENDS)
    low = np.maximum(low - below, 0.0)
    places = np.stack([low + level * (high - low) for level in LEVELS])
    plausible = np.isfinite([prior.log_density_at(cars, place) for place in places])
    none = ~np.any(plausible, axis=0)
    least = np.min(np.where(plausible, places, np.inf), axis=0)
    largest = np.max(np.where(plausible, places, -np.inf), axis=0)
    return np.where(none, np.nan, least), np.where(none, np.nan, largest)


def run_through(
    coordinates: FloatArray, prior: Prior, target: Target, runner: Runner
) -> tuple[NDArray[np.bool_], Evaluated]:
    """Runs cars (m, n) at the slow speed, and those that survive it at the fast one: which meet it (m), and these."""
    cars = car_values(prior.keys, prior.values(coordinates))
    first, second = target.turns
    slow = runner.run([first.wanted(car) for car in cars], "drawn cars, slow")
    upright = survives(slow)
    left = [car for car, is_upright in zip(cars, upright, strict=True) if is_upright]
    fast = runner.run([second.wanted(car) for car in left], "drawn cars, fast")
    found = Evaluated(coordinates[upright], slow[upright].reset_index(drop=True), fast)
    meet = upright.copy()
    meet[upright] = found.meet
    return meet, found.kept(found.meet)


def steering_end(base: Scenario) -> float:
    """Time at which the turn's command goes straight again, s."""
    return float(base.manoeuvre.turn_start + base.manoeuvre.turn_hold)


def run_cars(
    coordinates: FloatArray, prior: Prior, target: Target, runner: Runner, step: float | None = None
) -> Evaluated:
    """Runs cars (m, n) at the two speeds of a target; default step without `step`."""
    slow, fast = run_turns(coordinates, prior, target.turns, runner, step).values()
    return Evaluated(coordinates, slow, fast)


def run_turns(
    coordinates: FloatArray, prior: Prior, turns: Sequence[Turn], runner: Runner, step: float | None = None
) -> dict[Turn, pd.DataFrame]:
    """Rows of cars (m, n) in some turns; default step without `step`."""
    cars = car_values(prior.keys, prior.values(coordinates))
    rows = runner.run([turn.wanted(car, step) for turn in turns for car in cars], "turns of possible cars")
    count = len(cars)
    return {turn: rows[k * count : (k + 1) * count].reset_index(drop=True) for k, turn in enumerate(turns)}
