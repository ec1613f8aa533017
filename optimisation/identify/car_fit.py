"""Friction, slip and centre of mass of one car, with delay and bias, from a log of its own drive.

The commands of the log are played to the car of its scenario, and the unknowns are chosen so that
it moves as the sensors say. Residuals are divided by the noise of the sensors and a least error of
the model; a channel whose residual is larger, or is correlated in time, counts for its effective
samples. The effect of the plant's step is taken from a run at half the step and added; its size is
uncertain, which is part of every interval. Ranges of `models/parameters` are a weak prior. All
other numbers of the car are taken to be right.

The cost of a run is rough, since contacts come a step earlier or later; its derivatives over a
standard deviation are not. So a fit ends when its next step is small against the intervals, not
when it finds no lower cost.
"""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from aerodima.optimisation.identify.car_log import CHANNELS, CarDrive, Signals, car_drive
from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.fit_result import FitResult, make_curve, make_result
from aerodima.optimisation.identify.gauss_newton import SolverOptions, solve_from
from aerodima.optimisation.identify.least_squares import (
    Parameter,
    Parameters,
    Problem,
    Solution,
    StartResult,
)
from aerodima.optimisation.identify.noise import Noise, serial_noise
from aerodima.optimisation.identify.uncertainty import uncertainty
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.mapping import unit_in_name
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.car_parameters import CarParameters
from aerodima.workbench.scenario.scenario import Scenario

CAR = ("tyre_friction", "tyre_slip_angle", "com_height")
DELAY = "delay"
SPEED = "speed"
"""Name of the speed at the start of the run."""
DRIVEN = "driven_speed"
"""Name of the speed to which the throttle of the log drives the car."""
BIASES = {
    "yaw_rate": "gyro_bias_z",
    "roll_rate": "gyro_bias_x",
    "lateral_acceleration": "acceleration_bias_y",
}
"""Unknown that is added to a channel, by channel."""
UNITS = {"tyre_friction": "1", "tyre_slip_angle": "rad", "com_height": "m", DELAY: "s"}
UNITS |= {name: "rad/s" if "gyro" in name else "m/s2" for name in BIASES.values()}
DELAY_RANGE = (0.0, 0.15)
"""Range of the delay, s; no file of `models/parameters` has one."""
STEPS = {
    "tyre_friction": 2e-3,
    "tyre_slip_angle": 2e-3,
    "com_height": 5e-4,
    SPEED: 1e-2,
    DRIVEN: 1e-2,
}
"""Steps of the finite differences, about a standard deviation of each unknown: over such a step,
contacts that come a step of the plant earlier or later do not count."""
STEP_ERROR = (1.5, 0.5)
"""Factor on the change from halving the plant's step, and its standard deviation: 1 stands for a
plant of half the step, 2, to first order, for a plant without step error."""
_SPEED_REACH = 1.0
"""Distance of the bounds of the speeds from those of the GPS, m/s."""
_TILT = 0.01
"""Error of the attitude with which the IMU removes gravity, rad."""
_SCAN = ((0.2, 0.2), (0.5, 0.35), (0.8, 0.2), (0.5, 0.6))
"""Slip angle and height of the cars that are tried first, as shares of their ranges."""
_QUANTILE = 0.9
"""Quantile of the lateral acceleration over gravity from which their friction is taken."""
_FRICTION_FACTOR = 1.35
"""Ratio of the friction of the cars that are tried to that quantile."""
_DELAYS = np.arange(0.0, 0.1501, 0.005)
"""Delays that are tried, s."""
_TRUNCATION = {"yaw_rate": 1.0, "roll_rate": 1.0, "lateral_acceleration": 4.0, "speed": 0.5}
"""Residual at which each channel is cut off when the start is chosen, rad/s, m/s2 and m/s: one car
may roll over where another does not."""
MISFIT = 1.5
"""Ratio of the residual to what noise and the least error of the model allow, above which a misfit
is reported."""
SATURATED = 0.6
"""Share of their friction that the tyres must use, by the lateral acceleration, for a log to show
it; below it the fitted friction is a lower bound.

A log shows friction by how far the tyre's force bends away from a straight line, and tyre laws
differ in that. The brush tyre (Pacejka, Tire and Vehicle Dynamics, section 3.2) of the same
stiffness has the bend that our law (design section 7) has at 0.44, 0.6, 0.7 and 0.8 of its friction
at 0.28, 0.52, 0.69 and 0.86 of its own: there the same log means a friction that is 54, 16, 2 and
-6 % higher. A tyre whose force stays straight for longer has more. A simulated car that slides at
30 degrees of steering shows 0.7 to 0.83, since its forces brake it, too."""
OPEN = 0.8
"""Ratio of a number's standard deviation to that of its prior above which the log does not
determine the number."""
_OPTIONS = SolverOptions(max_steps=25, jacobian="secant", settled=0.01, roughness=2.0)
"""Solver options: a step that predicts less than a seventh of a standard deviation of all unknowns
together ends a fit; contacts that come a step earlier or later may raise its cost by two."""
_NEAR = 25.0
"""Predicted decrease of the cost below which the fit with the noise of the sensors alone ends."""


def prior_range(name: str, car: CarParameters) -> Pair:
    """Look up the prior range of an unknown of `UNITS`.

    A car of another size, whose own value lies outside the range of `models/parameters`, gets that
    range scaled in proportion.
    """
    if name == DELAY:
        return DELAY_RANGE
    if name == "acceleration_bias_y":
        return -9.81 * _TILT, 9.81 * _TILT
    section, key = ("car", name) if name in CAR else ("imu", "gyro_bias")
    entry = Scenario.parameters(section)[key]
    assert entry.prior is not None
    low, high = entry.prior
    if name not in CAR:
        return -high, high
    value = getattr(car, name)
    factor = 1.0 if low <= value <= high else value / float(entry.value)
    return factor * low, factor * high


def unknowns(drive: CarDrive) -> Parameters:
    """Make the unknowns of a fit, from the middle of their ranges; bounds lie half a range beyond
    them, but not below the least possible values: a delay is not negative.
    """
    gps = drive.channels["speed"]
    before = gps.value[gps.time < max(drive.turn, gps.time[1])]
    least = {
        "tyre_friction": 0.505 * drive.scenario.car.cage_friction,
        "tyre_slip_angle": 0.0,
        "com_height": 0.01,
        DELAY: 0.0,
    }
    parameters = []
    for name, speeds in ((SPEED, before[:2]), (DRIVEN, before[-3:])):
        v = float(np.mean(speeds))
        parameters.append(Parameter(name, "m/s", v, v - _SPEED_REACH, v + _SPEED_REACH, scale=0.05))
    # Only the roll rate shows the height.
    hidden = () if "roll_rate" in drive.channels else ("com_height", BIASES["roll_rate"])
    for name, unit in UNITS.items():
        if name in hidden:
            continue
        low, high = prior_range(name, drive.scenario.car)
        half = 0.5 * (high - low)
        lower = max(low - half, least.get(name, -math.inf))
        sigma = half / math.sqrt(3.0)
        parameters.append(Parameter(name, unit, low + half, lower, high + half, prior_std=sigma))
    return Parameters.of(parameters)


class CarModel:
    """Residual of a drive: rows of the channels, then a row for every prior.

    Attributes:
        drive: drive that is fitted.
        parameters: parameters of the fit, see `unknowns`.
        latency: latency of the commands of a car without tail, a whole number of ticks, s.
        scales: divisor of each channel's residual beside its deviation, by channel.
        noise: noise of the residual when the channels were last weighed.
        finer: change of the rows (m) from halving the plant's step; zeros until `find_step_error`
            has computed it.
    """

    def __init__(self, drive: CarDrive) -> None:
        self.drive = drive
        self.parameters = unknowns(drive)
        self.latency = 0.0
        self.gravity = drive.scenario.environment.gravity or 9.81
        self.noise = Noise(np.ones(1))
        self.scales = dict.fromkeys(drive.channels, 1.0)
        self._step = drive.scenario.simulation.step
        ends = np.cumsum([0, *(channel.time.size for channel in drive.channels.values())]).tolist()
        self.places = {
            name: slice(*span) for name, span in zip(drive.channels, pairwise(ends), strict=True)
        }
        self._known = [p for p in self.parameters.free if p.has_prior]
        self.finer = np.zeros(ends[-1] + len(self._known))
        self._runs: dict[tuple[float, ...], Signals] = {}

    def problem(self, x: FloatArray) -> Problem:
        """State the least-squares problem; its finite differences step from x towards the middle of
        the ranges.
        """
        steps = {**STEPS, DELAY: 2.0 * self._step} if self.drive.scenario.has_tail else STEPS
        sizes = np.array([steps.get(name, 1e-3) for name in self.parameters.names])
        return Problem(
            self.parameters,
            lambda x: self.rows(x) / self.divisors,
            name=self.drive.name,
            steps=np.where(x > self.parameters.initial, -sizes, sizes),
        )

    def run(self, values: dict[str, float], latency: float, step: float) -> Signals:
        """Simulate the car with these values and return its signals; they are cached."""
        car = {name: values[name] for name in CAR if name in values}
        speeds = values[SPEED], values[DRIVEN]
        key = (*car.values(), *speeds, latency, step)
        if key not in self._runs:
            self._runs[key] = self.drive.run(car, *speeds, latency, step)
        return self._runs[key]

    def rows(self, x: FloatArray, step: float | None = None) -> FloatArray:
        """Compute model minus log, then unknowns minus their priors, in their units (m).

        Commands are late by whole ticks; the rest of the delay shifts the motion in time. That is
        exact for the steering, but not for a tail, whose commands are not late.

        Args:
            x: unknowns (p).
            step: step of the plant, s; that of the scenario by default.
        """
        values = self.parameters.values(x)
        latency = self._whole_ticks(values[DELAY]) if self.drive.scenario.has_tail else self.latency
        motion = self.drive.sampled(
            self.run(values, latency, step or self._step), values[DELAY] - latency
        )
        rows = []
        for name, channel in self.drive.channels.items():
            rows.append(motion[name] + values.get(BIASES.get(name, ""), 0.0) - channel.value)
        priors = [values[p.name] - p.initial for p in self._known]
        return np.concatenate([*rows, priors]) + STEP_ERROR[0] * self.finer

    def _whole_ticks(self, time: float) -> float:
        return round(time / self._step) * self._step

    @property
    def divisors(self) -> FloatArray:
        """Divisors of the rows of the residual (m)."""
        sizes = [
            self.scales[name] * channel.deviation for name, channel in self.drive.channels.items()
        ]
        return np.concatenate([*sizes, [p.prior_std for p in self._known]])

    def find_step_error(self, x: FloatArray) -> None:
        """Compute the change of the rows from halving the plant's step, with the latency of x."""
        self.latency = self._whole_ticks(self.parameters.values(x)[DELAY])
        self.finer = self.rows(x, 0.5 * self._step) - self.rows(x)

    def start(self) -> FloatArray:
        """Choose the best of a few cars to start from (p).

        Their friction is taken from the lateral acceleration, and each gets its best delay.
        """
        drive = self.drive
        x = self.parameters.by_name(self.parameters.initial)
        best, lowest = x, math.inf
        low, high = np.array([prior_range(name, drive.scenario.car) for name in CAR]).T
        acceleration = np.abs(drive.channels["lateral_acceleration"].value)
        friction = _FRICTION_FACTOR * float(np.quantile(acceleration, _QUANTILE)) / self.gravity
        for shares in _SCAN:
            others = low[1:] + np.array(shares) * (high - low)[1:]
            tried = zip(CAR, np.clip([friction, *others], low, high).tolist(), strict=True)
            trial = x | {name: value for name, value in tried if name in x}
            try:
                run = self.run(trial, 0.0, self._step)
            except FitError:
                continue
            for delay in _DELAYS.tolist():
                cost = self._truncated_cost(drive.sampled(run, delay))
                if cost < lowest:
                    best, lowest = {**trial, DELAY: delay}, cost
        return np.array(list(best.values()))

    def _truncated_cost(self, motion: Signals) -> float:
        """Sum the squares of the residual over `_TRUNCATION`, each at most 1."""
        cost = 0.0
        for name, channel in self.drive.channels.items():
            size = np.abs(motion[name] - channel.value) / _TRUNCATION[name]
            cost += float(np.sum(np.square(np.minimum(size, 1.0))))
        return cost

    def weigh(self, x: FloatArray) -> FloatArray:
        """Scale the channels by the residual: each counts for its effective samples.

        Returns:
            Factors by which the divisors grow (m).
        """
        before = self.divisors
        residual = self.rows(x) / before
        noise = serial_noise(residual, list(self.places.values()), len(x))
        for name, place in self.places.items():
            self.scales[name] = max(self.scales[name] * math.sqrt(noise.covariance[place][0]), 1.0)
        self.noise = noise
        return self.divisors / before


def fit_car(drive: CarDrive) -> FitResult:
    """Fit one drive; FitError where no car of the ranges can be simulated.

    A first fit uses the noise of the sensors alone. A second one adds the error of the plant's step
    and weighs the channels anew in every step.
    """
    model = CarModel(drive)
    far = replace(_OPTIONS, settled=_NEAR)
    start = model.start()
    first = solve_from(model.problem(start), start, far)
    model.find_step_error(first.x)
    best = solve_from(model.problem(first.x), first.x, replace(_OPTIONS, reweigh=model.weigh))
    iterations = first.iterations + best.iterations
    return _result(model, replace(best, start=start, iterations=iterations))


def _result(model: CarModel, best: StartResult) -> FitResult:
    """Make the result of a model whose scales have settled."""
    x = best.x
    problem = model.problem(x)
    opened = []
    for p, side in zip(model.parameters.free, model.parameters.sides(x).tolist(), strict=True):
        lower = p.lower if side < 0 else -math.inf
        upper = p.upper if side > 0 else math.inf
        opened.append(replace(p, lower=lower, upper=upper, scale=p.size))
    residual = problem.residual(x)
    jacobian = best.jacobian
    if jacobian is None:
        jacobian = problem.forward_jacobian(x, residual)
    problem = replace(problem, parameters=Parameters.of(opened))
    solution = Solution(problem, x, residual, jacobian, best, (best,))
    stepped = STEP_ERROR[1] * model.finer / model.divisors
    covariance = np.eye(residual.size) + np.outer(stepped, stepped)
    free = model.parameters.free
    limits = [OPEN * p.prior_std if p.name in UNITS else math.inf for p in free]
    intervals = uncertainty(solution, replace(model.noise, covariance=covariance), np.array(limits))
    warnings = [*model.drive.warnings]
    poor = [f"{name} by {scale:.2g}" for name, scale in model.scales.items() if scale > MISFIT]
    if poor:
        warnings.append(
            f"the model misses more than it may, and intervals are wider for it: {', '.join(poor)}"
        )
    facts = {f"misfit_{name}": round(scale, 2) for name, scale in model.scales.items()}
    curves = _curves(model, x)
    used = np.max(np.abs(curves["lateral_acceleration"]["model"])) / model.gravity
    facts["friction_used"] = round(float(used / model.parameters.values(x)["tyre_friction"]), 2)
    if facts["friction_used"] < SATURATED:
        intervals.upper[model.parameters.names.index("tyre_friction")] = math.inf
        warnings.append(
            f"the tyres use {facts['friction_used']:g} of tyre_friction at most, which is then a "
            f"lower bound: below {SATURATED:g} a turn shows their stiffness, tyre_friction over "
            "tan(tyre_slip_angle)"
        )
    return replace(make_result(solution, intervals, {}, facts, warnings), curves=curves)


def _curves(model: CarModel, x: FloatArray) -> Json:
    """Make the curves of log and model by channel."""
    rows = model.rows(x)
    curves = {}
    for name, channel in model.drive.channels.items():
        modelled = channel.value + rows[model.places[name]]
        label = f"{name.replace('_', ' ')}, {unit_in_name(CHANNELS[name][1])}"
        curves[name] = make_curve(channel.time, channel.value, modelled, "time, s", label)
    return curves


def fit_car_log(path: Path | str, options: FitOptions = FREE) -> FitResult:
    """Fit the log of one drive of the car, or of its simulation: friction, slip, centre of mass,
    delay, biases.

    Args:
        path: path of the log.
        options: options of the fit; only their `settings` are used, which override the scenario of
            the log, such as with a mass that was weighed.

    Raises:
        LogError, FitError, ScenarioError: as `car_drive` and `fit_car`.
    """
    return fit_car(car_drive(read_run_log(path), options.settings))
