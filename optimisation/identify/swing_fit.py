"""Fits on swings: friction, added mass, C_N of the robot tail.

All are rollouts of the same pendulum.

The residual is the angle over its accuracy of Table 4.8 (one encoder count). Start angle and rate
are unknowns too, so that one noisy sample does not spoil a whole swing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.fit_result import FitResult, make_curve
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem, Solution
from aerodima.optimisation.identify.log_rig import differences
from aerodima.optimisation.identify.noise import Noise, serial_noise
from aerodima.optimisation.identify.rig_constants import shifted, speed_accuracy, with_values
from aerodima.optimisation.identify.swing_log import SwingData, motor_torque
from aerodima.optimisation.identify.uncertain_constants import UncertainRig
from aerodima.workbench.core.array_types import ArrayPair, FloatArray, Values
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.rig.pendulum import PendulumModel, Torque
from aerodima.workbench.rig.swing_motion import simulate_swing, torque_response

TorqueLaw = Callable[[Values], Sequence[Torque]]
"""Function from values of parameters to torques of air, friction and motor."""
_START_ANGLE = 0.02
"""Distance of the bounds of the start angle from the logged one, rad."""
_START_RATE = 1.0
"""Distance of the bounds of the start rate from the logged one, rad/s."""


@dataclass(frozen=True)
class SwingModel:
    """A swing as a function of parameters.

    Attributes:
        data: swing that is modelled.
        law: function that makes the torque law of a swing.
    """

    data: SwingData
    law: Callable[[SwingData], TorqueLaw]

    @cached_property
    def pendulum(self) -> PendulumModel:
        """Inertia and weight of the rig's pendulum."""
        return PendulumModel.from_scenario(self.data.scenario)

    @cached_property
    def torques(self) -> TorqueLaw:
        """Torque law of this swing."""
        return self.law(self.data)

    def motion(self, values: Values, count: int | None = None) -> ArrayPair:
        """Simulate angles (rad) and rates (rad/s) on the data's grid, or on its first `count` times
        (n each).
        """
        data = self.data
        return simulate_swing(
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
        """State the least-squares problem in these parameters and those of the start."""
        angle = self.data.angle[0]
        rate = self.data.start_rate
        limits = angle - _START_ANGLE, angle + _START_ANGLE
        start_angle = Parameter("start_angle", "rad", angle, *limits, scale=0.002)
        limits = rate - _START_RATE, rate + _START_RATE
        start_rate = Parameter("start_rate", "rad/s", rate, *limits, scale=0.05)
        return self.problem_in(Parameters.of([*parameters, start_angle, start_rate]))

    def problem_in(self, parameters: Parameters) -> Problem:
        """State the problem in parameters that include the start and may include rig constants."""

        def residual(x: FloatArray) -> FloatArray:
            values = parameters.values(x)
            return (self.shifted(values).readings(values) - self.data.angle) / speed_accuracy()

        return Problem(parameters, residual, name=self.data.name)

    def fit(
        self,
        parameters: Sequence[Parameter],
        starts: Sequence[Values] = (),
        facts: Facts | None = None,
        options: FitOptions = FREE,
        exact: bool = False,
    ) -> FitResult:
        """Solve the fit and add the curve of the angle.

        Args:
            parameters: parameters of the fit, without those of the start.
            starts: further starts beside the initial values, by name.
            facts: labels that are added to those of the data.
            options: loss and bounds of the fit.
            exact: whether the constants of the rig are left as they are.

        Raises:
            FitError: bounds that exclude a start or name no parameter, or no rollout exists.
        """
        data = self.data
        fitted = [p.name for p in parameters]
        constants = [c for c in data.constants if not exact and c.name not in fitted]
        model = replace(self, data=replace(data, constants=tuple(constants)))
        problem = model.problem(options.bounded(parameters))
        result = fit(
            problem,
            model.noise,
            starts=problem.parameters.starts(starts),
            channels={"angle": (slice(None), speed_accuracy())},
            facts={**data.facts, **(facts or {})},
            warnings=data.warnings,
            loss=options.loss,
            rig=UncertainRig(constants, model.problem_in, model.noise, model.least_noise),
        )
        values = {e.name: e.value for e in result.estimates}
        values |= {name: constant["shift"] for name, constant in result.constants.items()}
        readings = model.shifted(values).readings(values)
        labels = "time after the release, s", "angle, rad"
        curve = make_curve(data.time, data.angle, readings, *labels)
        return replace(result, curves={"angle": curve}, rig=differences(data.scenario))

    def shifted(self, values: Values) -> SwingModel:
        """Make the model for constants and instruments that are off by the given values."""
        data = self.data
        shifts = {c.name: values.get(c.name, 0.0) for c in data.constants}
        if not any(shifts.values()):
            return self
        scenario = shifted(data.scenario, shifts)
        wind = scenario.experiment.wind_speed * (1.0 + values.get("wind_speed", 0.0))
        scenario = with_values(scenario, {"experiment": {"wind_speed": wind}})
        bias = values.get("current_bias", 0.0)
        delay = values.get("current_delay", 0.0)
        motor, ramp = motor_torque(scenario, data.current, len(data.motor), bias, delay)
        return replace(self, data=replace(data, scenario=scenario, motor=motor, ramp=ramp))

    def readings(self, values: Values) -> FloatArray:
        """Simulate the readings of the encoder (n), rad."""
        angles, _ = self.motion(values)
        gain = 1.0 + values.get("encoder_gain", 0.0)
        return (angles - values.get("encoder_zero", 0.0)) / gain

    def least_noise(self, solution: Solution) -> Noise:
        """Estimate the noise as if the model were right: from the changes between samples, without
        the slow part of the residual.
        """
        if self.data.motor_deviation:
            return self.noise(solution, widened=False)
        fast = 0.5 * float(np.mean(np.square(np.diff(solution.residual))))
        variance = max(fast, (self.data.rounding / speed_accuracy()) ** 2 / 12.0, 1e-12)
        return Noise(np.full(len(solution.residual), variance))

    def noise(self, solution: Solution, widened: bool = True) -> Noise:
        """Estimate the noise of a free swing from its residual; of a driven one from the rounding
        of the angle and the current.

        Noise of the current pushes the tail off its path for good, so the residual wanders, and too
        few of its wanderings fit into a swing to judge them by the residual alone.
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
        # A larger residual than these two explain is due to the model and widens the intervals.
        J = solution.jacobian
        expected = float(np.trace(covariance) - np.trace(np.linalg.pinv(J) @ covariance @ J))
        excess = max(1.0, float(solution.residual @ solution.residual) / max(expected, 1e-12) / 3.0)
        return Noise(covariance * excess, np.inf, seen.effective_samples)
