"""The plan of a calibration and its prior: a simulated and a real car that share a body, each with
tyres of its own.

A plan is a file of `models/calibration/plans` (schema `aerodima/calibration-plan/3`). A car of the
prior is a point of `CarPrior.names`: the body, the tyres of both systems, what stands between
motion and print, and the discrepancies.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from scipy.stats import norm, qmc

from aerodima.workbench.car.car_model import chassis_centre
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.metrics.published_values import (
    Platform,
    inner_lift_yaw_rate,
    published_values,
)
from aerodima.workbench.scenario.scenario import (
    SECTIONS,
    Scenario,
    load_parameter_entries,
    load_scenario,
)

FRICTION = "car.tyre_friction"
SLIP = "car.tyre_slip_angle"
NUISANCES = ("window", "latency", "gyro_bias", "forward")
OF_THE_FIELD = NUISANCES[1:]
FORWARD = 0.5
"""Value of `forward` above which the filter runs in one direction."""
LONGEST = {"window": 1.2, "latency": 0.3}
"""s; what is recorded around the steering allows no more."""
KEPT = 2000
"""Cars of a posterior that are kept."""
OFF = "discrepancy"
OFF_ROLL = "discrepancy of roll"
LIFT = "lift_yaw_rate_rad_per_s"
FIGURES = (
    "max_yaw_rate_rad_per_s",
    "average_yaw_rate_rad_per_s",
    "max_linear_acceleration_m_per_s2",
    "average_linear_acceleration_m_per_s2",
    "roll_integral_rad",
)
"""Metrics that carry information of their own: Kohut is speed times yaw rate, the speed is
commanded."""

Range = tuple[float, float]
Ends = Literal["survived", "flipped"]
Tail = Literal["none", "held", "swing"]


class Turn(StrictModel):
    """One published turn: system, tail mode, speed (m/s), how it ended, and the table that has its
    figures.
    """

    system: Platform
    tail: Tail
    speed: float = Field(gt=0)
    ends: Ends
    table: str = ""

    @property
    def name(self) -> str:
        """Unique in a plan."""
        return f"{self.system} {self.tail} {self.speed:g}"


class Density(StrictModel):
    """A normal prior in place of a uniform one, cut at the range of the parameter."""

    mean: float
    deviation: float = Field(gt=0)
    reason: str = Field(min_length=1)


class Size(StrictModel):
    """How much is run.

    Attributes:
        cars: reduced cars of a rough posterior that drive every turn, after half as many of the
            prior.
        rounds: of the search for the friction at which each of them flips.
        full: full cars that drive every turn and correct the reduced ones.
        full_rounds: runs of the search for the friction at which each of them flips.
        walkers, steps: of the sampler, for each posterior; the first third of the steps is dropped.
        ensemble: posterior cars that are run again with the full car.
        fine_step: of these runs, s.
    """

    cars: Annotated[int, Field(ge=40, le=20_000)]
    rounds: Annotated[int, Field(ge=2, le=10)]
    full: Annotated[int, Field(ge=4, le=1000)]
    full_rounds: Annotated[int, Field(ge=2, le=10)]
    walkers: Annotated[int, Field(ge=60, le=2000)]
    steps: Annotated[int, Field(ge=10, le=1_000_000)]
    ensemble: Annotated[int, Field(ge=1, le=1000)]
    fine_step: Annotated[float, Field(gt=0, le=0.002)]


class CalibrationPlan(StrictModel):
    """A plan as its file has it; the file says what each entry means."""

    schema_: Literal["aerodima/calibration-plan/3"] = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    seed: int = Field(ge=0)
    body: tuple[str, ...] = Field(min_length=1)
    each: tuple[Literal["car.tyre_friction"], Literal["car.tyre_slip_angle"]]
    ranges: dict[str, Range]
    density: dict[str, Density]
    nuisances: dict[str, Range]
    discrepancy: Range
    discrepancy_of_roll: Range
    outcome_width: dict[Tail, Annotated[float, Field(gt=0, le=1)]]
    turns: tuple[Turn, ...] = Field(min_length=1)
    settings: dict[Platform, tuple[str, ...]]
    left_out: dict[str, str]
    size: Size

    @model_validator(mode="after")
    def _names_are_known(self) -> Self:
        turns = self.turns
        keys = {*self.body, *self.each}
        of_systems = {f"{turn.system} {key}" for turn in turns for key in self.each}
        tables = {published.source for published in published_values()}
        figures = {f"{table} {metric}" for table in tables for metric in FIGURES}
        for place, names, allowed in (
            ("ranges", set(self.ranges), keys | of_systems),
            ("density", set(self.density), keys),
            ("nuisances", set(self.nuisances), set(NUISANCES)),
            ("left_out", set(self.left_out), figures),
            ("turns: table", {turn.table for turn in turns} - {""}, tables),
        ):
            for name in sorted(names - allowed):
                raise ValueError(f"{place}: {name!r}; {nearest(name, sorted(allowed))}")
        for name in NUISANCES:
            if name not in self.nuisances:
                raise ValueError(
                    f"nuisances: {name!r} is missing; needed are {', '.join(NUISANCES)}"
                )
        for tail in sorted({turn.tail for turn in turns} - set(self.outcome_width)):
            raise ValueError(
                f"outcome_width: {tail!r} is missing; needed is one for the tail of every turn"
            )
        off = ((OFF, self.discrepancy), (OFF_ROLL, self.discrepancy_of_roll))
        ranges = [*self.ranges.items(), *self.nuisances.items(), *off]
        for name, (low, high) in ranges:
            if not low < high:
                raise ValueError(f"{name}: {low:g} to {high:g}; allowed: the lower end first")
        for name, most in LONGEST.items():
            low, high = self.nuisances[name]
            if low < 0.0 or high > most:
                raise ValueError(
                    f"nuisances: {name}: {low:g} to {high:g} s; allowed: within 0 to {most:g} s"
                )
        shown = [turn.table for turn in turns if turn.table]
        for listed in (shown, [turn.name for turn in turns]):
            for name in listed:
                if listed.count(name) > 1:
                    raise ValueError(f"turns: {name!r} stands there twice; allowed: once")
        if len(shown) < 2 or any(
            all(f"{table} {metric}" in self.left_out for metric in FIGURES) for table in shown
        ):
            raise ValueError(
                f"turns: tables {', '.join(shown) or 'none'}; needed are two with figures that "
                "are not left out"
            )
        size = self.size
        cars = len(self.body) + 2 * len(self.each) + len(NUISANCES) + 2
        if size.walkers < 2 * cars:
            raise ValueError(
                f"size: walkers: {size.walkers}; allowed: at least {2 * cars}, twice the unknowns"
            )
        together = size.cars + size.full
        most = min(KEPT, size.walkers * size.steps)
        if together > most:
            raise ValueError(f"size: cars and full: {together}; allowed: {most} together")
        return self


def load_plan(name_or_path: str | Path = "two_systems") -> CalibrationPlan:
    """Loads a plan by path, or by name from `models/calibration/plans`.

    Raises:
        ScenarioError: names the file, the key and what is allowed.
    """
    path = find_file(name_or_path, "calibration/plans", "calibration plan")
    plan = checked(
        CalibrationPlan, read_yaml(path), str(path), schema="aerodima/calibration-plan/3"
    )
    for key in (*plan.body, *plan.each):
        _prior_range(key, str(path))
    return plan


def _prior_range(key: str, where: str = "prior") -> Range:
    section, _, name = key.partition(".")
    if section not in SECTIONS:
        raise ScenarioError(
            f"{where}: {key}: {section!r} is no section; {nearest(section, list(SECTIONS))}"
        )
    entries = load_parameter_entries(section)
    if name not in entries:
        raise ScenarioError(f"{where}: {key}: unknown key; {nearest(name, list(entries))}")
    prior = entries[name].prior
    if prior is None:
        known = [f"{section}.{other}" for other in entries if entries[other].prior is not None]
        others = ", ".join(sorted(known))
        raise ScenarioError(f"{where}: {key}: has no prior range; allowed in {section}: {others}")
    return prior


@dataclass(frozen=True)
class Figure:
    """One published figure that cars are held to.

    Attributes:
        turn: that shows it.
        metric: name with unit.
        published: value, in the unit of the metric.
    """

    turn: Turn
    metric: str
    published: float

    @property
    def name(self) -> str:
        """Unique: table and metric."""
        return f"{self.turn.table} {self.metric}"


def figures_of(plan: CalibrationPlan) -> tuple[Figure, ...]:
    """Figures that cars are held to, in the order of the tables."""
    rows = {published.source: published for published in published_values()}
    found = []
    for turn in plan.turns:
        if turn.table:
            metrics = rows[turn.table].metrics
            found += [Figure(turn, metric, getattr(metrics, metric)) for metric in FIGURES]
    return tuple(figure for figure in found if figure.name not in plan.left_out)


def lift_of(plan: CalibrationPlan) -> Figure:
    """Yaw rate up to which both inner wheels stay on the ground (thesis 6.3.4), of the first turn
    with a table.
    """
    return Figure(next(turn for turn in plan.turns if turn.table), LIFT, inner_lift_yaw_rate())


@dataclass(frozen=True)
class CarPrior:
    """Prior of both cars at once.

    Attributes:
        plan: that states it.
        names: of the coordinates of a car, the columns of all arrays of cars (m, n).
        ranges: lowest and highest value (n, 2), in the unit of each parameter.
    """

    plan: CalibrationPlan
    names: tuple[str, ...] = field(init=False)
    ranges: FloatArray = field(init=False)
    _base: Scenario = field(init=False, repr=False)

    def __post_init__(self) -> None:
        plan = self.plan
        systems = dict.fromkeys(turn.system for turn in plan.turns)
        keys = [*plan.body, *(f"{system} {key}" for system in systems for key in plan.each)]
        ranges = []
        for key in keys:
            name = key.split()[-1]
            ranges.append(plan.ranges.get(key) or plan.ranges.get(name) or _prior_range(name))
        ranges += [plan.nuisances[name] for name in NUISANCES]
        ranges += [plan.discrepancy, plan.discrepancy_of_roll]
        object.__setattr__(self, "names", (*keys, *NUISANCES, OFF, OFF_ROLL))
        object.__setattr__(self, "ranges", np.array(ranges))
        object.__setattr__(self, "_base", load_scenario("turn_swing"))

    def column(self, name: str) -> int:
        """Place of a coordinate."""
        return self.names.index(name)

    def inputs(self, system: Platform) -> list[int]:
        """Columns that a turn of a system depends on, its friction and slip angle last."""
        nuisances = NUISANCES if system == "physical" else NUISANCES[:1]
        names = [
            *self.plan.body,
            *nuisances,
            *(f"{system} {key}" for key in reversed(self.plan.each)),
        ]
        return [self.column(name) for name in names]

    def scaled(self, cars: FloatArray) -> FloatArray:
        """Cars (m, n) with -1 to 1 from end to end of each range; `forward` is a switch and has -1
        or 1 alone.
        """
        low, high = self.ranges.T
        scaled: FloatArray = 2.0 * (cars - low) / (high - low) - 1.0
        forward = self.column("forward")
        scaled[:, forward] = np.where(cars[:, forward] > FORWARD, 1.0, -1.0)
        return scaled

    def log_density(self, cars: FloatArray) -> FloatArray:
        """Logarithm of the density (m), up to a constant; -inf where a car cannot be."""
        low, high = self.ranges.T
        inside = np.all((cars >= low) & (cars <= high), axis=1)
        off = cars[:, [self.column(OFF), self.column(OFF_ROLL)]]
        total = -np.sum(np.log(np.maximum(off, 1e-9)), axis=1)
        for key, density in self.plan.density.items():
            for index in (number for number, name in enumerate(self.names) if name.endswith(key)):
                total = total + norm.logpdf(cars[:, index], density.mean, density.deviation)
        found = np.full(len(cars), -np.inf)
        found[inside] = np.where(self._can_be(cars[inside]), total[inside], -np.inf)
        return found

    def spread(self, number: int, seed: int) -> FloatArray:
        """Cars (m, n) that can be, evenly over the ranges, from a scrambled Sobol sequence."""
        low, high = self.ranges.T
        points = qmc.Sobol(len(self.names), seed=seed).random_base2(
            int(np.ceil(np.log2(4 * number)))
        )
        cars: FloatArray = low + points * (high - low)
        return cars[self._can_be(cars)][:number]

    def draw(self, number: int, seed: int) -> FloatArray:
        """Cars (number, n) of the prior."""
        rng = np.random.default_rng(seed)
        cars = self.spread(40 * number, seed)
        weight = np.exp(self.log_density(cars) - np.max(self.log_density(cars)))
        return cars[rng.choice(len(cars), number, p=weight / weight.sum())]

    def values(self, car: FloatArray, system: Platform) -> dict[str, float]:
        """Parameters of a car (n) as `section.key`, six digits, that its run in a system needs."""
        found = {name: car[self.column(name)] for name in self.plan.body}
        found |= {key: car[self.column(f"{system} {key}")] for key in self.plan.each}
        return {key: float(f"{value:.6g}") for key, value in found.items()}

    def settings(self, car: FloatArray, turn: Turn) -> list[str]:
        """Overrides of a scenario for one car (n) in a turn; a gyro bias moves the trigger."""
        values = {key: f"{value:.6g}" for key, value in self.values(car, turn.system).items()}
        if turn.system == "physical":
            trigger = self._base.controller.trigger_yaw_rate - car[self.column("gyro_bias")]
            values["controller.trigger_yaw_rate"] = f"{trigger:.6g}"
        given = [f"{key}={value}" for key, value in values.items()]
        return [*given, f"manoeuvre.speed={turn.speed!r}", *self.plan.settings.get(turn.system, ())]

    def _can_be(self, cars: FloatArray) -> NDArray[np.bool_]:
        """Which cars (m) of (m, n) exist: gyration of a body, and a chassis with its centre of mass
        inside the car.
        """
        sections: dict[str, Any] = {
            name: SimpleNamespace(**dict(getattr(self._base, name)))
            for name in ("car", "tail", "imu", "controller")
        }
        for key in self.plan.body:
            section, _, name = key.partition(".")
            setattr(sections[section], name, cars[:, self.column(key)])
        car = sections["car"]
        tail = sections["tail"]
        radii = np.sort(
            np.broadcast_arrays(car.gyration_roll, car.gyration_pitch, car.gyration_yaw), axis=0
        )
        mass, x, z = chassis_centre(car, tail, self._base.environment.gravity)
        inside = (
            (z > 0.05) & (z < 2 * car.com_height) & (x > 0.0) & (x < car.wheelbase) & (mass > 0.0)
        )
        sail = np.less_equal(tail.sail_length, tail.length)
        return np.broadcast_to(
            inside & sail & (radii[2] ** 2 <= radii[0] ** 2 + radii[1] ** 2), len(cars)
        )
