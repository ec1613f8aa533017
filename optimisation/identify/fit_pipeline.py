"""The pipeline of every fit: parameters -> data -> residual -> solve -> result with intervals and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AliasChoices, Field

from aerodima.optimisation.identify.least_squares import Loss, Problem, Solution, Solver, solve, solve_huber
from aerodima.optimisation.identify.residual_noise import Noise
from aerodima.optimisation.identify.uncertainty import Uncertainty, uncertainty


@dataclass(frozen=True)
class Estimate:
    """One parameter after a fit.

    Attributes:
        name, unit: of the parameter.
        value: in `unit`.
        standard_deviation, lower, upper: with the 95 % interval, which holds the value; infinite when not identifiable,
            zero when frozen, one-sided at a bound (see `uncertainty`).
        identifiable: whether the data determine it.
        bound: `lower` or `upper` when the fit stopped there.
        frozen: kept its seed.
    """

    name: str
    unit: str
    value: float
    standard_deviation: float
    lower: float
    upper: float
    identifiable: bool = True
    bound: str = ""
    frozen: bool = False

    def holds(self, truth: float) -> bool:
        """Whether the interval holds a value."""
        return self.lower <= truth <= self.upper


@dataclass(frozen=True)
class FitResult:
    """What one fit found, ready for a report.

    Attributes:
        name: of the log or table that was fitted.
        estimates: of all parameters, the frozen ones included.
        covariance: of the free parameters, in the order of `free` (p x p).
        cost: |weighted residual|^2 / 2.
        residual_rms: root mean square of the residual per channel, in the channel's unit.
        success, status: of the solver.
        attempts: all starts that were tried: start, cost, success, status, iterations.
        unidentifiable: directions that the data do not determine.
        warnings: what a reader must know: active bounds, missing axes, undetermined directions.
        effective_samples: that the data count as.
        facts: labels of the data, such as tail, axis, angle and wind speed.
        rig: what of the rig differs from `models/`, as `section.key`.
        budget: per parameter the shares of the variance that noise and each uncertain constant have.
        constants: those that have a prior: shift from the scenario, deviation after the fit, and `known_to` before it.
        curves: for plots, by name; each a dictionary of equally long lists. Not in CSV and YAML.
    """

    name: str
    estimates: tuple[Estimate, ...]
    covariance: tuple[tuple[float, ...], ...]
    cost: float
    residual_rms: Mapping[str, float]
    success: bool
    status: str
    attempts: tuple[Mapping[str, Any], ...]
    unidentifiable: Annotated[tuple[str, ...], Field(validation_alias=AliasChoices("unidentifiable", "unseen"))] = ()
    warnings: tuple[str, ...] = ()
    effective_samples: float = math.nan
    facts: Mapping[str, Any] = field(default_factory=dict)
    curves: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    budget: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    constants: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; KeyError lists those there are."""
        for estimate in self.estimates:
            if estimate.name == name:
                return estimate
        raise KeyError(f"{name!r}; estimated: {', '.join(estimate.name for estimate in self.estimates)}")

    @property
    def free(self) -> tuple[Estimate, ...]:
        """The estimates that were not frozen."""
        return tuple(estimate for estimate in self.estimates if not estimate.frozen)

    @property
    def resnorm(self) -> float:
        """|weighted residual|^2, above zero: what the averages over several fits weigh by (eqs. 4.29-4.31)."""
        return 2.0 * max(self.cost, 1e-12)

    def row(self) -> dict[str, Any]:
        """One flat row for CSV: facts, then value, standard deviation and interval of every parameter."""
        row: dict[str, Any] = {"fit": self.name, **self.facts}
        for e in self.estimates:
            suffix = "" if e.unit in ("1", "") else "_" + unit_suffix(e.unit)
            row[f"{e.name}{suffix}"] = e.value
            if e.frozen:
                continue
            row[f"{e.name}_std{suffix}"] = e.standard_deviation
            row[f"{e.name}_lower95{suffix}"], row[f"{e.name}_upper95{suffix}"] = e.lower, e.upper
            row[f"{e.name}_identifiable"], row[f"{e.name}_bound"] = e.identifiable, e.bound
        row |= {f"residual_rms_{channel}": value for channel, value in self.residual_rms.items()}
        row |= {"cost": self.cost, "effective_samples": self.effective_samples, "success": self.success}
        return row | {"status": self.status, "warnings": "; ".join(self.warnings)}


def short_name(fit: str) -> str:
    """Of a fit, for a table or a figure: without folder and suffix of a log."""
    path = Path(fit)
    return path.stem if path.suffix in (".parquet", ".csv") else path.name


def parameter_names(results: Sequence[FitResult]) -> list[str]:
    """Names of all parameters of some fits in order; those that end in a number (`cn_at_10`) in the order of it."""
    names = list(dict.fromkeys(e.name for result in results for e in result.estimates))
    families: dict[str, int] = {}

    def place(name: str) -> tuple[int, float]:
        family, _, number = name.rpartition("_")
        try:
            value = float(number)
        except ValueError:
            family, value = name, 0.0
        return families.setdefault(family, len(families)), value

    return sorted(names, key=place)


def unit_suffix(unit: str) -> str:
    """A unit as the end of a column name: `N m s/rad` becomes `n_m_s_per_rad`, `A` becomes `a`."""
    return unit.lower().replace("/", "_per_").replace(" ", "_").replace("^", "")


NoiseModel = Callable[[Solution], Noise]


def fit(
    problem: Problem,
    method: Solver,
    noise: NoiseModel,
    *,
    starts: Sequence[np.ndarray] | None = None,
    channels: Mapping[str, tuple[slice, float]] | None = None,
    facts: Mapping[str, Any] | None = None,
    warnings: Sequence[str] = (),
    loss: Loss = "squares",
) -> FitResult:
    """Solves a problem from all starts and says how sure the answer is.

    Args:
        noise: makes the noise of the residual from the solution, see `uncertainty`.
        channels: per channel where it stands in the residual and the weight that its residual was divided by.
        warnings: of the data, kept before those of the fit.
        loss: `huber` goes on from the least-squares solution with Huber's loss
        (`aerodima.optimisation.identify.least_squares`).

    Raises:
        FitError: no start could be solved.
    """
    solution = solve(problem, method, starts)
    if loss == "squares":
        return result_of(solution, uncertainty(solution, noise(solution)), channels or {}, facts or {}, warnings)
    robust = solve_huber(problem, method, solution)
    sure = uncertainty(robust.influence, noise(robust.influence))
    told = {**(facts or {}), "loss": loss, "outliers": robust.beyond}
    return result_of(robust.solution, sure, channels or {}, told, warnings)


def result_of(
    solution: Solution,
    sure: Uncertainty,
    channels: Mapping[str, tuple[slice, float]],
    facts: Mapping[str, Any],
    warnings: Sequence[str],
) -> FitResult:
    """The result of a solution and its uncertainty."""
    parameters = solution.problem.parameters
    bounds = parameters.active(solution.x)
    numbers = np.stack([solution.x, sure.standard_deviation, sure.lower, sure.upper], axis=1).tolist()
    found = dict(zip(parameters.names, zip(numbers, sure.identifiable.tolist(), strict=True), strict=True))
    estimates = []
    for p in parameters.all:
        if p.frozen:
            estimates.append(Estimate(p.name, p.unit, p.seed, 0.0, p.seed, p.seed, frozen=True))
            continue
        of_p, identifiable = found[p.name]
        # A parameter that is not identifiable stays where it started, which may be a bound.
        bound = bounds.get(p.name, "") if identifiable else ""
        value, deviation, lower, upper = of_p
        estimates.append(Estimate(p.name, p.unit, value, deviation, lower, upper, identifiable, bound))
    rms = {
        name: float(np.sqrt(np.mean(np.square(solution.residual[where])))) * weight
        for name, (where, weight) in channels.items()
    }
    return FitResult(
        name=solution.problem.name,
        estimates=tuple(estimates),
        covariance=tuple(map(tuple, sure.covariance.tolist())),
        cost=solution.best.cost,
        residual_rms=rms,
        success=solution.best.success,
        status=solution.best.status,
        attempts=tuple(_attempt(parameters.names, attempt) for attempt in solution.attempts),
        unidentifiable=sure.unidentifiable,
        warnings=(*warnings, *_warnings(estimates, sure, solution)),
        effective_samples=sure.effective_samples,
        facts=dict(facts),
    )


def _attempt(names: Sequence[str], attempt: Any) -> dict[str, Any]:
    ends = {
        word: dict(zip(names, x.tolist(), strict=True)) for word, x in (("start", attempt.start), ("found", attempt.x))
    }
    told = {name: getattr(attempt, name) for name in ("success", "status", "iterations")}
    return {**ends, "cost": float(attempt.cost), **told}


def _warnings(estimates: Sequence[Estimate], sure: Uncertainty, solution: Solution) -> list[str]:
    found = [f"the data do not determine {direction}" for direction in sure.unidentifiable]
    at_bounds = [e for e in estimates if e.bound]
    beyond = dict(zip(solution.problem.parameters.names, sure.beyond.tolist(), strict=True))
    for e in at_bounds:
        bound = f"{e.bound} bound {e.value:.6g}{'' if e.unit == '1' else ' ' + e.unit}"
        found.append(
            f"{e.name} stopped at its {bound}, {beyond[e.name]:.2g} standard deviations from what the data ask for"
        )
    if at_bounds and len(at_bounds) < sum(e.identifiable and not e.frozen for e in estimates):
        found.append(f"the intervals of the others take {', '.join(e.name for e in at_bounds)} to lie within bounds")
    if not solution.best.success:
        found.append(f"the solver did not finish: {solution.best.status}")
    return found
