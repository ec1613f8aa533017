"""The published figures as data, the runs that show them, and the store that keeps these runs.

Every decision of a calibration follows from its plan, its seed and the rows of its runs. So the same command with the
same folder repeats the decisions, takes the rows that are there, and runs only what is missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.calibration.calibration_plan import LIFT, SPEED_IN_TURN, CalibrationPlan, fitted_names
from aerodima.optimisation.sweep.runs import Runs, RunTask, tipped_before_turn
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine, RowStore, content_key, silent
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Value
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.metrics.published_values import (
    PublishedValues,
    TurnMetrics,
    flip_bracket,
    inner_lift_yaw_rate,
    metric_column,
    published_values,
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

    for published in published_values():
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


def turn_of(published: PublishedValues) -> Turn:
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


RUNS_SCHEMA = "aerodima/calibration-runs/3"
RUNS = "runs.jsonl"
SCENARIOS = ("turn_none", "turn_held", "turn_swing", "slalom")
"""Whose numbers must be those of the runs that a folder holds, whatever varies from car to car."""

DEFAULT_LOG_RATE = 500.0
"""Hz; a coarser step than its period logs every step."""


@dataclass(frozen=True)
class Wanted:
    """One run of a car.

    Attributes:
        values: `section.key` -> value.
        tail_mode: `none`, `held` or `swing`.
        speed: commanded, m/s.
        step: of the plant, s; None for the default.
        manoeuvre: of the scenario, `turn` or `slalom`; a slalom has no tail arm.
        settings: further overrides.
    """

    values: Mapping[str, Value]
    tail_mode: str
    speed: float
    step: float | None = None
    manoeuvre: str = "turn"
    settings: tuple[str, ...] = ()

    def task(self) -> RunTask:
        """As a task of the engine; its name is its content, so equal runs have equal names.

        Without a tail arm its parameters say nothing; they are left out, so that cars that differ in them share a run.
        """
        acting = {
            key: value for key, value in self.values.items() if self.tail_mode != "none" or _acts_without_arm(key)
        }
        settings = [f"{key}={value}" for key, value in acting.items()]
        settings += [f"manoeuvre.speed={self.speed!r}", *self.settings]
        if self.step is not None:
            rate = min(DEFAULT_LOG_RATE, 1.0 / self.step)
            settings += [f"simulation.step={self.step!r}", f"simulation.log_rate={rate:.9g}"]
        scenario = f"turn_{self.tail_mode}" if self.manoeuvre == "turn" else self.manoeuvre
        digest = hashlib.sha256("\n".join([scenario, *settings]).encode()).hexdigest()[:20]
        return RunTask(digest, scenario, tuple(settings))


def car_values(keys: Sequence[str], rows: NDArray[np.float64]) -> list[dict[str, Value]]:
    """Cars of rows of parameters (m, n), with six digits: what a run gets is what a file says."""
    return [{key: float(f"{value:.6g}") for key, value in zip(keys, row, strict=True)} for row in rows]


class RunStore(RowStore):
    """Rows of finished runs in `runs.jsonl` of a folder, which is locked as long as the store lives.

    Args:
        folder: made when it is not there.
        varied: keys that vary from car to car, left out of what must agree.
        force: drop the rows that are there.

    Raises:
        UserError: as `RowStore`.
    """

    def __init__(self, folder: str | Path, varied: Iterable[str], *, force: bool = False):
        bases = {name: _digest(load_scenario(name), tuple(varied)) for name in SCENARIOS}
        identity = {"schema": RUNS_SCHEMA, "versions": software_versions(), "scenarios": bases}
        super().__init__(Path(folder) / RUNS, identity, force=force)

    @classmethod
    def for_plan(cls, folder: str | Path, plan: CalibrationPlan, *, force: bool = False) -> Self:
        """The store of a calibration: what its plan varies differs from car to car."""
        return cls(folder, (*plan.car, *plan.tail), force=force)

    def run(
        self, wanted: Sequence[Wanted], engine: Engine, progress: ProgressLine = silent, what: str = ""
    ) -> pd.DataFrame:
        """Rows of runs, in their order; those that are not in the store are run and stored first."""
        return pd.DataFrame(Runs(engine, self, progress, what).rows([run.task() for run in wanted]))

    def __len__(self) -> int:
        return len(self.rows)


Cars = TypeVar("Cars")


def joined(first: Cars, second: Cars) -> Cars:
    """Two of a dataclass of arrays, tables and dictionaries of arrays by car as one, field by field."""
    pairs = {f.name: (getattr(first, f.name), getattr(second, f.name)) for f in fields(first)}  # type: ignore[arg-type]
    return replace(first, **{name: _one_behind_the_other(*pair) for name, pair in pairs.items()})  # type: ignore[type-var]


def _one_behind_the_other(first: Any, second: Any) -> Any:
    if isinstance(first, dict):
        return {name: _one_behind_the_other(values, second[name]) for name, values in first.items()}
    if isinstance(first, pd.DataFrame):
        return pd.concat([first, second], ignore_index=True)
    return np.concatenate([first, second])


def survives(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Which runs survived (m)."""
    return np.asarray(rows["outcome"] == "survived", bool)


def flips_in_the_turn(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Which runs flipped in the turn (m), not before it. A run without outcome is neither a survival nor a flip."""
    tipped = [tipped_before_turn(row) for row in rows.to_dict("records")]
    return np.asarray(rows["outcome"] == "flipped", bool) & ~np.array(tipped, bool)


def _acts_without_arm(key: str) -> bool:
    """The place of the tail's joints is that of the gearbox, which stays on the car."""
    return not key.startswith("tail.") or key.startswith("tail.mount_")


def _digest(base: Scenario, varied: Sequence[str]) -> str:
    content = base.resolved()
    for key in varied:
        section, _, name = key.partition(".")
        content[section].pop(name, None)
    return content_key(content)
