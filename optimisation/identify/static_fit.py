"""C_D, C_L, psi3 and holding current of a static hold, from its six reactions and its speed (thesis
section 4.8).

The fit is algebraic: the balance of the held rig stands in for a simulation. The seventh residual
is the speed at which the tail would creep against its friction if the current did not hold it.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.fit_result import FitResult
from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem, Solution
from aerodima.optimisation.identify.log_rig import differences
from aerodima.optimisation.identify.noise import Noise
from aerodima.optimisation.identify.rig_constants import BIASES, accuracies, shifted, speed_accuracy
from aerodima.optimisation.identify.static_log import REACTIONS, StaticData, static_data
from aerodima.optimisation.identify.uncertain_constants import (
    MAX_SHIFT_SIGMA,
    MISFITS,
    UncertainRig,
    Whitening,
)
from aerodima.workbench.core.array_types import FloatArray, Values
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.quantity import STANDARD_GRAVITY
from aerodima.workbench.core.resources import published_table
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.logs.signals import Interval
from aerodima.workbench.rig.pendulum import StaticBalance

UNKNOWNS = {
    "cd": Parameter("cd", "1", 0.0, -0.1, 3.0, scale=1.0),
    "cl": Parameter("cl", "1", 0.0, -0.5, 3.0, scale=1.0),
    "psi3": Parameter("psi3", "rad", 0.0, -0.35, 0.35, scale=0.1),
    "current": Parameter("current", "A", 0.0, -10.0, 30.0, scale=5.0),
}
"""Unknowns within bounds that the published results themselves respect (they break the printed
ones: ERRATA E5, E6)."""
READING_FACTORS = {
    -1.0: "the other sign of",
    STANDARD_GRAVITY: "kgf in place of N in",
    1.0 / STANDARD_GRAVITY: "a factor of 9.81 in",
    1e3: "a factor of 1/1000 in",
    1e-3: "a factor of 1000 in",
}
"""Mistakes in readings, by the factor that puts the readings right."""
_MARGIN = 10.0
"""Margin in -2 log likelihood by which a mistake must be likelier than constants that are off."""
_MAX_SIGMA = 3.0
"""Number of standard deviations beyond which a prediction disagrees with the log."""
_TURN = 1e-5
"""Step of the central difference over psi3, rad: its error is of the order of 1e-11."""


def static_parameters(data: StaticData, options: FitOptions = FREE) -> Parameters:
    """Make the unknowns, from the initial values of Tables 4.9 and 10.1-10.5 at the nearest angle
    and wind speed.
    """
    angle = abs(math.degrees(data.angle))
    nodes = [node for node in _seed_table() if str(node[0]) == data.facts["tail"]]
    nearest = min(
        nodes, key=lambda node: (abs(node[1] - angle) / 15.0, abs(node[2] - data.wind_speed))
    )
    seeds = _seed_table()[nearest]
    seeded = [p.starting_at(seeds[name]) for name, p in UNKNOWNS.items()]
    return Parameters.of(options.bounded(seeded))


@cache
def _seed_table() -> dict[Any, dict[str, float]]:
    """Read the initial values, by tail, angle (degrees) and wind speed, and then by name."""
    keys = ["tail", "angle_of_attack_deg", "wind_speed_m_per_s"]
    return {
        node: dict(zip(group.variable, group.x0.tolist(), strict=True))
        for node, group in published_table("static_seeds").groupby(keys, sort=False)
    }


class StaticResidual:
    """Weighted residual of one hold.

    Its rows are the present reactions over their accuracy of Table 4.8, then the speed over its
    own.
    """

    def __init__(self, data: StaticData) -> None:
        self._data = data
        self._balance = StaticBalance.from_scenario(data.scenario)
        self._rows = [i for i in range(6) if data.present[i]]
        self._weights = accuracies()[self._rows]
        speed = speed_accuracy()
        friction = data.scenario.friction
        # Torque per speed at rest: viscous friction + tanh gain x Coulomb friction.
        creep = 1.0 / ((friction.viscous + friction.tanh_gain * friction.coulomb) * speed)
        self._scale = np.append(1.0 / self._weights, creep)
        self._constant = self._scaled(*self._weight(data.angle))
        self._constant -= np.append(data.wrench[self._rows] / self._weights, data.speed / speed)
        self._motor = np.zeros(len(self._scale))
        self._motor[-1] = -creep * data.scenario.maxon.torque_constant
        self._effect = lru_cache(maxsize=1)(self._wind_effect)

    def _scaled(self, wrench: FloatArray, torque: float) -> FloatArray:
        return np.append(wrench[self._rows], torque) * self._scale

    @property
    def channels(self) -> dict[str, tuple[slice, float]]:
        """Rows of each channel and the weight that they were divided by."""
        names = [*(REACTIONS[i] for i in self._rows), "speed"]
        weights = [*self._weights.tolist(), speed_accuracy()]
        return {name: (slice(i, i + 1), weights[i]) for i, name in enumerate(names)}

    def _wind_effect(self, psi: float) -> FloatArray:
        """Compute the weighted rows of the wind on bar, unit C_D and unit C_L (3 x m)."""
        data = self._data
        effect = self._balance.wind_effect(data.angle, data.wind_speed, psi)
        return effect[:, [*self._rows, 6]] * self._scale

    def __call__(self, x: FloatArray) -> FloatArray:
        """Compute the residual (present axes + 1) of C_D, C_L, psi3 and current."""
        cd, cl, psi, current = x.tolist()
        bar, drag, lift = self._effect(psi)
        return self._constant + bar + cd * drag + cl * lift + current * self._motor

    def noise(self, x: FloatArray) -> Noise:
        """Estimate the noise from the errors of the force sensor and the encoder at unknowns
        (p).
        """
        data = self._data
        rows = self._rows
        weights = self._weights
        count = len(rows)
        covariance = np.zeros((count + 1, count + 1))
        of_rows = data.covariance[np.ix_(rows, rows)]
        covariance[:count, :count] = of_rows / np.outer(weights, weights)
        covariance[count, count] = (data.speed_deviation / speed_accuracy()) ** 2
        deviation = data.scenario.count_angle / math.sqrt(12.0)
        rounding = math.sqrt(3.0) * deviation * self._angle_slope(x)
        covariance = covariance + np.outer(rounding, rounding) / 3.0
        return Noise(covariance, np.inf, data.effective_samples, rounding)

    def _weight(self, angle: float) -> tuple[FloatArray, float]:
        """Compute the reactions of the weight that are in the readings (6), and the torque of the
        weight about the motor axis.
        """
        reactions, torque = self._balance.hanging(angle)
        tare = self._data.tare
        if tare is None:
            return reactions, torque
        # A tare at the angle of the hold has the same error as the angle.
        if tare == self._data.angle:
            tare = angle
        tared, _ = self._balance.hanging(tare)
        return reactions - tared, torque

    def _angle_slope(self, x: FloatArray) -> FloatArray:
        """Compute d residual / d angle."""
        cd, cl, psi, _ = x.tolist()
        shares = np.array([1.0, cd, cl])
        data = self._data
        ends = []
        for angle in (data.angle + _TURN, data.angle - _TURN):
            weight, torque = self._weight(angle)
            total = shares @ self._balance.wind_effect(angle, data.wind_speed, psi)
            ends.append(self._scaled(weight + total[:6], torque + total[6]))
        return (ends[0] - ends[1]) / (2.0 * _TURN)


def static_problem(data: StaticData, options: FitOptions = FREE) -> Problem:
    """State the least-squares problem of one hold on a rig that is known exactly."""
    return Problem(static_parameters(data, options), StaticResidual(data), name=data.name)


def fit_static(data: StaticData, options: FitOptions = FREE) -> FitResult:
    """Fit one hold.

    Raises:
        FitError: the problem could not be solved.
    """
    problem = static_problem(data, options)
    residual = StaticResidual(data)
    facts: Json = dict(data.facts)
    if math.isfinite(data.current):
        facts["logged_current_a"] = data.current
    balance = StaticBalance.from_scenario(data.scenario)
    facts["exposed_length_m"] = exposed = balance.exposed_length(data.angle)
    result = fit(
        problem,
        lambda solution: residual.noise(solution.x),
        channels=residual.channels,
        facts=facts,
        warnings=data.warnings,
        rig=_uncertain_rig(data),
    )
    warnings = [*result.warnings, *_against_logged_current(result, data)]
    others = [warning for warning in warnings if not warning.startswith(MISFITS)]
    if len(others) < len(warnings) and not options.free:
        mistake = _mistake(result, data, problem.parameters)
        warnings = [*mistake, *others] if mistake else warnings
    if data.still and exposed > 0.0:
        warnings.append(
            "the readings change after the rest phase by no more than noise and drift can do, "
            f"although the wind of {data.wind_speed:g} m/s meets the tail: is the wind off in it?"
        )
    return replace(result, rig=differences(data.scenario), warnings=tuple(warnings))


def _without_biases(data: StaticData) -> StaticData:
    """Remove the biases of a hold from its noise where they are unknowns."""
    if not any(p.name in BIASES for p in data.constants):
        return data
    return replace(data, covariance=data.covariance - np.diag(np.square(data.offset_deviation)))


def _mended(data: StaticData) -> Iterator[tuple[str, StaticData, FloatArray]]:
    """Yield possible mistakes in the readings (signs, the weight, units), each with the hold put
    right and the factors of its rows (m).
    """
    groups = [*zip(REACTIONS, strict=True), REACTIONS[:3], REACTIONS[3:], REACTIONS]
    if data.tare != data.angle:
        text = f"the weight of the rig is{' not' * (data.tare is None)} in the readings"
        tare = data.angle if data.tare is None else None
        yield text, replace(data, tare=tare), np.ones(1 + np.count_nonzero(data.present))
    for factor, text in READING_FACTORS.items():
        for group in groups:
            factors = np.where(np.isin(REACTIONS, group), factor, 1.0)
            if not np.all(factors[data.present] == 1.0):
                mended = replace(data, wrench=data.wrench * factors)
                yield f"{text} {', '.join(group)}", mended, np.append(factors[data.present], 1.0)


def _mistake(result: FitResult, data: StaticData, parameters: Parameters) -> list[str]:
    """Name the mistake in the readings that explains them best, if it is likelier than constants of
    the rig that are off.
    """
    exact = _without_biases(data)
    residual = StaticResidual(exact)
    x = np.array([result[name].value for name in UNKNOWNS])
    noise = residual.noise(x).covariance
    ends = []
    sizes = []
    for name, constant in result.constants.items():
        prior = constant["known_to"]
        ends.append(StaticResidual(shifted_data(exact, {name: prior}))(x))
        sizes.append(abs(constant["shift"]) / prior)
    shifts = (np.reshape(ends, (-1, len(noise))) - residual(x)).T
    off = [size if size > MAX_SHIFT_SIGMA else 1.0 for size in sizes]

    def unlikelihood(hold: StaticData, factors: FloatArray, shifts: FloatArray) -> float:
        """Compute -2 log likelihood of the readings; `factors` (m) have put the hold right."""
        shifts = shifts / factors[:, None]
        whitening = Whitening.from_covariance(noise + shifts @ shifts.T)
        model = StaticResidual(hold)
        best = solve(Problem(parameters, lambda x: whitening(model(x) / factors))).best
        return 2.0 * best.cost - 2.0 * float(np.linalg.slogdet(whitening.matrix)[1])

    least, text = min(
        (unlikelihood(hold, factors, shifts), text) for text, hold, factors in _mended(exact)
    )
    if least > unlikelihood(exact, np.ones(len(noise)), shifts * off) - _MARGIN:
        return []
    return [f"{text} explains the data better than constants of the rig that are off; check it"]


def _uncertain_rig(data: StaticData) -> UncertainRig:
    """State the hold with the rig's constants as unknowns; biases of the readings are then not part
    of the noise.
    """
    exact = _without_biases(data)

    def problem(parameters: Parameters) -> Problem:
        def residual(x: FloatArray) -> FloatArray:
            values = parameters.values(x)
            unknowns = np.array([values[name] for name in UNKNOWNS])
            return StaticResidual(shifted_data(exact, values))(unknowns)

        return Problem(parameters, residual, name=data.name)

    def noise(solution: Solution) -> Noise:
        here = StaticResidual(exact).noise(solution.x[: len(UNKNOWNS)])
        return replace(here, rounding=None)

    return UncertainRig(data.constants, problem, noise, noise)


def shifted_data(data: StaticData, values: Values) -> StaticData:
    """Make the hold for constants and instruments that are off by the given values, by name."""
    zero = values.get("encoder_zero", 0.0)
    bias = np.array([values.get(name, 0.0) for name in BIASES])
    return replace(
        data,
        scenario=shifted(data.scenario, values),
        angle=data.angle + zero,
        tare=None if data.tare is None else data.tare + zero,
        wind_speed=data.wind_speed * (1.0 + values.get("wind_speed", 0.0)),
        wrench=(data.wrench - bias) / (1.0 + values.get("force_gain", 0.0)),
    )


def _against_logged_current(result: FitResult, data: StaticData) -> list[str]:
    """Warn when the holding current is not the logged one, which no fit has used.

    A held tail sticks: within its Coulomb friction the motor need not hold it.
    """
    current = result["current"]
    if not (math.isfinite(data.current) and current.identifiable):
        return []
    motor = data.scenario.maxon.torque_constant
    stuck = data.scenario.friction.coulomb / motor
    reach = _MAX_SIGMA * math.hypot(current.standard_deviation, data.current_deviation)
    if abs(current.value - data.current) <= reach + stuck:
        return []
    return [
        f"the fit holds the tail with {current.value:.4g} A, the log has {data.current:.4g} A: "
        f"they differ by more than their uncertainty ({reach:.2g} A) and Coulomb friction "
        f"({stuck:.2g} A); is maxon.torque_constant {motor:g} N m/A that of this rig (--set)?"
    ]


def fit_static_log(
    path: str | Path, *, rest: Interval | None = None, options: FitOptions = FREE
) -> FitResult:
    """Fit C_D, C_L, psi3 and holding current of a static hold.

    Args:
        path: path of the log.
        rest: first and last time of the rest without wind, s; by default as the log states it.
        options: options of the fit: rig, its constants, bounds, loss of the samples.

    Raises:
        UserError: something is wrong with the log or the options.
    """
    return fit_static(static_data(read_run_log(path), rest, options), options)
