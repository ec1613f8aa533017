"""Fits on swings: friction, added mass, C_N of the robot tail. All are rollouts of the same pendulum.

Residual: angle over its accuracy of Table 4.8 (one encoder count). Start angle and rate are unknowns too, so that one
noisy sample does not spoil a whole swing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.optimisation.identify.fit_parameters import Parameter, Parameters
from aerodima.optimisation.identify.fit_pipeline import FitResult, fit
from aerodima.optimisation.identify.least_squares import Loss, Problem, Solution
from aerodima.optimisation.identify.least_squares_solvers import solve_rollout
from aerodima.optimisation.identify.log_rig import FREE, FitOptions, differences, shifted
from aerodima.optimisation.identify.pendulum import Pendulum, Torque, roll_out, torque_response
from aerodima.optimisation.identify.priors import fit_with_priors
from aerodima.optimisation.identify.residual_noise import Noise, serial_noise
from aerodima.optimisation.identify.static_log import speed_accuracy
from aerodima.optimisation.identify.swing_log import SwingData, motor_torque

Values = Mapping[str, float]
_START_ANGLE, _START_RATE = 0.02, 1.0
"""How far the start may lie from what the log says, rad and rad/s."""


@dataclass(frozen=True)
class SwingModel:
    """How values of parameters become a rollout.

    Attributes:
        data: the swing.
        pendulum: its inertia and weight.
        torques: of the values: air, friction, motor.
        rebuilt: the same model of other data, on a rig with other constants.
    """

    data: SwingData
    pendulum: Pendulum
    torques: Callable[[Values], Sequence[Torque]]
    rebuilt: Callable[[SwingData], SwingModel]

    def motion(self, values: Values) -> tuple[np.ndarray, np.ndarray]:
        """Angles (rad) and rates (rad/s) on the grid of the data (n each)."""
        return roll_out(
            self.pendulum,
            self.torques(values),
            (values["start_angle"], values["start_rate"]),
            self.data.step,
            len(self.data.time),
            motor=self.data.motor.tolist(),
            ramp=self.data.ramp.tolist(),
            added_mass=values.get("added_mass", 0.0),
        )

    def shortened(self, longest: float) -> SwingModel:
        """The same over the first part of the swing, s."""
        data = self.data
        count = min(int(longest / data.step) + 1, len(data.time))
        part = replace(
            data,
            time=data.time[:count],
            angle=data.angle[:count],
            motor=data.motor[: count - 1],
            ramp=data.ramp[: count - 1],
        )
        return replace(self, data=part)

    def problem(self, parameters: Sequence[Parameter]) -> Problem:
        """The least-squares problem in these parameters and the start."""
        data = self.data
        start = (
            Parameter("start_angle", "rad", data.angle[0], data.angle[0] - _START_ANGLE, data.angle[0] + _START_ANGLE),
            Parameter(
                "start_rate", "rad/s", data.start_rate, data.start_rate - _START_RATE, data.start_rate + _START_RATE
            ),
        )
        start = (replace(start[0], scale=0.002), replace(start[1], scale=0.05))
        everything = Parameters.of([*parameters, *start])
        weight = speed_accuracy()

        def residual(x: np.ndarray) -> np.ndarray:
            return (self.motion(everything.values(x))[0] - data.angle) / weight

        return Problem(everything, residual, name=data.name)

    def fit(
        self,
        parameters: Sequence[Parameter],
        seeds: Sequence[Values] = (),
        facts: Mapping[str, Any] | None = None,
        options: FitOptions = FREE,
        exact: bool = False,
    ) -> FitResult:
        """Solves and adds the curve of the angle.

        Args:
            parameters, seeds: of the fit, and further starts.
            facts: added to those of the data.
            options: loss and bounds.
            exact: leave the constants of the rig as they are.

        Raises:
            FitError: bounds that exclude a seed or name no parameter, or no rollout exists.
        """
        options.require_known([p.name for p in parameters])
        bounded = []
        for p in parameters:
            low, high = options.limits(p)
            bounded.append(p if p.frozen else replace(p, lower=low, upper=high))
        problem = self.problem(bounded)
        result = fit(
            problem,
            solve_rollout,
            lambda solution: self.noise(solution, problem.parameters),
            starts=problem.parameters.starts(seeds),
            channels={"angle": (slice(None), speed_accuracy())},
            facts={**self.data.facts, **(facts or {})},
            warnings=self.data.warnings,
            loss=options.loss,
        )
        constants = [c for c in self.data.constants if c.name not in problem.parameters.values(problem.parameters.seed)]
        if constants and not exact:
            result = self._with_constants(result, problem.parameters, constants, options.loss)
        values = {e.name: e.value for e in result.estimates} | {n: c["shift"] for n, c in result.constants.items()}
        return replace(
            result, curves={"angle": self.shifted(values).curve(values)}, rig=differences(self.data.scenario)
        )

    def _with_constants(
        self, first: FitResult, parameters: Parameters, constants: Sequence[Parameter], loss: Loss
    ) -> FitResult:
        """The fit with the rig's constants as unknowns with priors, or free."""
        weight = speed_accuracy()

        def make(everything: Parameters) -> Problem:
            def residual(x: np.ndarray) -> np.ndarray:
                values = everything.values(x)
                return (self.shifted(values).readings(values) - self.data.angle) / weight

            return Problem(everything, residual, name=self.data.name)

        return fit_with_priors(
            make,
            parameters.all,
            constants,
            first,
            lambda solution: self.noise(solution, solution.problem.parameters),
            least_noise=lambda solution: self.least_noise(solution, solution.problem.parameters),
            channels={"angle": (slice(None), weight)},
            warnings=self.data.warnings,
            loss=loss,
        )

    def shifted(self, values: Values) -> SwingModel:
        """The model when constants and instruments are off by some values (`constants`)."""
        if not any(values.get(c.name) for c in self.data.constants):
            return self
        data = self.data
        scenario = shifted(data.scenario, {c.name: values.get(c.name, 0.0) for c in data.constants})
        wind = scenario.experiment.wind_speed * (1.0 + values.get("wind_speed", 0.0))
        scenario = scenario.model_copy(
            update={"experiment": scenario.experiment.model_copy(update={"wind_speed": wind})}
        )
        bias, delay = values.get("current_bias", 0.0), values.get("current_delay", 0.0)
        motor, ramp = motor_torque(scenario, data.current, len(data.motor), bias, delay)
        return self.rebuilt(replace(data, scenario=scenario, motor=motor, ramp=ramp))

    def readings(self, values: Values) -> np.ndarray:
        """What the encoder shows of the motion (n), rad."""
        return (self.motion(values)[0] - values.get("encoder_zero", 0.0)) / (1.0 + values.get("encoder_gain", 0.0))

    def least_noise(self, solution: Solution, parameters: Parameters) -> Noise:
        """What the noise would be if the model were right: what changes from sample to sample, no slow part."""
        if self.data.motor_deviation:
            return self.noise(solution, parameters, widened=False)
        fast = 0.5 * float(np.mean(np.square(np.diff(solution.residual))))
        variance = max(fast, (self.data.rounding / speed_accuracy()) ** 2 / 12.0, 1e-12)
        return Noise(np.full(len(solution.residual), variance))

    def noise(self, solution: Solution, parameters: Parameters, widened: bool = True) -> Noise:
        """Of a free swing what the residual shows; of a driven one the rounding of the angle and the current's noise.

        Noise of the current pushes the tail off its path for good, so the residual wanders: too few of its wanderings
        fit into a swing to judge them by the residual alone.
        """
        data = self.data
        rounding = data.rounding / speed_accuracy()
        seen = serial_noise(solution.residual, [slice(None)], len(solution.x), rounding)
        if data.motor_deviation == 0.0:
            return seen
        values = parameters.values(solution.x)
        model = self.shifted(values)
        response = torque_response(
            model.pendulum,
            model.torques(values),
            model.motion(values),
            data.step,
            model.data.motor.tolist(),
            values.get("added_mass", 0.0),
            model.data.ramp.tolist(),
        )
        pushed = response * (data.motor_deviation / speed_accuracy())
        covariance = pushed @ pushed.T + np.eye(len(data.angle)) / 12.0
        if not widened:
            return Noise(covariance)
        # A residual larger than these two explain is the model's: it widens the intervals.
        expected = float(
            np.trace(covariance) - np.trace(np.linalg.pinv(solution.jacobian) @ covariance @ solution.jacobian)
        )
        excess = max(1.0, float(solution.residual @ solution.residual) / max(expected, 1e-12) / 3.0)
        return Noise(covariance * excess, np.inf, seen.effective_samples)

    def curve(self, values: Values) -> dict[str, Any]:
        """Measured and modelled angle over time, for plots."""
        return {
            "x": self.data.time.tolist(),
            "measured": self.data.angle.tolist(),
            "model": self.readings(values).tolist(),
            "labels": ["time after the release, s", "angle, rad"],
        }
