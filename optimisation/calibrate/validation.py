"""Tests of a calibration: each table predicted from the others, posterior cars that play the
thesis, information.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import eigh
from scipy.special import logsumexp
from scipy.stats import norm, t

from aerodima.optimisation.calibrate.calibration import Posterior, log_density, sample, spread_of
from aerodima.optimisation.calibrate.calibration_plan import (
    DISCREPANCY,
    ROLL_DISCREPANCY,
    SLIP,
    CarPrior,
    Figure,
    figures_of,
)
from aerodima.optimisation.calibrate.surrogate import Surrogate
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.batch.row_store import Row, content_key
from aerodima.workbench.core.array_types import FloatArray, Values
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario

TRIES = 10_000
"""Largest number of posterior cars that are drawn to find one that survives every turn with a
table."""
DRAWS = 400
"""Number of outcomes of a measurement that are drawn for its information."""
BAND = (0.05, 0.5, 0.95)
"""Quantiles of a 90 % interval and its median."""


@dataclass(frozen=True)
class LeftOut:
    """One table predicted without its own figures.

    Attributes:
        table: name of the table.
        rows: row of each figure: `figure`, `published`, `low`, `median`, `high`, `prior_low`,
            `prior_high`, `inside`.
        density: logarithm of the joint density of the figures, per share of each, by the cars that
            the other tables leave.
        prior_density: the same by cars of the prior that survive the turn.
        constant_density: the same by a model that takes each figure from the other tables' values.
    """

    table: str
    rows: list[Row]
    density: float
    prior_density: float
    constant_density: float


class Question(NamedTuple):
    """A table that is to be predicted from the figures of the others, by cars of a prior inside the
    surrogate's.
    """

    surrogate: Surrogate
    figures: Sequence[Figure]
    table: str
    seed: int
    prior: CarPrior | None = None


def predictions(questions: Sequence[Question], runs: CachedRunner) -> list[LeftOut]:
    """Answers each question with `leave_out`, each once."""
    import joblib  # type: ignore[import-untyped]

    # Unlike a pickle, this hash does not depend on the order of sets, which every process has anew.
    keys = [content_key("leave_out", joblib.hash(question)) for question in questions]
    return [LeftOut(**row) for row in runs.map(_answer, questions, keys)]


def _answer(question: Question) -> Row:
    return vars(leave_out(question))


def leave_out(question: Question) -> LeftOut:
    """Predicts a table from the figures of the others."""
    surrogate, figures, table, seed, prior = question
    own = [figure for figure in figures if figure.turn.table == table]
    others = [figure for figure in figures if figure not in own]
    cars = sample(surrogate, others, seed, prior).cars
    drawn = surrogate.prior.draw(len(cars), seed)
    # Cars are chosen by their probability of surviving the turn, as the published car did.
    weight = surrogate.survival(drawn, own[0].turn)
    chosen = np.random.default_rng(seed).choice(len(cars), len(cars), p=weight / weight.sum())
    survivors = drawn[chosen]
    rng = np.random.default_rng(seed)
    rows = []
    for figure in own:
        row: Row = {"figure": figure.name, "published": figure.published}
        band = np.quantile(predicted(surrogate, figure, cars, rng), BAND)
        prior_band = np.quantile(predicted(surrogate, figure, survivors, rng), BAND)
        row["low"], row["median"], row["high"] = band.tolist()
        row["prior_low"], _, row["prior_high"] = prior_band.tolist()
        row["inside"] = row["low"] <= figure.published <= row["high"]
        rows.append(row)
    known = joint_density(surrogate, own, cars)
    guessed = joint_density(surrogate, own, survivors)
    return LeftOut(table, rows, known, guessed, _constant(own, figures))


def predicted(
    surrogate: Surrogate, figure: Figure, cars: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draws values (m) of a figure that the thesis would have printed for cars (m, n)."""
    values = surrogate.value(cars, figure)
    return values + spread_of(surrogate, figure, cars, values) * rng.standard_normal(len(cars))


def joint_density(surrogate: Surrogate, figures: Sequence[Figure], cars: FloatArray) -> float:
    """Returns the logarithm of the density of figures together, averaged over cars (m, n)."""
    logs = np.sum([log_density(surrogate, figure, cars) for figure in figures], axis=0)
    return float(logsumexp(logs) - np.log(len(cars)))


def _constant(own: Sequence[Figure], figures: Sequence[Figure]) -> float:
    """Returns the logarithm of the density by the other tables' values of the same metrics, with
    Student's t for so few; NaN where fewer than two have a metric.
    """
    total = 0.0
    for figure in own:
        others = np.array(
            [f.published for f in figures if f.metric == figure.metric and f not in own]
        )
        if len(others) < 2:
            return math.nan
        spread = np.std(others, ddof=1) * np.sqrt(1.0 + 1.0 / len(others)) / abs(figure.published)
        off = (figure.published - np.mean(others)) / abs(figure.published)
        total += float(t.logpdf(off, len(others) - 1, 0.0, spread))
    return total


def rigid(prior: CarPrior) -> CarPrior:
    """Returns the prior with its stiffest tyres, its smallest delay of the swing, a window of
    0.64 s, no latency, no bias and zero phase.
    """
    plan = prior.plan
    ranges = dict(plan.ranges)
    for name, low in zip(prior.names, prior.ranges[:, 0].tolist(), strict=True):
        if name.endswith((SLIP, "controller.delay")):
            ranges[name] = (low, low + 1e-3)
    nuisances = {
        "window": (0.639, 0.641),
        "latency": (0.0, 1e-3),
        "gyro_bias": (-1e-3, 1e-3),
        "forward": (0.0, 0.1),
    }
    return CarPrior(plan.model_copy(update={"ranges": ranges, "nuisances": nuisances}))


def _playing(
    surrogate: Surrogate, posterior: Posterior, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, bool]]:
    """Draws a posterior car (1, n) that survives every turn with a table, and how its turns end."""
    for _ in range(TRIES):
        car = posterior.cars[rng.integers(len(posterior.cars))][None]
        ends = surrogate.draw_outcomes(car, rng)
        if all(ends[turn.name] for turn in surrogate.prior.plan.turns if turn.table):
            return car, ends
    raise UserError(f"none of {TRIES} posterior cars survives every turn with a table")


def perfect_model(
    surrogate: Surrogate,
    posterior: Posterior,
    tables: Sequence[str],
    number: int,
    seed: int,
    runs: CachedRunner,
) -> float:
    """Returns the share of the figures of tables that lie in their 90 % interval when posterior
    cars play the thesis.
    """
    rng = np.random.default_rng(seed)
    plan = surrogate.prior.plan
    questions = []
    for place in range(number):
        car, ends = _playing(surrogate, posterior, rng)
        turns = tuple(
            turn.model_copy(update={"ends": "survived" if ends[turn.name] else "flipped"})
            for turn in plan.turns
        )
        played = replace(surrogate, prior=CarPrior(plan.model_copy(update={"turns": turns})))
        figures = [
            replace(f, published=float(predicted(surrogate, f, car, rng)[0]))
            for f in figures_of(plan)
        ]
        questions += [Question(played, figures, table, seed + place) for table in tables]
    runs.stage = "tables of posterior cars that play the thesis"
    answers = predictions(questions, runs)
    return float(np.mean([row["inside"] for left in answers for row in left.rows]))


@dataclass(frozen=True)
class Measurement:
    """Something that the lab can measure of its car.

    Attributes:
        name: name of the measured quantity.
        how: procedure in a sentence.
        deviation: standard deviation of one measurement, in the unit of the value.
        value: function from cars (m, n) to the values that would be measured (m).
    """

    name: str
    how: str
    deviation: float
    value: Callable[[FloatArray], FloatArray]


def information(measurement: Measurement, cars: FloatArray, seed: int) -> float:
    """Returns the information that a measurement is expected to add to that of posterior cars
    (m, n), nats.
    """
    truth = measurement.value(cars)
    rng = np.random.default_rng(seed)
    seen = rng.choice(truth, DRAWS) + measurement.deviation * rng.standard_normal(DRAWS)
    densities = norm.logpdf(seen[:, None], truth, measurement.deviation)
    logs = logsumexp(densities, axis=1) - np.log(len(truth))
    known = norm.entropy(scale=measurement.deviation)
    return float(-np.mean(logs) - known)


def measurements(prior: CarPrior) -> tuple[Measurement, ...]:
    """Reads the measurements that a lab with a scale, a ruler and a flat floor can make of the real
    car: `calibration/measurements.csv`.

    Deviations in that file are in the unit of the parameter; a row without a parameter is the angle
    of balance, in degrees.
    """

    def value(key: str) -> Callable[[FloatArray], FloatArray]:
        if not key:
            return partial(_angle_of_balance, prior)
        column = prior.column(f"physical {key}" if key in prior.plan.each else key)
        return lambda cars: cars[:, column]

    rows = pd.read_csv(model_path("calibration/measurements.csv"), keep_default_na=False).to_numpy()
    return tuple(
        Measurement(name, how, deviation, value(key)) for name, how, deviation, key in rows
    )


def _angle_of_balance(prior: CarPrior, cars: FloatArray) -> FloatArray:
    """Returns the roll at which cars (m) balance on the outer edges of their tyres, degrees."""
    width = load_scenario("turn_none").car.tyre_width
    track, height = (cars[:, prior.column(key)] for key in ("car.track", "car.com_height"))
    return np.degrees(np.arctan2(0.5 * (track + width), height))


def combinations(
    prior: CarPrior, cars: FloatArray, seed: int
) -> list[tuple[float, dict[str, float]]]:
    """Finds the five combinations of coordinates that the data determine best; returns for each its
    variance over that of the prior, and its four largest coordinates.
    """
    physical = [
        index
        for index, name in enumerate(prior.names)
        if name not in ("forward", DISCREPANCY, ROLL_DISCREPANCY)
    ]
    before, after = (prior.scaled(c)[:, physical] for c in (prior.draw(4000, seed), cars))
    ratios, vectors = eigh(np.cov(after.T), np.cov(before.T))
    best = []
    for ratio, vector in zip(ratios[:5], vectors.T[:5], strict=True):
        share = vector * np.std(before, axis=0)
        share = share / np.linalg.norm(share)
        largest = np.argsort(-np.abs(share))[:4]
        names = [prior.names[physical[index]] for index in largest]
        best.append((float(ratio), dict(zip(names, share[largest].tolist(), strict=True))))
    return best


def brier(surrogate: Surrogate, cars: FloatArray) -> tuple[float, Values]:
    """Returns the Brier score of the published outcomes, and the probability of surviving each
    turn.
    """
    turns = surrogate.prior.plan.turns
    chances = {turn.name: float(np.mean(surrogate.survival(cars, turn))) for turn in turns}
    misses = [chances[turn.name] - (turn.ends == "survived") for turn in turns]
    return float(np.mean(np.square(misses))), chances
