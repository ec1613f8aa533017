"""Fits on swings: friction, added mass, C_N of the robot tail.

All are rollouts of the same pendulum.

Residual: angle over its accuracy of Table 4.8 (one encoder count). Start angle and rate are
unknowns too, so that one noisy sample does not spoil a whole swing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from aerodima.optimisation.identify.fit_pipeline import FitResult, UncertainRig, fit
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem, Solution
from aerodima.optimisation.identify.least_squares_solvers import solve_rollout
from aerodima.optimisation.identify.log_rig import (
    FREE,
    FitOptions,
    differences,
    shifted,
    speed_accuracy,
)
from aerodima.optimisation.identify.pendulum import Pendulum, Torque, roll_out, torque_response
from aerodima.optimisation.identify.swing_log import SwingData, motor_torque
from aerodima.optimisation.identify.uncertainty import Noise, serial_noise

Values = Mapping[str, float]
_START_ANGLE = 0.02
"""How far the start may lie from what the log says, rad."""
_START_RATE = 1.0
"""How far its rate may lie from what the log says, rad/s."""


@dataclass(frozen=True)
class SwingModel:
    """How values of parameters become a rollout.

    Attributes:
        data: the swing.
        law: of a swing: values to torques of air, friction and motor.
    """

    data: SwingData
    law: Callable[[SwingData], Callable[[Values], Sequence[Torque]]]

    @cached_property
    def pendulum(self) -> Pendulum:
        """Its inertia and weight."""
        return Pendulum.of(self.data.scenario)

    @cached_property
    def torques(self) -> Callable[[Values], Sequence[Torque]]:
        """Values to torques of air, friction and motor."""
        return self.law(self.data)

    def motion(self, values: Values, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Angles (rad) and rates (rad/s) on the grid of the data, or on its first `count` times (n
        each).
        """
        data = self.data
        return roll_out(
            self.pendulum,
            self.torques(values),
            (values["start_angle"], values["start_rate"]),
            data.step,
            count or len(data.time),
            motor=data.motor.tolist(),
            ramp=data.ramp.tolist(),
            added_mass=values.get("added_mass", 0.0),
        )

    def problem(self, parameters: Sequence[Parameter]) -> Problem:
        """The least-squares problem in these parameters and the start."""
        data = self.data
        start = [
            Parameter(name, unit, seed, seed - reach, seed + reach, scale=scale)
            for name, unit, seed, reach, scale in (
                ("start_angle", "rad", data.angle[0], _START_ANGLE, 0.002),
                ("start_rate", "rad/s", data.start_rate, _START_RATE, 0.05),
            )
        ]
        return self.problem_in(Parameters.of([*parameters, *start]))

    def problem_in(self, parameters: Parameters) -> Problem:
        """The same in all parameters, those of the start among them, constants of the rig too or
        not.
        """

        def residual(x: np.ndarray) -> np.ndarray:
            values = parameters.values(x)
            return (self.shifted(values).readings(values) - self.data.angle) / speed_accuracy()

        return Problem(parameters, residual, name=self.data.name)

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
        fitted = [p.name for p in parameters]
        if exact:
            constants = []
        else:
            constants = [c for c in self.data.constants if c.name not in fitted]
        model = replace(self, data=replace(self.data, constants=tuple(constants)))
        problem = model.problem(options.bounded(parameters))
        result = fit(
            problem,
            solve_rollout,
            model.noise,
            starts=problem.parameters.starts(seeds),
            channels={"angle": (slice(None), speed_accuracy())},
            facts={**self.data.facts, **(facts or {})},
            warnings=self.data.warnings,
            loss=options.loss,
            rig=UncertainRig(constants, model.problem_in, model.noise, model.least_noise),
        )
        values = {e.name: e.value for e in result.estimates} | {
            n: c["shift"] for n, c in result.constants.items()
        }
        curve = {
            "x": self.data.time.tolist(),
            "measured": self.data.angle.tolist(),
            "model": model.shifted(values).readings(values).tolist(),
            "labels": ["time after the release, s", "angle, rad"],
        }
        return replace(result, curves={"angle": curve}, rig=differences(self.data.scenario))

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
        bias = values.get("current_bias", 0.0)
        delay = values.get("current_delay", 0.0)
        motor, ramp = motor_torque(scenario, data.current, len(data.motor), bias, delay)
        return replace(self, data=replace(data, scenario=scenario, motor=motor, ramp=ramp))

    def readings(self, values: Values) -> np.ndarray:
        """What the encoder shows of the motion (n), rad."""
        return (self.motion(values)[0] - values.get("encoder_zero", 0.0)) / (
            1.0 + values.get("encoder_gain", 0.0)
        )

    def least_noise(self, solution: Solution) -> Noise:
        """What the noise would be if the model were right: what changes from sample to sample, no
        slow part.
        """
        if self.data.motor_deviation:
            return self.noise(solution, widened=False)
        fast = 0.5 * float(np.mean(np.square(np.diff(solution.residual))))
        variance = max(fast, (self.data.rounding / speed_accuracy()) ** 2 / 12.0, 1e-12)
        return Noise(np.full(len(solution.residual), variance))

    def noise(self, solution: Solution, widened: bool = True) -> Noise:
        """Noise of a free swing from its residual; of a driven one from the rounding of the angle
        and the current.

        Noise of the current pushes the tail off its path for good, so the residual wanders: too few
        of its wanderings fit into a swing to judge them by the residual alone.
        """
        data = self.data
        rounding = data.rounding / speed_accuracy()
        seen = serial_noise(solution.residual, [slice(None)], len(solution.x), rounding)
        if data.motor_deviation == 0.0:
            return seen
        values = solution.problem.parameters.values(solution.x)
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
            np.trace(covariance)
            - np.trace(np.linalg.pinv(solution.jacobian) @ covariance @ solution.jacobian)
        )
        excess = max(1.0, float(solution.residual @ solution.residual) / max(expected, 1e-12) / 3.0)
        return Noise(covariance * excess, np.inf, seen.effective_samples)
