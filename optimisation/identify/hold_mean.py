"""What a held reading is beyond the drift of its sensor, and what is added to it without a rest phase.

Drift, and a step where the wind begins, go through all samples of rest and hold together, because the hold helps to
find the drift too. Without a rest the offset is what the log or the scenario states, with how far wrong it may be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aerodima.optimisation.fit.least_squares import LIMIT, spread
from aerodima.optimisation.fit.residual_noise import (
    CHANCE,
    FAR_OFF,
    FEW_FAR_OFF,
    ResidualCheck,
    chance_of,
    check_residual,
    correlation_time,
)
from aerodima.optimisation.identify.static_balance import REACTIONS
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.conditioning import OFFSETS
from aerodima.workbench.logs.schema import RunLog

Drift = Literal["linear", "quadratic", "exponential"]
DRIFTS: tuple[Drift, ...] = ("linear", "quadratic", "exponential")
HoldLoss = Literal["squares", "huber", "bisquare"]
HOLD_LOSSES: tuple[HoldLoss, ...] = ("squares", "huber", "bisquare")
_BISQUARE = 4.685
"""Standard deviations beyond which a sample has no weight at all: 95 % efficient on normal data."""
_ROUNDS, _SETTLED = 40, 1e-4
_MOST_CORRELATED = 8192
"""Samples that the correlation time of the noise is taken from."""
_TIMES = np.geomspace(0.04, 1.0, 15)
"""Time constants that are tried for the exponential, as parts of the length of the log."""


@dataclass(frozen=True)
class HoldMean:
    """Of some readings (k).

    Attributes:
        value: their step at the end of the rest; without a rest their mean (k).
        variance: of its error from noise (k).
        lags: samples that count as one (k).
        checks: of what is left of each (k).
    """

    value: np.ndarray
    variance: np.ndarray
    lags: np.ndarray
    checks: tuple[ResidualCheck, ...]


def hold_mean(
    time: np.ndarray, values: np.ndarray, step: np.ndarray | None, drift: Drift = "linear", loss: HoldLoss = "squares"
) -> HoldMean:
    """Fits drift and step.

    Args:
        time: s (n).
        values: readings (k x n).
        step: 0 in the rest and 1 in the hold (n); None without a rest.
        drift: a line of time; a parabola; or a line and an exponential that dies out, its time constant common to all.
        loss: squares; `huber` holds samples back that lie far off; `bisquare` leaves them out, for bursts.
    """
    shapes = [_design(time, step, shape) for shape in _shapes(time, drift)]
    left = [
        float(np.sum(np.var(values - _fitted(values, design), axis=1) / np.var(values, axis=1))) for design in shapes
    ]
    design = shapes[int(np.argmin(left))]
    place = 0 if step is None else len(design) - 1
    value, variance, lags, checks = [], [], [], []
    for row in values:
        found, scatter, spoilt = _robust(row, design, loss)
        lag = correlation_time(scatter[:_MOST_CORRELATED])
        inverse = np.linalg.inv(design @ design.T)
        noise = float(scatter @ scatter) / max(len(row) / lag - len(design), 1.0) * spoilt
        value.append(found[place])
        variance.append(noise * inverse[place, place])
        lags.append(lag)
        check = check_residual(scatter, len(design))
        if loss == "squares" and (check.far_off or chance_of([check]) < CHANCE):
            # What lies far off has bent the fit: how far shows against one that it has not bent.
            check = check_residual(row - _robust(row, design, "bisquare")[0] @ design, len(design))
        checks.append(check)
    return HoldMean(np.array(value), np.array(variance), np.array(lags), tuple(checks))


def residual_warnings(mean: HoldMean, channels: list[str], time: np.ndarray) -> list[str]:
    """What the readings do that noise does not."""
    far = {name: check for name, check in zip(channels, mean.checks, strict=True) if check.far_off >= FEW_FAR_OFF}
    warnings = []
    if far:
        worst = max(far.values(), key=lambda check: check.far_off)
        warnings.append(
            f"{', '.join(far)}: up to {worst.far_off} samples lie more than {FAR_OFF:g} standard deviations off, the "
            f"first at {time[worst.first]:g} s: no noise does that (try --loss bisquare)"
        )
    if chance_of(mean.checks) < CHANCE:
        name, check = max(zip(channels, mean.checks, strict=True), key=lambda pair: pair[1].wander)
        warnings.append(
            f"the readings wander about the fitted drift as noise does not ({name}: by up to {check.swing:.2g}, slow "
            f"power {check.wander:.3g} times that of its noise): the intervals are too narrow (try another --drift)"
        )
    return warnings


def _shapes(time: np.ndarray, drift: Drift) -> list[list[np.ndarray]]:
    """The columns of the drift beside the constant; several of which the best is taken."""
    t = time - time.mean()
    if drift == "linear":
        return [[t]]
    if drift == "quadratic":
        return [[t, np.square(t) - np.mean(np.square(t))]]
    length = time[-1] - time[0]
    dying = [np.exp(-(time - time[0]) / (part * length)) for part in _TIMES]
    return [[t, curve - curve.mean()] for curve in dying]


def _design(time: np.ndarray, step: np.ndarray | None, shape: list[np.ndarray]) -> np.ndarray:
    return np.stack([np.ones_like(time), *shape, *([] if step is None else [step])])


def _fitted(values: np.ndarray, design: np.ndarray) -> np.ndarray:
    return values @ design.T @ np.linalg.inv(design @ design.T) @ design


def _robust(row: np.ndarray, design: np.ndarray, loss: HoldLoss) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients; the residual, clipped or without what lies far off; by how much that widens the variance."""
    found = row @ design.T @ np.linalg.inv(design @ design.T)
    residual = row - found @ design
    if loss == "squares":
        return found, residual, 1.0
    for kind in ("huber",) if loss == "huber" else ("huber", "bisquare"):
        for _ in range(_ROUNDS):
            scale = spread(residual)
            if scale == 0.0:
                return found, residual, 1.0
            weight = _weight(residual / scale, kind)
            before, found = found, (row * weight) @ design.T @ np.linalg.inv((design * weight) @ design.T)
            residual = row - found @ design
            if np.max(np.abs((found - before) @ design)) < _SETTLED * scale:
                break
    size = np.abs(residual / scale)
    if loss == "huber":
        within = float(np.mean(size <= LIMIT))
    else:
        inside = size < _BISQUARE
        ratio = np.square(size / _BISQUARE)
        within = float(np.mean(np.where(inside, (1.0 - ratio) * (1.0 - 5.0 * ratio), 0.0)))
    return found, residual * _weight(residual / scale, loss), 1.0 / within**2


def _weight(size: np.ndarray, loss: str) -> np.ndarray:
    if loss == "huber":
        return np.minimum(1.0, LIMIT / np.maximum(np.abs(size), LIMIT))
    return np.where(np.abs(size) < _BISQUARE, np.square(1.0 - np.square(size / _BISQUARE)), 0.0)


OFFSETS_UNCERTAINTY = "offsets_uncertainty"
"""Key in a log's `extra`: standard deviation of what is left of the readings' offsets (6), N and N m."""
TARED = "tared_angle_rad"
"""Key in a log's `extra`: angle at which the sensor was zeroed without wind just before, rad."""


@dataclass(frozen=True)
class HoldOffset:
    """What is added to readings (6), the standard deviation of what is then left (6), and `StaticData.tare`."""

    added: np.ndarray
    deviation: np.ndarray
    tare: float | None


def stated_offset(log: RunLog, scenario: RigScenario, warnings: list[str]) -> HoldOffset:
    """Of a hold without rest: as the log states it, else as the scenario does; LogError and FitError for nonsense."""
    accuracy = np.asarray(scenario.force_sensor.accuracies)
    tared, stated = log.extra.get(TARED), log.stated(OFFSETS_UNCERTAINTY, len(REACTIONS))
    if tared is not None and (isinstance(tared, bool) or not isinstance(tared, int | float)):
        raise FitError(f"metadata {TARED!r} is {tared!r}; an angle in rad is needed")
    if stated is not None and min(stated) < 0.0:
        raise FitError(f"metadata {OFFSETS_UNCERTAINTY!r} is {list(stated)}; six numbers of at least 0 are needed")
    if stated is not None:
        deviation = np.asarray(stated)
    elif tared is not None:
        deviation = accuracy * scenario.force_sensor.drift_fraction * float(log.time[-1] - min(log.time[0], 0.0))
    else:
        deviation = accuracy
        warnings.append(
            "no rest phase: bias and drift stay in the readings; the sensor's accuracy is taken as their standard "
            f"deviation (state {OFFSETS_UNCERTAINTY} or {TARED} in the log if it was tared or calibrated)"
        )
    if tared is not None:
        return HoldOffset(np.zeros(6), deviation, float(tared))
    offsets = log.stated(OFFSETS, len(REACTIONS)) or scenario.cheetah_tail.offsets
    return HoldOffset(np.asarray(offsets, float), deviation, None)
