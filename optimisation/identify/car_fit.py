"""Friction, slip and centre of mass of one car, with delay and bias, from a log of its own drive.

The commands of the log are played to the car of its scenario, and the unknowns are those with which
it moves as the sensors say. Residuals are divided by the noise of the sensors and a least error of
the model; a channel whose residual is larger, or repeats itself, counts for as many samples as it
is worth. What the plant's step changes is taken from a run at half of it and added; how much of it,
is uncertain and part of every interval. Ranges of `models/parameters` are a weak prior. All other
numbers of the car are taken to be right.

The cost of a run is rough, since contacts come a step earlier or later; its derivatives over a
standard deviation are not. So a fit ends when its next step is small against the intervals, not
when it finds no lower cost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from aerodima.optimisation.identify.car_log import CarDrive, car_drive
from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.fit_pipeline import FitResult, result_of
from aerodima.optimisation.identify.least_squares import (
    Attempt,
    Parameter,
    Parameters,
    Problem,
    Solution,
)
from aerodima.optimisation.identify.least_squares_solvers import bounded_step, triangle
from aerodima.optimisation.identify.uncertainty import Noise, serial_noise, uncertainty
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.scenario import Scenario

CAR = ("tyre_friction", "tyre_slip_angle", "com_height")
DELAY = "delay"
SPEED = "speed"
"""Speed with which the run begins."""
DRIVEN = "driven_speed"
"""Speed that the throttle of the log drives to."""
BIASES = {
    "gyro_bias_z": "yaw_rate",
    "gyro_bias_x": "roll_rate",
    "acceleration_bias_y": "lateral_acceleration",
}
"""Unknown -> channel that it is added to."""
UNITS = {"tyre_friction": "1", "tyre_slip_angle": "rad", "com_height": "m", DELAY: "s"}
UNITS |= {name: "rad/s" if "gyro" in name else "m/s2" for name in BIASES}
PRIORS = {DELAY: (0.0, 0.15)}
"""Ranges where no file of `models/parameters` has one, s."""
STEPS = {
    "tyre_friction": 2e-3,
    "tyre_slip_angle": 2e-3,
    "com_height": 5e-4,
    SPEED: 1e-2,
    DRIVEN: 1e-2,
}
"""Steps of the finite differences, about a standard deviation of each: within it contacts that come
a step earlier or later do not count."""
STEP_ERROR = (1.5, 0.5)
"""How many times the change by half the plant's step is added to its motion, and the standard
deviation of that: once is a plant of half the step, twice, to first order, one without."""
_SPEED_REACH = 1.0
"""Bounds of the speeds about those of the GPS, m/s."""
_TILTED = 0.01
"""Error of the attitude with which the IMU takes gravity off, rad."""
_SCAN = ((0.2, 0.2), (0.5, 0.35), (0.8, 0.2), (0.5, 0.6))
"""Slip angle and height of the cars that are tried first, as shares of their ranges."""
_TOP = 0.9
"""Quantile of the lateral acceleration over gravity that gives the friction of the starts."""
_OF_FORCE = 1.35
"""Their friction is so many times that quantile."""
_LATENCIES = np.arange(0.0, 0.1501, 0.005)
"""Their delays, s."""
_WILD = {"yaw_rate": 1.0, "roll_rate": 1.0, "lateral_acceleration": 4.0, "speed": 0.5}
"""Where a residual stops to count for the start, rad/s, m/s2 and m/s: what rolls over in one car
and not in another."""
MISFIT = 1.5
"""Times what noise and the least error of the model allow, from which a misfit is reported."""
OPEN = 0.8
"""Share of a prior's deviation from which a log does not determine a number."""
_MOST_STEPS = 25
"""Most steps of a fit."""
_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
"""Shares of a Gauss-Newton step that are tried in turn."""
_FAR = 3.0
"""A mean square of the residual above this is far from what noise leaves."""
_NEAR = 25.0
"""Of the cost, in halves of a squared standard deviation: a next step that promises less is near;
channels are weighed and derivatives kept from there on."""
_SETTLED = 0.01
"""Of the cost: a next step that promises less, a seventh of a standard deviation of all unknowns
together, ends the fit."""
_ROUGH = 2.0
"""Of the cost, by which a step may raise it: contacts that come a step earlier or later make it
rough."""


def prior_of(name: str) -> tuple[float, float]:
    """Range of an unknown; NaN for one without."""
    if name in (*CAR, DELAY):
        return (Scenario.parameters("car")[name].prior if name in CAR else None) or PRIORS[name]
    if name.startswith("gyro_bias"):
        most = (Scenario.parameters("imu")["gyro_bias"].prior or (0.0, math.nan))[1]
    elif name in BIASES:
        most = 9.81 * _TILTED
    else:
        most = math.nan
    return -most, most


def unknowns(drive: CarDrive) -> Parameters:
    """Unknowns of a fit; seeds in the middle of their ranges, bounds half a range beyond them."""
    gps = drive.channels["speed"]
    before = gps.value[gps.time < max(drive.turn, gps.time[1])]
    least = {
        "tyre_friction": 0.505 * drive.scenario.car.cage_friction,
        "tyre_slip_angle": 0.0,
        "com_height": 0.01,
    }
    speeds = {SPEED: float(np.mean(before[:2])), DRIVEN: float(np.mean(before[-3:]))}
    found = [
        Parameter(name, "m/s", v, v - _SPEED_REACH, v + _SPEED_REACH, scale=0.05)
        for name, v in speeds.items()
    ]
    for name, unit in UNITS.items():
        low, high = prior_of(name)
        half = 0.5 * (high - low)
        lower = max(low - half, least.get(name, -math.inf))
        found.append(
            Parameter(name, unit, low + half, lower, high + half, deviation=half / math.sqrt(3.0))
        )
    return Parameters.of(found)


class CarModel:
    """Residual of a drive and its derivatives: rows of the channels, then one of every prior.

    Attributes:
        drive: that is fitted.
        parameters: see `unknowns`.
        scales: by channel, that its residual is divided by beside its deviation.
        latency: of the runs, whole ticks, s; what a delay differs by shifts their motion in time.
        finer: what half the plant's step changes in the rows, once `find_step_error` has found it.
    """

    def __init__(self, drive: CarDrive) -> None:
        self.drive = drive
        self.parameters = unknowns(drive)
        self.scales = dict.fromkeys(drive.channels, 1.0)
        self.latency = 0.0
        self._step = drive.scenario.simulation.step
        ends = np.cumsum([0, *(channel.time.size for channel in drive.channels.values())]).tolist()
        self.places = {
            name: slice(*span) for name, span in zip(drive.channels, pairwise(ends), strict=True)
        }
        self._known = [p for p in self.parameters.free if math.isfinite(p.deviation)]
        self.finer = np.zeros(ends[-1] + len(self._known))
        self._runs: dict[tuple[float, ...], Mapping[str, FloatArray]] = {}

    def values(self, x: FloatArray) -> dict[str, float]:
        """By name."""
        return dict(zip(self.parameters.names, x.tolist(), strict=True))

    def run(
        self, values: dict[str, float], latency: float, step: float
    ) -> Mapping[str, FloatArray]:
        """Signals of the car with these values, cached.

        Another driven speed is another line of the throttle.
        """
        key = (*(values[name] for name in (*CAR, SPEED, DRIVEN)), latency, step)
        if key not in self._runs:
            scenario = self.drive.scenario
            faster = values[DRIVEN] - self.drive.line_speed
            changes = {
                "car": {name: values[name] for name in CAR},
                "manoeuvre": {"speed": values[DRIVEN]},
                "drive": {"throttle_offset": scenario.drive.throttle_offset + faster},
                "simulation": {"step": step},
            }
            self._runs[key] = self.drive.run(changes, latency, values[SPEED])
        return self._runs[key]

    def rows(
        self, x: FloatArray, step: float | None = None, latency: float | None = None
    ) -> FloatArray:
        """Model less log, then unknown less seed, in their units (m); of another step and latency
        if they are named.
        """
        values = self.values(x)
        drive = self.drive
        latency = self.latency if latency is None else latency
        motion = drive.sampled(
            self.run(values, latency, step or self._step), values[DELAY] - latency
        )
        added = {channel: values[name] for name, channel in BIASES.items()}
        rows = [
            motion[name] + added.get(name, 0.0) - channel.value
            for name, channel in drive.channels.items()
        ]
        return (
            np.concatenate([*rows, [values[p.name] - p.seed for p in self._known]])
            + STEP_ERROR[0] * self.finer
        )

    @property
    def divisors(self) -> FloatArray:
        """What divides the rows of the residual (m)."""
        sizes = [
            self.scales[name] * channel.deviation for name, channel in self.drive.channels.items()
        ]
        return np.concatenate([*sizes, [p.deviation for p in self._known]])

    def slopes(self, x: FloatArray) -> FloatArray:
        """Derivatives of the rows (m x p): a run per unknown of the car, and of the delay where a
        tail is not late.
        """
        here = self.rows(x)
        columns = []
        for index, p in enumerate(self.parameters.free):
            moved = x.copy()
            latency = self.latency
            value = x[index]
            moved[index] += STEPS.get(p.name, 1e-3) * (-1.0 if value > p.seed else 1.0)
            if p.name == DELAY and self.drive.tailed:
                later = 2.0 * self._step
                latency += later
                moved[index] = value + later
            rise = self.rows(moved, latency=latency) - here
            columns.append(rise / (moved[index] - value))
        return np.array(columns).T

    def follow(self, x: FloatArray) -> None:
        """Moves the latency of the runs to the delay, if it is off by more than a tick."""
        delay = self.values(x)[DELAY]
        if abs(delay - self.latency) > self._step:
            self.latency = round(delay / self._step) * self._step

    def find_step_error(self, x: FloatArray) -> None:
        """Runs at half the plant's step."""
        self.follow(x)
        self.finer = self.rows(x, 0.5 * self._step) - self.rows(x)

    def start(self) -> FloatArray:
        """The best of a few cars, with the friction that the acceleration tells, each with its best
        latency (p).
        """
        names = self.parameters.names
        drive = self.drive
        best = math.inf
        found = self.parameters.seed
        low, high = np.array([prior_of(name) for name in CAR]).T
        acceleration = np.abs(drive.channels["lateral_acceleration"].value)
        top = float(np.quantile(acceleration, _TOP))
        friction = _OF_FORCE * top / (drive.scenario.environment.gravity or 9.81)
        places = [names.index(name) for name in CAR]
        for shares in _SCAN:
            x = self.parameters.seed
            others = low[1:] + np.array(shares) * (high - low)[1:]
            x[places] = np.clip([friction, *others], low, high)
            try:
                run = self.run(self.values(x), 0.0, self._step)
            except FitError:
                continue
            for latency in _LATENCIES.tolist():
                motion = drive.sampled(run, latency)
                off = [
                    np.abs(motion[name] - channel.value) / _WILD[name]
                    for name, channel in drive.channels.items()
                ]
                cost = sum(float(np.sum(np.square(np.minimum(part, 1.0)))) for part in off)
                if cost < best:
                    best = cost
                    found = x.copy()
                    found[names.index(DELAY)] = latency
        return found

    def weigh(self, x: FloatArray) -> Noise:
        """Scales from the residual: a channel counts for as many samples as it is worth."""
        residual = self.rows(x) / self.divisors
        noise = serial_noise(residual, list(self.places.values()), len(x))
        rise = {name: math.sqrt(noise.covariance[place][0]) for name, place in self.places.items()}
        self.scales = {name: max(s * rise[name], 1.0) for name, s in self.scales.items()}
        return noise


@dataclass
class Descent:
    """Gauss-Newton within the bounds, which ends when its next step is small against the intervals.

    Whether a step lowers the cost does not decide: the contacts of a run make it rough. Far off the
    derivatives are carried on by Broyden's update, and taken anew where it promises little; near
    the end they are kept.

    Attributes:
        model: of the drive; its scales and its step error are set on the way.
        x: unknowns (p).
        slopes: of the rows there (m x p).
        kept: whether they were taken elsewhere.
        near: whether channels are weighed.
        promised: by the last step near the end: derivatives are taken anew where the next one
            promises more than half.
        noise: of the residual as it was last weighed.
    """

    model: CarModel
    x: FloatArray
    slopes: FloatArray = field(default_factory=lambda: np.zeros(0))
    kept: bool = False
    near: bool = False
    promised: float = math.inf
    noise: Noise = field(default_factory=lambda: Noise(np.ones(1)))

    def run(self) -> Attempt:
        """Until it has settled, or cannot."""
        begun = self.x
        steps = 0
        status = ""
        while not status and steps < _MOST_STEPS:
            steps = steps + 1
            status = self._step()
        r = self.model.rows(self.x) / self.model.divisors
        cost = 0.5 * float(r @ r)
        settled = status.startswith("the next")
        reason = status or f"{steps} steps were not enough"
        return Attempt(begun, self.x, cost, settled, reason, steps)

    def _step(self) -> str:
        """One step, or what must be known before it; says why it is the last."""
        model = self.model
        near = self.near
        p = model.parameters
        scales = p.scales
        x = self.x
        if model.drive.tailed:
            model.follow(x)
        if not self.kept:
            self.slopes = model.slopes(x)
        here = model.rows(x)
        if near:
            self.noise = model.weigh(x)
        r = here / model.divisors
        J = self.slopes / model.divisors[:, None]
        cost = 0.5 * float(r @ r)
        size = 1.0 if near else max(2.0 * cost / r.size, 1.0)
        low = (p.lower - x) / scales
        high = (p.upper - x) / scales
        R, c = triangle(J * scales, r)
        step = scales * bounded_step(R, c, 0.0, low, high)
        promised = cost - 0.5 * float(np.sum(np.square(r + J @ step)))
        if not near:
            if self.kept and size > _FAR and promised < 0.5 * cost:
                self.kept = False
                return ""
            enough = _NEAR if size < _FAR else _SETTLED
            if promised / size < enough:
                self.near = True
                self.kept = False
                model.find_step_error(x)
                return ""
        if promised < _SETTLED * size:
            return "the next step is small against the intervals"
        if near and self.kept and promised > 0.5 * self.promised:
            self.kept = False
            return ""
        self.promised = promised if near else math.inf
        for share in _SHARES:
            moved = np.clip(x + share * step, p.lower, p.upper)
            try:
                there = model.rows(moved)
            except FitError:
                continue
            squares = np.square(there / model.divisors)
            rise = 0.5 * float(np.sum(squares)) - cost
            if rise < _ROUGH * size:
                break
        else:
            if not self.kept:
                return "no step lowers the cost"
            self.kept = False
            return ""
        allowed = _ROUGH if near else -0.5 * promised
        self.kept = share == 1.0 and rise < allowed
        if self.kept and not near:  # Broyden's update
            way = moved - x
            u = way / scales
            missed = there - here - self.slopes @ way
            self.slopes = self.slopes + np.outer(missed, u / scales) / (u @ u)
        self.x = moved
        return ""


def fit_car(drive: CarDrive) -> FitResult:
    """Estimates of one drive; FitError where no car of the ranges can be simulated."""
    model = CarModel(drive)
    descent = Descent(model, model.start())
    best = descent.run()
    p = model.parameters
    x = best.x
    noise = descent.noise
    opened = []
    for q, side in zip(p.free, p.sides(x).tolist(), strict=True):
        lower = q.lower if side < 0 else -math.inf
        upper = q.upper if side > 0 else math.inf
        opened.append(replace(q, lower=lower, upper=upper, scale=q.size))
    problem = Problem(
        Parameters.of(opened), lambda x: model.rows(x) / model.divisors, name=drive.name
    )
    jacobian = descent.slopes / model.divisors[:, None]
    residual = problem.residual(x)
    solution = Solution(problem, x, residual, jacobian, best, (best,))
    stepped = STEP_ERROR[1] * model.finer / model.divisors
    covariance = np.eye(residual.size) + np.outer(stepped, stepped)
    sure = uncertainty(solution, replace(noise, covariance=covariance))
    warnings = [*drive.warnings]
    poor = [f"{name} by {scale:.2g}" for name, scale in model.scales.items() if scale > MISFIT]
    if poor:
        warnings.append(
            f"the model misses more than it may, and intervals are wider for it: {', '.join(poor)}"
        )
    for q, deviation in zip(p.free, sure.standard_deviation.tolist(), strict=True):
        if q.name in UNITS and deviation > OPEN * q.deviation:
            warnings.append(
                f"the log does not determine {q.name}; its interval is that of the prior"
            )
    facts = {f"misfit_{name}": round(scale, 2) for name, scale in model.scales.items()}
    return result_of(solution, sure, {}, facts, warnings)


def fit_car_log(path: Path | str, options: FitOptions = FREE) -> FitResult:
    """Fits the log of one drive of the car, or of its simulation: friction, slip, centre of mass,
    delay, biases.

    Args:
        path: of the log.
        options: its `settings` go over the scenario of the log, such as a mass that was weighed.

    Raises:
        LogError, FitError, ScenarioError: as `car_drive` and `fit_car`.
    """
    return fit_car(car_drive(read_run_log(path), options.settings))
