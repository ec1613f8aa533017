"""Friction, slip and centre of mass of one car, with delay and bias, from a log of its own drive.

The commands of the log are played to the car of its scenario, and the unknowns are those with which it moves as the
sensors say. Residuals are divided by the noise of the sensors and a least error of the model; a channel whose residual
is larger, or repeats itself, counts for as many samples as it is worth. What the step of the plant changes, of which a
run at half of it tells, is one error of all samples and part of every interval. Ranges of `models/parameters` are a
weak prior. All other numbers of the car are taken to be right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy.stats import qmc

from aerodima.optimisation.identify.car_log import CarDrive, car_drive
from aerodima.optimisation.identify.fit_pipeline import FitResult, fit, short_name
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem, Solution
from aerodima.optimisation.identify.least_squares_solvers import solve_rollout
from aerodima.optimisation.identify.log_rig import FREE, FitOptions, differences
from aerodima.optimisation.identify.uncertainty import Noise, serial_noise
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import read_run_log

CAR = ("tyre_friction", "tyre_slip_angle", "com_height")
DELAY, SPEED = "delay", "speed"
BIASES = {"gyro_bias_z": "yaw_rate", "gyro_bias_x": "roll_rate", "acceleration_bias_y": "lateral_acceleration"}
"""Unknown -> channel that it is added to."""
UNITS = {"tyre_friction": "1", "tyre_slip_angle": "rad", "com_height": "m", DELAY: "s"}
UNITS |= {name: "rad/s" if "gyro" in name else "m/s2" for name in BIASES}
PRIORS = {"tyre_slip_angle": (0.03, 0.30), DELAY: (0.0, 0.15)}
"""Ranges where no file of `models/parameters` has one, rad and s."""
STEPS = {"tyre_friction": 5e-4, "tyre_slip_angle": 1e-3, "com_height": 2e-4, SPEED: 2e-3}
"""Of the differences for the derivatives."""
_SPEED_REACH, _TILTED = 0.5, 0.01
"""Bounds of the speed about that of the GPS, m/s; error of the attitude with which the IMU takes gravity off, rad."""
_SCAN, _LATENCIES = 8, np.arange(0.0, 0.1501, 0.005)
MISFIT = 1.5
"""Times what noise and the least error of the model allow, from which a misfit is told."""
_WILD = {"yaw_rate": 1.0, "roll_rate": 1.0, "lateral_acceleration": 4.0, "speed": 0.5}
"""Where a residual stops to count for the start, rad/s, m/s2 and m/s: what rolls over in one car and not in another."""
_MOST_STEPS, _FIRST, _SETTLED = 25, 1e-2, 3e-4
"""Steps of the solver, and parts of the cost that its last step lowers: before the residual is weighed, and after."""
_ROUNDS, _STEADY = 3, 0.1
"""Most weighings, and the change of a weight below which no other follows."""


def prior_of(name: str) -> tuple[float, float]:
    """Range of an unknown; NaN for one without."""
    if name in (*CAR, DELAY):
        return (Scenario.parameters("car")[name].prior if name in CAR else None) or PRIORS[name]
    if name.startswith("gyro_bias"):
        most = (Scenario.parameters("imu")["gyro_bias"].prior or (0.0, math.nan))[1]
    else:
        most = 9.81 * _TILTED if name in BIASES else math.nan
    return -most, most


def unknowns(drive: CarDrive) -> Parameters:
    """Of a fit; seeds in the middle of their ranges, bounds half a range beyond them."""
    gps = drive.channels["speed"]
    speed = float(np.mean(gps.value[gps.time < drive.turn]))
    least = {
        "tyre_friction": 0.505 * drive.scenario.car.cage_friction,
        "tyre_slip_angle": 0.0,
        "com_height": 0.01,
        DELAY: -0.02,
    }
    found = [Parameter(SPEED, "m/s", speed, speed - _SPEED_REACH, speed + _SPEED_REACH, scale=0.05)]
    for name, unit in UNITS.items():
        low, high = prior_of(name)
        half = 0.5 * (high - low)
        lower = max(low - half, least.get(name, -math.inf))
        found.append(Parameter(name, unit, low + half, lower, high + half, deviation=half))
    return Parameters.of(found)


@dataclass
class CarModel:
    """Residual and derivatives of a drive: rows of the channels, then one of every prior.

    Attributes:
        drive: that is fitted.
        parameters: see `unknowns`.
        scales: by channel, that its residual is divided by beside its deviation.
    """

    drive: CarDrive
    parameters: Parameters
    scales: dict[str, float]
    _runs: dict[tuple[float, ...], dict[str, FloatArray]] = field(default_factory=dict)
    _slopes: tuple[tuple[float, ...], FloatArray] = ((), np.zeros(0))

    @property
    def places(self) -> dict[str, slice]:
        """Where each channel stands in the residual."""
        ends = np.cumsum([0, *(channel.time.size for channel in self.drive.channels.values())]).tolist()
        return {name: slice(*span) for name, span in zip(self.scales, pairwise(ends), strict=True)}

    def motion(self, x: FloatArray) -> dict[str, FloatArray]:
        """By channel, without biases; the last runs are kept."""
        values = self._values(x)
        key = tuple(values[name] for name in (*CAR, SPEED, DELAY))
        if key not in self._runs:
            if len(self._runs) > 40:
                self._runs.pop(next(iter(self._runs)))
            self._runs[key] = self.drive.motion(self.changes(values), values[DELAY])
        return self._runs[key]

    def changes(self, values: dict[str, float]) -> dict[str, dict[str, float]]:
        """To the scenario: a drive whose commands gave another speed has another line of its throttle."""
        scenario, faster = self.drive.scenario, values[SPEED] - self.drive.line_speed
        return {
            "car": {name: values[name] for name in CAR},
            "manoeuvre": {"speed": scenario.manoeuvre.speed + faster},
            "drive": {"throttle_offset": scenario.drive.throttle_offset + faster},
        }

    def residual(self, x: FloatArray) -> FloatArray:
        """Of the unknowns (p)."""
        return self._rows(x) / self._divisors

    def _rows(self, x: FloatArray) -> FloatArray:
        """Before they are divided."""
        values, motion = self._values(x), self.motion(x)
        added = {channel: values[name] for name, channel in BIASES.items()}
        rows = [motion[name] + added.get(name, 0.0) - channel.value for name, channel in self.drive.channels.items()]
        return np.concatenate([*rows, [values[p.name] - p.seed for p in self._known]])

    @property
    def _divisors(self) -> FloatArray:
        sizes = [self.scales[name] * channel.deviation for name, channel in self.drive.channels.items()]
        return np.concatenate([*sizes, [p.deviation for p in self._known]])

    @property
    def _known(self) -> list[Parameter]:
        return [p for p in self.parameters.free if math.isfinite(p.deviation)]

    def _values(self, x: FloatArray) -> dict[str, float]:
        return dict(zip(self.parameters.names, x.tolist(), strict=True))

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Of the residual (m x p): a run per unknown of the car; the latency and biases need none."""
        key = tuple(x.tolist())
        if self._slopes[0] != key:
            slopes, here = [], self._rows(x)
            for place, p in enumerate(self.parameters.free):
                moved = x.copy()
                moved[place] += STEPS.get(p.name, 1e-3) * (-1.0 if x[place] > p.seed else 1.0)
                slopes.append((self._rows(moved) - here) / (moved[place] - x[place]))
            self._slopes = key, np.array(slopes).T
        return self._slopes[1] / self._divisors[:, None]

    def step_error(self, x: FloatArray) -> FloatArray:
        """What the plant's step changes in the residual (m): twice the change by half of it, to first order."""
        values = self._values(x)
        half = {"step": 0.5 * self.drive.scenario.simulation.step}
        finer = self.drive.motion({**self.changes(values), "simulation": half}, values[DELAY])
        rows = [2.0 * (finer[name] - coarse) for name, coarse in self.motion(x).items()]
        return np.concatenate([*rows, np.zeros(len(self._known))]) / self._divisors

    def start(self) -> FloatArray:
        """The best of a few cars that cover the ranges, each with its best latency (p)."""
        names, drive, free = self.parameters.names, self.drive, self.parameters.free
        best, found = math.inf, self.parameters.seed
        for unit in qmc.Sobol(len(CAR), scramble=False).random(_SCAN):
            x = self.parameters.seed
            for name, share in zip(CAR, unit, strict=True):
                x[names.index(name)] += (2.0 * share - 1.0) * free[names.index(name)].deviation
            try:
                run = drive.run(self.changes(self._values(x)), 0.0)
            except FitError:
                continue
            for latency in _LATENCIES.tolist():
                motion = drive.sampled(run, latency)
                off = [np.abs(motion[name] - channel.value) / _WILD[name] for name, channel in drive.channels.items()]
                cost = sum(float(np.sum(np.square(np.minimum(part, 1.0)))) for part in off)
                if cost < best:
                    best, found = cost, x.copy()
                    found[names.index(DELAY)] = latency
        return found


def fit_car(drive: CarDrive) -> FitResult:
    """Estimates of one drive; FitError where no car of the ranges can be simulated."""
    model = CarModel(drive, unknowns(drive), dict.fromkeys(drive.channels, 1.0))
    problem = Problem(model.parameters, model.residual, model.jacobian, name=drive.name)
    x = model.start()
    for _ in range(_ROUNDS):
        x = solve_rollout(problem, x, _MOST_STEPS, _FIRST).x
        noise = serial_noise(model.residual(x), list(model.places.values()), len(x))
        rise = {name: math.sqrt(noise.covariance[place][0]) for name, place in model.places.items()}
        before, model.scales = model.scales, {name: max(s * rise[name], 1.0) for name, s in model.scales.items()}
        if all(abs(model.scales[name] / before[name] - 1.0) < _STEADY for name in before):
            break

    def whitened(solution: Solution) -> Noise:
        stepped = model.step_error(solution.x)
        covariance = np.eye(stepped.size) + np.outer(stepped, stepped)
        return Noise(covariance, noise.degrees_of_freedom, noise.effective_samples)

    solver = partial(solve_rollout, most_steps=_MOST_STEPS, cost_tolerance=_SETTLED)
    poor = [f"{name} by {scale:.2g}" for name, scale in model.scales.items() if scale > MISFIT]
    warnings = [*drive.warnings]
    if poor:
        warnings.append(f"the model misses more than it may, and intervals are wider for it: {', '.join(poor)}")
    facts = {f"misfit_{name}": round(scale, 2) for name, scale in model.scales.items()}
    found = fit(problem, solver, whitened, starts=[x], facts=facts, warnings=warnings)
    return replace(found, rig=differences(drive.scenario))


def fit_car_log(path: Path | str, options: FitOptions = FREE) -> FitResult:
    """Fits the log of one drive of the car, or of its simulation: friction, slip, centre of mass, delay, biases.

    Args:
        path: of the log.
        options: its `settings` go over the scenario of the log, such as a mass that was weighed.

    Raises:
        LogError, FitError, ScenarioError: as `car_drive` and `fit_car`.
    """
    return fit_car(car_drive(read_run_log(path), options.settings))


def car_table(results: Sequence[FitResult]) -> pd.DataFrame:
    """A row per log and unknown: value, 95 % interval, unit and the range of the prior."""
    rows = []
    for result in results:
        for e in result.free:
            low, high = prior_of(e.name)
            prior = "" if math.isnan(low) else f"{low:.3g} .. {high:.3g}"
            rows.append((short_name(result.name), e.name, e.value, e.lower, e.upper, e.unit, prior))
    return pd.DataFrame(rows, columns=["log", "name", "value", "lower", "upper", "unit", "prior"])


def write_fitted_car(folder: Path, result: FitResult) -> Path:
    """Writes the scenario of a log with the car that was found as `<log>_car.yaml`: what differs from `models/`."""
    found = {f"car.{name}": result[name].value for name in CAR if result[name].identifiable}
    scenario: dict[str, Any] = {"schema": "aerodima/scenario/1", "name": f"{short_name(result.name)[:60]}, fitted"}
    for key, value in {**result.rig, **found}.items():
        section, _, name = key.partition(".")
        scenario.setdefault(section, {})[name] = value
    text = yaml.safe_dump(scenario, sort_keys=False)
    path = folder / f"{short_name(result.name)}_car.yaml"
    return write_atomically(path, text, True, FitError)
