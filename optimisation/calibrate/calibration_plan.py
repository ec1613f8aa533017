"""The plan of a calibration and its prior: a simulated and a real car that share a body, each with
tyres of its own.

A plan is a file of `models/calibration/plans` (schema `aerodima/calibration-plan/3`). A car of the
prior is a point of `CarPrior.names`: the body, the tyres of both systems, what stands between
motion and print, and the discrepancies.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator
from scipy.stats import norm, qmc

from aerodima.workbench.car.car_model import chassis_centre
from aerodima.workbench.core.array_types import FloatArray, NamedArrays, Pair, Texts
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.key_errors import nearest, require_unique
from aerodima.workbench.core.yaml_files import StrictModel, checked, find_file, read_yaml
from aerodima.workbench.metrics.published_values import (
    Platform,
    inner_lift_yaw_rate,
    published_values,
)
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

FRICTION = "car.tyre_friction"
SLIP = "car.tyre_slip_angle"
CAUSAL_FILTER_THRESHOLD = 0.5
"""Value of `forward` above which the filter runs in one direction."""
MAX_NUISANCES: dict[Nuisance, float] = {"window": 1.2, "latency": 0.3}
"""Largest values of nuisances, s; the recording around the steering allows no more."""
MAX_POSTERIOR_SAMPLES = 2000
"""Number of cars of a posterior that are kept."""
DISCREPANCY = "discrepancy"
ROLL_DISCREPANCY = "discrepancy of roll"
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
NEEDED = (
    *("car.com_height", "car.com_x", "car.gyration_yaw", "car.mass", "car.track"),
    *("imu.x", "imu.z", "tail.length", "tail.mass", "tail.sail_width", "controller.delay"),
)
"""Keys that every body has, for figures, parts and `calibration/measurements.csv`."""
SCHEMA = "aerodima/calibration-plan/3"


def _ordered(ends: Pair) -> Pair:
    low, high = ends
    if not low < high:
        raise ValueError(f"{low:g} to {high:g}; the lower end must come first")
    return ends


Range = Annotated[Pair, AfterValidator(_ordered)]
"""Lower and upper end of a range."""
Ends = Literal["survived", "flipped"]
Tail = Literal["none", "held", "swing"]
Nuisance = Literal["window", "latency", "gyro_bias", "forward"]
NUISANCES: tuple[Nuisance, ...] = get_args(Nuisance)
Mean = Literal["average_yaw_rate_rad_per_s", "average_linear_acceleration_m_per_s2"]
MEANS: tuple[Mean, ...] = get_args(Mean)
"""Metrics that a trend may describe."""


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
        """Name of the turn, unique in a plan."""
        return f"{self.system} {self.tail} {self.speed:g}"

    @property
    def friction(self) -> str:
        """Name of the coordinate that is the friction of its tyres."""
        return f"{self.system} {FRICTION}"


class NormalPrior(StrictModel):
    """A normal prior in place of a uniform one, cut at the range of the parameter."""

    mean: float
    deviation: float = Field(gt=0)
    reason: str = Field(min_length=1)


class Trend(StrictModel):
    """A mean over the turn that goes with a power of the speed.

    The trend passes through the table of these turns, at its speed.

    Attributes:
        system: system of the turns.
        tail: tail mode of the turns.
        metric: one of `MEANS`.
        exponent: exponent of the speed; 0 for a constant.
        speeds: speeds other than that of the table, m/s.
        deviation: standard deviation of one value from the trend, in its logarithm.
        source: place in the thesis.
    """

    system: Platform
    tail: Tail
    metric: Mean
    exponent: float
    speeds: tuple[Annotated[float, Field(gt=0)], ...] = Field(min_length=1)
    deviation: float = Field(gt=0)
    source: str = Field(min_length=1)

    def turns(self) -> list[Turn]:
        """Returns a turn for each of the speeds."""
        return [
            Turn(system=self.system, tail=self.tail, speed=speed, ends="survived")
            for speed in self.speeds
        ]


class Budget(StrictModel):
    """Number of cars, runs and steps.

    Attributes:
        cars: number of reduced cars of a rough posterior that drive every turn, after half as many
            of the prior.
        rounds: number of rounds of the search for the friction at which each reduced car flips.
        full: number of full cars that drive every turn and correct the reduced ones.
        full_rounds: number of runs of the search for the friction at which each full car flips.
        walkers: number of walkers of the sampler, for each posterior.
        steps: number of steps of the sampler, for each posterior; the first third is dropped.
        ensemble: number of posterior cars that are run again with the full car.
        fine_step: step of these runs, s.
    """

    cars: int = Field(ge=40, le=20_000)
    rounds: int = Field(ge=2, le=10)
    full: int = Field(ge=4, le=1000)
    full_rounds: int = Field(ge=2, le=10)
    walkers: int = Field(ge=60, le=2000)
    steps: int = Field(ge=10, le=1_000_000)
    ensemble: int = Field(ge=1, le=1000)
    fine_step: float = Field(gt=0, le=0.002)


class CalibrationPlan(StrictModel):
    """A plan as its file has it; the file says what each entry means."""

    schema_: str = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    seed: int = Field(ge=0)
    body: Texts = Field(min_length=1)
    each: tuple[Literal["car.tyre_friction"], Literal["car.tyre_slip_angle"]]
    ranges: dict[str, Range]
    density: dict[str, NormalPrior]
    nuisances: dict[Nuisance, Range]
    discrepancy: Range
    discrepancy_of_roll: Range
    outcome_width: dict[Tail, Annotated[float, Field(gt=0, le=1)]]
    turns: tuple[Turn, ...] = Field(min_length=1)
    trends: tuple[Trend, ...] = ()
    settings: dict[Platform, Settings]
    left_out: dict[str, str]
    size: Budget

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        self._require_known_names()
        self._require_nuisances()
        self._require_tables()
        for trend in self.trends:
            self.reference(trend)
        size = self.size
        unknowns = len(self.body) + 2 * len(self.each) + len(NUISANCES) + 2
        if size.walkers < 2 * unknowns:
            raise ValueError(
                f"size: walkers: {size.walkers}; must be at least {2 * unknowns}, twice the "
                "unknowns"
            )
        together = size.cars + size.full
        most = min(MAX_POSTERIOR_SAMPLES, size.walkers * size.steps)
        if together > most:
            raise ValueError(f"size: cars and full: {together}; must be at most {most} together")
        return self

    def _require_known_names(self) -> None:
        keys = {*self.body, *self.each}
        for key in keys:
            _prior_range(key)
        of_systems = {f"{turn.system} {key}" for turn in self.turns for key in self.each}
        tables = {published.source for published in published_values()}
        figures = {f"{table} {metric}" for table in tables for metric in FIGURES}
        shown = {turn.table for turn in self.turns if turn.table}
        for place, names, known in (
            ("ranges", self.ranges, keys | of_systems),
            ("density", self.density, keys | of_systems),
            ("left_out", self.left_out, figures),
            ("turns: table", shown, tables),
        ):
            for name in sorted(set(names) - known):
                raise ValueError(f"{place}: {name!r}; {nearest(name, known)}")
        for place, needed, given in (
            ("body", NEEDED, keys),
            ("turns: system", {"physical"}, {turn.system for turn in self.turns}),
            ("outcome_width", {turn.tail for turn in self.turns}, self.outcome_width),
            ("nuisances", NUISANCES, self.nuisances),
        ):
            missing = sorted(set(needed).difference(given))
            if missing:
                raise ValueError(f"{place}: missing: {', '.join(missing)}")

    @property
    def trend_turns(self) -> dict[str, Turn]:
        """Turns of the trends by their names; two trends may share one."""
        return {turn.name: turn for trend in self.trends for turn in trend.turns()}

    def reference(self, trend: Trend) -> Turn:
        """Returns the turn with a table that a trend passes through.

        Raises:
            ValueError: no such turn.
        """
        for turn in self.turns:
            if turn.table and (turn.system, turn.tail) == (trend.system, trend.tail):
                return turn
        raise ValueError(f"trends: no turn of {trend.system} {trend.tail} has a table")

    def _require_nuisances(self) -> None:
        for name, most in MAX_NUISANCES.items():
            low, high = self.nuisances[name]
            if low < 0.0 or high > most:
                raise ValueError(
                    f"nuisances: {name}: {low:g} to {high:g} s; must be within 0 to {most:g} s"
                )

    def _require_tables(self) -> None:
        shown = [turn.table for turn in self.turns if turn.table]
        require_unique([*shown, *(turn.name for turn in self.turns)], "turns:")
        used = {figure.turn.table for figure in figures_of(self)}
        if len(shown) < 2 or used != set(shown):
            raise ValueError(
                f"turns: tables {', '.join(shown) or 'none'}; needed are two with figures that "
                "are not left out"
            )


def load_plan(name_or_path: str | Path = "two_systems") -> CalibrationPlan:
    """Loads a plan by path, or by name from `models/calibration/plans`.

    Raises:
        ScenarioError: names the file, the key and what is allowed.
    """
    path = find_file(name_or_path, "calibration/plans", "calibration plan")
    return checked(CalibrationPlan, read_yaml(path), str(path), schema=SCHEMA)


def _prior_range(key: str) -> Range:
    """Looks up the prior of a parameter, `section.key`, in its file."""
    Scenario.require_key(key)
    section, _, name = key.partition(".")
    entries = Scenario.parameters(section)
    prior = entries[name].prior
    if prior is None:
        known = [other for other, entry in entries.items() if entry.prior is not None]
        raise ScenarioError(f"{key}: has no prior range; {nearest(name, known)}")
    return prior


@dataclass(frozen=True)
class Figure:
    """One published figure that cars are held to.

    Attributes:
        turn: turn that shows the figure.
        metric: name of the metric, with its unit.
        published: published value, in the unit of the metric.
    """

    turn: Turn
    metric: str
    published: float

    @property
    def name(self) -> str:
        """Name of the figure, which is unique: table and metric."""
        return f"{self.turn.table} {self.metric}"


def figures_of(plan: CalibrationPlan) -> tuple[Figure, ...]:
    """Returns the figures that cars are compared with, in the order of the tables."""
    rows = {published.source: published.metrics for published in published_values()}
    figures = []
    for turn in plan.turns:
        for metric in FIGURES if turn.table else ():
            figure = Figure(turn, metric, getattr(rows[turn.table], metric))
            if figure.name not in plan.left_out:
                figures.append(figure)
    return tuple(figures)


def lift_of(plan: CalibrationPlan) -> Figure:
    """Returns the yaw rate up to which both inner wheels stay on the ground (thesis 6.3.4), of the
    first turn with a table.
    """
    return Figure(next(turn for turn in plan.turns if turn.table), LIFT, inner_lift_yaw_rate())


@dataclass(frozen=True)
class CarPrior:
    """Prior of both cars at once.

    Attributes:
        plan: plan that states the prior.
    """

    plan: CalibrationPlan

    @cached_property
    def names(self) -> Texts:
        """Names of the coordinates of a car, the columns of all arrays of cars (m, n)."""
        plan = self.plan
        systems = dict.fromkeys(turn.system for turn in plan.turns)
        tyres = [f"{system} {key}" for system in systems for key in plan.each]
        return (*plan.body, *tyres, *NUISANCES, DISCREPANCY, ROLL_DISCREPANCY)

    @cached_property
    def ranges(self) -> FloatArray:
        """Lowest and highest value of each coordinate (n, 2), in its unit."""
        plan = self.plan
        off = {DISCREPANCY: plan.discrepancy, ROLL_DISCREPANCY: plan.discrepancy_of_roll}
        stated = dict[str, Pair](plan.ranges) | plan.nuisances | off
        ranges = []
        for name in self.names:
            key = name.split()[-1]
            ranges.append(stated.get(name) or stated.get(key) or _prior_range(key))
        return np.array(ranges)

    @cached_property
    def _base(self) -> Scenario:
        """Scenario whose car is changed."""
        return load_scenario("turn_swing")

    def column(self, name: str) -> int:
        """Returns the column of a coordinate."""
        return self.names.index(name)

    def inputs(self, system: Platform) -> list[int]:
        """Returns the columns that a turn of a system depends on, its friction and slip angle
        last.
        """
        nuisances = NUISANCES if system == "physical" else NUISANCES[:1]
        tyres = [f"{system} {key}" for key in reversed(self.plan.each)]
        return [self.column(name) for name in (*self.plan.body, *nuisances, *tyres)]

    def scaled(self, cars: FloatArray) -> FloatArray:
        """Scales cars (m, n) so that each range goes from -1 to 1; `forward` is a switch and is
        either -1 or 1.
        """
        low, high = self.ranges.T
        scaled: FloatArray = 2.0 * (cars - low) / (high - low) - 1.0
        forward = self.column("forward")
        scaled[:, forward] = np.where(cars[:, forward] > CAUSAL_FILTER_THRESHOLD, 1.0, -1.0)
        return scaled

    def log_density(self, cars: FloatArray) -> FloatArray:
        """Returns the logarithm of the density (m), up to a constant; -inf where a car cannot
        exist.
        """
        low, high = self.ranges.T
        inside = np.all((cars >= low) & (cars <= high), axis=1)
        off = cars[:, [self.column(DISCREPANCY), self.column(ROLL_DISCREPANCY)]]
        total = -np.sum(np.log(np.maximum(off, 1e-9)), axis=1)
        for key, density in self.plan.density.items():
            for index, name in enumerate(self.names):
                if name.endswith(key):
                    total = total + norm.logpdf(cars[:, index], density.mean, density.deviation)
        inside[inside] = self._can_be(cars[inside])
        return np.where(inside, total, -np.inf)

    def spread(self, number: int, seed: int) -> FloatArray:
        """Returns cars (m, n) that can exist, evenly spread over the ranges, from a scrambled Sobol
        sequence.
        """
        low, high = self.ranges.T
        power = int(np.ceil(np.log2(4 * number)))
        points = qmc.Sobol(len(self.names), seed=seed).random_base2(power)
        cars = low + points * (high - low)
        return cars[self._can_be(cars)][:number]

    def draw(self, number: int, seed: int) -> FloatArray:
        """Draws cars (number, n) from the prior."""
        cars = self.spread(40 * number, seed)
        density = self.log_density(cars)
        weight = np.exp(density - np.max(density))
        chosen = np.random.default_rng(seed).choice(len(cars), number, p=weight / weight.sum())
        return cars[chosen]

    def settings(self, car: FloatArray, turn: Turn) -> list[str]:
        """Returns the overrides of a scenario for one car (n) in a turn, with six digits; a gyro
        bias moves the trigger.
        """
        system = turn.system
        values = {name: car[self.column(name)] for name in self.plan.body}
        values |= {key: car[self.column(f"{system} {key}")] for key in self.plan.each}
        if system == "physical":
            trigger = self._base.controller.trigger_yaw_rate - car[self.column("gyro_bias")]
            values["controller.trigger_yaw_rate"] = trigger
        settings = [f"{key}={value:.6g}" for key, value in values.items()]
        settings.append(f"manoeuvre.speed={turn.speed!r}")
        return [*settings, *self.plan.settings.get(system, ())]

    def _can_be(self, cars: FloatArray) -> NDArray[np.bool_]:
        """Flags (m) the cars (m, n) that can exist: with the gyration of a body, and a chassis with
        its centre of mass inside the car.
        """
        changes: dict[str, NamedArrays] = defaultdict(dict)
        for key in self.plan.body:
            section, _, name = key.partition(".")
            changes[section][name] = cars[:, self.column(key)]
        car = self._base.car.model_copy(update=changes["car"])
        tail = self._base.tail.model_copy(update=changes["tail"])
        gyration = (car.gyration_roll, car.gyration_pitch, car.gyration_yaw)
        radii = np.sort(np.broadcast_arrays(*gyration), axis=0) ** 2
        mass, x, z = chassis_centre(car, tail, self._base.environment.gravity)
        good = (mass > 0.0) & (x > 0.0) & (x < car.wheelbase)
        good = good & (z > 0.05) & (z < 2 * car.com_height)
        good = good & (radii[2] <= radii[0] + radii[1])
        good = good & np.less_equal(tail.sail_length, tail.length)
        return np.broadcast_to(good, len(cars))
