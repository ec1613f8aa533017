"""The published figures as data: the run that shows each, how far the model may be off, what the plan does with it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
import pandas as pd

from aerodima.optimisation.calibration.calibration_plan import LIFT, SPEED_IN_TURN, CalibrationPlan, fitted_names
from aerodima.optimisation.calibration.calibration_runs import Wanted
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Value
from aerodima.workbench.metrics.published_figures import (
    PublishedFigures,
    TurnMetrics,
    flip_bracket,
    inner_lift_yaw_rate,
    metric_column,
    published_figures,
)

Use = Literal["fitted", "follows", "commanded", "held out"]
"""`follows`: Kohut is speed times a yaw rate that is fitted, so its agreement is no evidence either."""

DEGREES = 4.0
"""Of freedom of the distribution of a misfit."""
COMMANDED = "speed_m_per_s"
TAIL_MODES = {"tailless": "none", "tailed": "swing"}


@dataclass(frozen=True)
class Turn:
    """A run that a figure is read from, whatever the car.

    Attributes:
        tail_mode: `none`, `held` or `swing`.
        speed: commanded, m/s.
    """

    tail_mode: str
    speed: float

    def wanted(self, car: Mapping[str, Value], step: float | None = None) -> Wanted:
        """This run of a car; step of the plant in s, None for the default."""
        return Wanted(car, self.tail_mode, self.speed, step)


@dataclass(frozen=True)
class Datum:
    """One published figure.

    Attributes:
        source: table or section.
        metric: name with unit.
        figure: as published, in the unit of the metric.
        discrepancy: standard deviation of what the model may be off, unit of the metric; 0 for what is commanded.
        use: what the plan does with it.
        turn: the run that shows it.
        column: of the row of that run.
    """

    source: str
    metric: str
    figure: float
    discrepancy: float
    use: Use
    turn: Turn
    column: str

    @property
    def name(self) -> str:
        """Unique: source and metric."""
        return f"{self.source} {self.metric}"

    def values(self, rows: pd.DataFrame) -> FloatArray:
        """The metric in rows (m) of the run; NaN where a run has none."""
        if self.column not in rows:
            return np.full(len(rows), np.nan)
        return np.asarray(pd.to_numeric(rows[self.column], errors="coerce"), float)


def plan_data(plan: CalibrationPlan, names: Collection[str] | None = None) -> tuple[Datum, ...]:
    """Every published figure of a turn, in the order of the plan's tables; Section 6.3.4 after Table 7.1.

    Args:
        plan: states the discrepancies.
        names: of what is fitted, as an ensemble file has them; those of the plan when left out.
    """
    chosen = frozenset(fitted_names(plan) if names is None else names)
    found: list[Datum] = []

    def add(source: str, metric: str, figure: float, turn: Turn, prefix: str = "") -> None:
        own = yaw_rate_of(metric)
        use: Use = "held out"
        if metric == COMMANDED:
            use = "commanded"
        elif f"{source} {own}" in chosen:
            use = "fitted" if metric == own else "follows"
        relative = 0.0 if metric == COMMANDED else plan.figures[source][own].discrepancy
        found.append(Datum(source, metric, figure, relative * abs(figure), use, turn, prefix + metric))

    for published in published_figures():
        turn = turn_of(published)
        for field in fields(TurnMetrics):
            prefix = metric_column("", published.platform)
            add(published.source, field.name, getattr(published.metrics, field.name), turn, prefix)
        if published.source == "Table 7.1":
            add(published.source, SPEED_IN_TURN, published.implied_speed, turn)
            add("Section 6.3.4", LIFT, inner_lift_yaw_rate(), turn)
    return tuple(found)


def fitted(data: Sequence[Datum]) -> tuple[Datum, ...]:
    """Those that enter the weights."""
    return tuple(datum for datum in data if datum.use == "fitted")


def turn_of(published: PublishedFigures) -> Turn:
    """The run of a published row: at the commanded speed of the simulated ones, else at the speed of the row."""
    speed = published.metrics.speed_m_per_s
    if published.platform == "simulated":
        speed = flip_bracket("tailless" if published.configuration == "tailless" else "tailed").survived
    return Turn(TAIL_MODES[published.configuration], speed)


def log_likelihood(data: Sequence[Datum], values: Mapping[str, FloatArray], number: int) -> FloatArray:
    """Logarithm of the probability of the figures given those of cars (number), up to a constant.

    Independent, `log_density` of each; -inf for a car without the metric.

    Args:
        data: fitted ones.
        values: name of the datum -> metric of the cars (number).
        number: of cars.
    """
    total: FloatArray = np.zeros(number)
    for datum in data:
        z = (values[datum.name] - datum.figure) / datum.discrepancy
        total = total + np.where(np.isfinite(z), log_density(z), -np.inf)
    return total


def log_density(z: FloatArray) -> FloatArray:
    """Student's t with `DEGREES` degrees of freedom, up to a constant, of a misfit in discrepancies.

    A discrepancy is itself known to a factor of about two only. With a Gaussian one figure that no car reaches would
    leave nothing of the others; so it counts, but does not decide alone.
    """
    found: FloatArray = -0.5 * (DEGREES + 1.0) * np.log1p(z**2 / DEGREES)
    return found


def yaw_rate_of(metric: str) -> str:
    """Kohut is speed times yaw rate; other metrics are themselves."""
    return metric.replace("kohut_deg_m_per_s2", "yaw_rate_rad_per_s")
