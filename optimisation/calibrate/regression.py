"""Regressions over cars of a prior: Gaussian processes for many cars, planes for few."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import cho_solve

from aerodima.workbench.core.array_types import ArrayPair, FloatArray, IntArray

VARIANCE_BOUNDS = (1e-2, 1e3)
"""Bounds within which the variance of a process is tuned."""
LENGTH_BOUNDS = (0.3, 100.0)
"""Bounds of its lengths over scaled columns."""
NOISE_BOUNDS = (1e-5, 1.0)
"""Bounds of the variance of its noise."""
HYPERPARAMETER_SAMPLES = 250
"""Largest number of rows by which a process is tuned."""
TRAINING_SAMPLES = 1200
"""Largest number of rows to which a process is fitted."""
RIDGES = np.logspace(0.0, 4.0, 9)
"""Ridge penalties of a plane that are tried."""


@dataclass(frozen=True)
class TrainingSet:
    """Rows that a regression is fitted to.

    Attributes:
        columns: columns of the scaled cars that the values depend on.
        scaled: scaled cars (m, n).
        values: values that are to be predicted (m, k).
        cars: index of the car of each row (m); the residuals of a car are found without all rows of
            that car.
    """

    columns: list[int]
    scaled: FloatArray
    values: FloatArray
    cars: IntArray

    @property
    def inputs(self) -> FloatArray:
        """Returns the columns (m, c) of the scaled cars."""
        return self.scaled[:, self.columns]

    def rows(self) -> IntArray:
        """Draws the rows to which a process is fitted, always the same."""
        number = len(self.values)
        return np.random.default_rng(number).permutation(number)[:TRAINING_SAMPLES]

    def standard(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns the values (m, k) with mean 0 and deviation 1, their mean (k) and deviation
        (k).
        """
        middle = self.values.mean(axis=0)
        spread = self.values.std(axis=0) + 1e-9
        return (self.values - middle) / spread, middle, spread

    def tuning_rows(self) -> ArrayPair:
        """Returns the inputs (h, c) and standard values (h, k) by which a process is tuned."""
        rows = self.rows()[:HYPERPARAMETER_SAMPLES]
        return self.inputs[rows], self.standard()[0][rows]


def tune(rows: ArrayPair) -> list[float]:
    """Finds the logarithms of the hyperparameters of a process, with a length for every column, by
    `TrainingSet.tuning_rows`.
    """
    from sklearn.gaussian_process import GaussianProcessRegressor

    inputs, targets = rows
    with warnings.catch_warnings():
        # The length of a column without influence is at its bound.
        warnings.simplefilter("ignore")
        fitted = GaussianProcessRegressor(_kernel(inputs.shape[1])).fit(inputs, targets)
    return fitted.kernel_.theta.tolist()


def _kernel(number: int) -> Any:
    """Makes the kernel of a process over `number` columns, before it is tuned."""
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    smooth = ConstantKernel(1.0, VARIANCE_BOUNDS) * RBF(np.full(number, 2.0), LENGTH_BOUNDS)
    return smooth + WhiteKernel(0.01, NOISE_BOUNDS)


@dataclass(frozen=True)
class Regression:
    """A regression over some columns of scaled cars.

    Attributes:
        columns: columns of the scaled cars that the model takes.
        model: function from these columns (m, c) to values (m, k).
        deviation: deviation of the residuals of cars that it was not fitted to (k), in the unit of
            its values.
        residuals: residuals of each row, fitted without that row's car (m, k).
    """

    columns: tuple[int, ...]
    model: Callable[[FloatArray], FloatArray]
    deviation: FloatArray
    residuals: FloatArray

    @classmethod
    def process(cls, data: TrainingSet, theta: Sequence[float]) -> Regression:
        """Fits a Gaussian process.

        Args:
            data: training rows of many cars.
            theta: hyperparameters from `tune`.
        """
        from sklearn.gaussian_process import GaussianProcessRegressor

        rows = data.rows()
        inputs = data.inputs
        standard, middle, spread = data.standard()
        chosen = inputs[rows]
        target = standard[rows]
        tuned = _kernel(chosen.shape[1]).clone_with_theta(np.array(theta))
        fitted = GaussianProcessRegressor(tuned, optimizer=None).fit(chosen, target)
        size = tuned.k1.k1.constant_value
        lengths = tuned.k1.k2.length_scale
        weights = fitted.alpha_.reshape(target.shape)
        model = partial(_process_at, lengths, chosen / lengths, weights * (size * spread), middle)
        inverse = cho_solve((fitted.L_, True), np.eye(len(rows)))
        residuals = np.full(data.values.shape, np.nan)
        cars = data.cars[rows]
        for car in np.unique(cars):
            own = np.flatnonzero(cars == car)
            residuals[rows[own]] = spread * np.linalg.solve(inverse[np.ix_(own, own)], weights[own])
        rest = np.isnan(residuals[:, 0])  # not fitted, so the process has not seen them
        residuals[rest] = data.values[rest] - model(inputs[rest])
        return cls(tuple(data.columns), model, _deviation(residuals[rows]), residuals)

    @classmethod
    def line(cls, data: TrainingSet) -> Regression:
        """Fits a plane with a ridge, for rows of few cars."""
        from sklearn.linear_model import Ridge
        from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_predict

        values = data.values
        folds = GroupKFold(min(8, len(np.unique(data.cars))))
        tried = GridSearchCV(Ridge(), {"alpha": RIDGES}, cv=folds, scoring="neg_mean_squared_error")
        ridge = tried.fit(data.inputs, values, groups=data.cars).best_estimator_
        predicted = cross_val_predict(ridge, data.inputs, values, groups=data.cars, cv=folds)
        residuals = values - predicted.reshape(values.shape)
        model = partial(_plane_at, np.atleast_2d(ridge.coef_), np.atleast_1d(ridge.intercept_))
        return cls(tuple(data.columns), model, _deviation(residuals), residuals)

    def __call__(self, scaled: FloatArray) -> FloatArray:
        """Returns values (m, k) at scaled cars (m, n)."""
        return self.model(scaled[:, self.columns])


def _process_at(
    lengths: FloatArray,
    places: FloatArray,
    weights: FloatArray,
    middle: FloatArray,
    inputs: FloatArray,
) -> FloatArray:
    """Predicts as sklearn's `predict`, without its checks, which take most of the time of a
    posterior.
    """
    at = inputs / lengths
    alike = at @ places.T
    alike -= 0.5 * np.sum(places**2, axis=1)
    alike -= 0.5 * np.sum(at**2, axis=1)[:, None]
    return middle + np.exp(alike, out=alike) @ weights


def _plane_at(slopes: FloatArray, offset: FloatArray, inputs: FloatArray) -> FloatArray:
    return inputs @ slopes.T + offset


def _deviation(residuals: FloatArray) -> FloatArray:
    """Returns the size that 68 % of residuals (m, k) do not exceed; a car at a flip's edge may be
    off by any amount.
    """
    return np.quantile(np.abs(residuals), 0.6827, axis=0)
