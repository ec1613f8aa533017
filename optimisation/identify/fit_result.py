"""The result of a fit: estimates with intervals, covariance, warnings."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AliasChoices, Field

from aerodima.optimisation.identify.least_squares import Solution
from aerodima.optimisation.identify.uncertainty import Uncertainty
from aerodima.workbench.core.array_types import Texts, Values
from aerodima.workbench.core.file_reading import Facts, Json

Channels = Mapping[str, tuple[slice, float]]
"""Rows of a channel in the residual and the weight that they were divided by, by channel."""
BOUND_WORDS = {-1: "lower", 0: "", 1: "upper"}
"""Words for the sides of `Parameters.sides`."""


@dataclass(frozen=True)
class Estimate:
    """One parameter after a fit.

    Attributes:
        name: name of the parameter.
        unit: unit of the parameter.
        value: estimated value, in `unit`.
        standard_deviation: standard deviation of the estimate; infinite when not identifiable, zero
            when fixed.
        lower: lower end of the 95 % interval, which holds the value; infinite when not
            identifiable. At a bound the interval is one-sided (see `uncertainty`).
        upper: upper end of that interval.
        identifiable: whether the data determine the parameter.
        bound: `lower` or `upper` when the fit stopped there, else empty.
        frozen: whether the parameter was fixed and kept its initial value.
        noise_deviation: standard deviation that noise alone would give, with the rig's constants
            taken as exact; NaN in results of earlier versions.
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
    noise_deviation: float = math.nan

    def holds(self, truth: float) -> bool:
        """Tell whether the interval holds a value."""
        return self.lower <= truth <= self.upper


@dataclass(frozen=True)
class FitResult:
    """The result of one fit, ready for a report.

    Attributes:
        name: name of the log or table that was fitted.
        estimates: estimates of all parameters, the frozen ones included.
        covariance: covariance of the free parameters, in the order of `free` (p x p).
        cost: |weighted residual|^2 / 2; with `loss="huber"` and exact constants that of Huber's
            loss.
        added_cost: value of the costs that a user added to the program, not in `cost`.
        residual_rms: root mean square of the residual per channel, in the channel's unit.
        success: whether the solver succeeded.
        status: reason why the solver ended.
        attempts: all starts that were tried, each with `start`, `found`, `cost`, `success`,
            `status` and `iterations`.
        unidentifiable: directions that the data do not determine.
        warnings: notes that a reader must know of, such as active bounds, missing axes and
            undetermined directions.
        effective_samples: number of independent samples that the data count as.
        facts: labels of the data, such as tail, axis, angle and wind speed.
        rig: values of the rig that differ from `models/`, by `section.key`.
        budget: shares of the variance of each parameter that noise and each uncertain constant
            have.
        constants: constants that have a prior, each with its `shift` from the scenario, its
            `deviation` after the fit and its deviation before it, `known_to`.
        curves: curves for plots, by name, each with equally long lists and the labels of its axes.
            They are not in CSV and YAML.
    """

    name: str
    estimates: tuple[Estimate, ...]
    covariance: tuple[tuple[float, ...], ...]
    cost: float
    residual_rms: Values
    success: bool
    status: str
    attempts: tuple[Facts, ...]
    unidentifiable: Annotated[
        Texts, Field(validation_alias=AliasChoices("unidentifiable", "unseen"))
    ] = ()
    warnings: Texts = ()
    effective_samples: float = math.nan
    facts: Facts = field(default_factory=dict)
    curves: Facts = field(default_factory=dict)
    rig: Facts = field(default_factory=dict)
    budget: Mapping[str, Values] = field(default_factory=dict)
    constants: Mapping[str, Values] = field(default_factory=dict)
    added_cost: float = 0.0

    def __getitem__(self, name: str) -> Estimate:
        """Return the estimate of that name; KeyError lists those there are."""
        estimates = {estimate.name: estimate for estimate in self.estimates}
        if name not in estimates:
            raise KeyError(f"{name!r}; estimated: {', '.join(estimates)}")
        return estimates[name]

    @property
    def free(self) -> tuple[Estimate, ...]:
        """Estimates of the parameters that were not frozen."""
        return tuple(estimate for estimate in self.estimates if not estimate.frozen)

    @property
    def resnorm(self) -> float:
        """|weighted residual|^2, kept above zero; averages over several fits weigh by it (eqs.
        4.29-4.31).
        """
        return 2.0 * max(self.cost, 1e-12)

    def row(self) -> Json:
        """Make one row for CSV: facts, then value, standard deviation and interval of each
        parameter.
        """
        row: Json = {"fit": self.name, **self.facts}
        for e in self.estimates:
            # The unit ends the column name: `N m s/rad` becomes `n_m_s_per_rad`.
            unit = e.unit.lower().replace("/", "_per_").replace(" ", "_").replace("^", "")
            suffix = "" if e.unit in ("1", "") else f"_{unit}"
            name = e.name
            row[f"{name}{suffix}"] = e.value
            if e.frozen:
                continue
            spreads = {
                "std": e.standard_deviation,
                "noise_std": e.noise_deviation,
                "lower95": e.lower,
                "upper95": e.upper,
            }
            row |= {f"{name}_{key}{suffix}": value for key, value in spreads.items()}
            row[f"{name}_identifiable"] = e.identifiable
            row[f"{name}_bound"] = e.bound
        row |= {f"residual_rms_{channel}": value for channel, value in self.residual_rms.items()}
        return row | {
            "cost": self.cost,
            "effective_samples": self.effective_samples,
            "success": self.success,
            "status": self.status,
            "warnings": "; ".join(self.warnings),
        }


def make_curve(
    x: np.ndarray, measured: np.ndarray, model: np.ndarray, *labels: str
) -> dict[str, list[Any]]:
    """Make a curve of a result from equally long arrays and the labels of both axes."""
    return {
        "x": x.tolist(),
        "measured": measured.tolist(),
        "model": model.tolist(),
        "labels": list(labels),
    }


def short_name(fit: str) -> str:
    """Shorten the name of a fit for a table or a figure, without folder and suffix of its log."""
    path = Path(fit)
    return path.stem if path.suffix in (".parquet", ".csv") else path.name


def make_result(
    solution: Solution,
    intervals: Uncertainty,
    channels: Channels,
    facts: Facts,
    warnings: Sequence[str],
    constants: Collection[str] = (),
) -> FitResult:
    """Make the result of a solution and its intervals; parameters that are constants of the rig are
    left out.
    """
    parameters = solution.problem.parameters
    kept = [i for i, name in enumerate(parameters.names) if name not in constants]
    estimates = [e for e in _estimates(solution, intervals) if e.name not in constants]
    rms = {}
    for name, (rows, weight) in channels.items():
        rms[name] = float(np.sqrt(np.mean(np.square(solution.residual[rows])))) * weight
    directions = intervals.unidentifiable
    unidentifiable = tuple(text for text in directions if text.split(" ")[0] not in constants)
    beyond = parameters.by_name(intervals.beyond)
    best = solution.best
    found = [*warnings, *(f"the data do not determine {text}" for text in unidentifiable)]
    found += _bound_warnings(estimates, beyond)
    if not best.success:
        found.append(f"the solver did not finish: {best.status}")
    covariance = intervals.covariance[np.ix_(kept, kept)].tolist()
    return FitResult(
        name=solution.problem.name,
        estimates=tuple(estimates),
        covariance=tuple(map(tuple, covariance)),
        cost=best.cost - best.added_cost,
        added_cost=best.added_cost,
        residual_rms=rms,
        success=best.success,
        status=best.status,
        attempts=_attempts(solution),
        unidentifiable=unidentifiable,
        warnings=tuple(found),
        effective_samples=intervals.effective_samples,
        facts=dict(facts),
    )


def _estimates(solution: Solution, intervals: Uncertainty) -> list[Estimate]:
    """List the estimates of all parameters, in their order."""
    parameters = solution.problem.parameters
    sides = parameters.sides(solution.x)
    indices = {name: i for i, name in enumerate(parameters.names)}
    estimates = []
    for p in parameters.all:
        if p.fixed:
            value = p.initial
            estimate = Estimate(p.name, p.unit, value, 0.0, value, value, True, "", True, 0.0)
        else:
            i = indices[p.name]
            sigma = float(intervals.standard_deviation[i])
            identifiable = bool(intervals.identifiable[i])
            estimate = Estimate(
                p.name,
                p.unit,
                float(solution.x[i]),
                sigma,
                float(intervals.lower[i]),
                float(intervals.upper[i]),
                identifiable,
                # An unidentifiable parameter stays where it started, which may be a bound.
                BOUND_WORDS[int(sides[i])] if identifiable else "",
                noise_deviation=sigma,
            )
        estimates.append(estimate)
    return estimates


def _attempts(solution: Solution) -> tuple[Json, ...]:
    """Write the starts as plain data."""
    parameters = solution.problem.parameters
    return tuple(
        {
            "start": parameters.by_name(attempt.start),
            "found": parameters.by_name(attempt.x),
            "cost": attempt.cost,
            "success": attempt.success,
            "status": attempt.status,
            "iterations": attempt.iterations,
        }
        for attempt in solution.attempts
    )


def _bound_warnings(estimates: Sequence[Estimate], beyond: Values) -> list[str]:
    """Warn of estimates that stopped at a bound; `beyond` is in standard deviations, by name."""
    at_bounds = [e for e in estimates if e.bound]
    warnings = []
    for e in at_bounds:
        unit = "" if e.unit == "1" else " " + e.unit
        warnings.append(
            f"{e.name} stopped at its {e.bound} bound {e.value:.6g}{unit}, {beyond[e.name]:.2g} "
            "standard deviations from what the data ask for"
        )
    determined = sum(e.identifiable and not e.frozen for e in estimates)
    if at_bounds and len(at_bounds) < determined:
        names = ", ".join(e.name for e in at_bounds)
        warnings.append(f"the intervals of the others take {names} to lie within bounds")
    return warnings
