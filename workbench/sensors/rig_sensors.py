"""Sensors of the rig: the six-axis force sensor under it, the current of its motor, and its encoder.

Reading = wrench - offset + bias + drift t + noise, clipped at the range. The offset is what the sensor was zeroed at
(Table 4.4): add it to a reading. Table 4.8 is an accuracy, so it makes a bias per log; the noise of a sample is a
hundredth of it (design section 11). Bias and drift are drawn once per log from its seed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, State

from aerodima.workbench.config.rig_scenario import ForceSensorParameters, RigEncoderParameters, RigScenario
from aerodima.workbench.sensors.sampled import CounterNoise, SampledSensor
from aerodima.workbench.systems.system_ports import DiscreteVector, vector_of

AXES = 6
"""F_x, F_y, F_z (N), T_x, T_y, T_z (N m), in this order everywhere."""


@dataclass(frozen=True)
class SensorErrors:
    """The errors of one log.

    Attributes:
        bias: constant part (6), N and N m.
        drift: change per second (6), N/s and N m/s.
        noise: standard deviation of a sample (6), N and N m.
    """

    bias: np.ndarray
    drift: np.ndarray
    noise: np.ndarray


def sensor_errors(settings: ForceSensorParameters, seed: int) -> SensorErrors:
    """The errors that a seed gives a log."""
    accuracy = np.array(settings.accuracies)
    return SensorErrors(
        bias=accuracy * CounterNoise(seed, "force_sensor_bias", AXES).constant(),
        drift=accuracy * settings.drift_fraction * CounterNoise(seed, "force_sensor_drift", AXES).constant(),
        noise=accuracy * settings.noise_fraction,
    )


def sensor_readings(
    wrench: np.ndarray, count: int, settings: ForceSensorParameters, offsets: Sequence[float], seed: int
) -> np.ndarray:
    """The first `count` samples of a log at once (count, 6); the same numbers as `ForceTorqueSensor` gives one by one.

    Args:
        wrench: of the support on the rig at W (6), or one per sample (count, 6).
        count: samples, taken at k / rate.
        settings: of the sensor.
        offsets: that it was zeroed at (6), N and N m.
        seed: of the log.
    """
    errors = sensor_errors(settings, seed)
    time = np.arange(count)[:, None] / settings.rate
    noise = CounterNoise(seed, "force_sensor", AXES).first(count)
    readings = wrench - np.asarray(offsets) + errors.bias + errors.drift * time + errors.noise * noise
    limits = np.array(settings.ranges)
    return np.clip(readings, -limits, limits)


class ForceTorqueSensor(SampledSensor):
    """The force sensor as a system.

    Input ports:
        wrench (6): of the support on the rig at W, W axes; from `aerodima.workbench.plants.rig`.
    Output ports:
        reading (6): force N, torque N m.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: of the sensor.
        offsets: that it was zeroed at (6), N and N m.
        seed: of the log.
        step: of the integrator, s; None where nothing steps.

    Raises:
        UserError: the rate is above 1/step.
    """

    def __init__(
        self, settings: ForceSensorParameters, offsets: Sequence[float], seed: int, step: float | None = None
    ) -> None:
        super().__init__(name="force_sensor", outputs={"reading": AXES}, rate=settings.rate, delay=0.0, step=step)
        self._wrench = self.DeclareVectorInputPort("wrench", AXES)
        self._offsets = np.asarray(offsets, dtype=float)
        self._errors = sensor_errors(settings, seed)
        self._limits = np.array(settings.ranges)
        self._noise = CounterNoise(seed, "force_sensor", AXES)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        settings: ForceSensorParameters,
        *,
        wrench: OutputPort,
        offsets: Sequence[float],
        seed: int,
        step: float | None = None,
    ) -> "ForceTorqueSensor":
        """Adds the sensor and connects it to the wrench of a rig."""
        sensor = cls(settings, offsets, seed, step)
        builder.AddSystem(sensor)
        builder.Connect(wrench, sensor.GetInputPort("wrench"))
        return sensor

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (6,)."""
        wrench = vector_of(self._wrench, context)
        errors = self._errors
        drift = errors.drift * (index / self.rate)
        reading = wrench - self._offsets + errors.bias + drift + errors.noise * self._noise.at(index)
        return np.clip(reading, -self._limits, self._limits)


class MotorCurrentSensor(SampledSensor):
    """One current, sampled.

    Input ports:
        current (1): A.
    Output ports:
        reading (1): A.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        rate: Hz.
        deviation: standard deviation of a sample, A.
        noise: stream of the log, one number per sample.
        step: of the integrator, s.

    Raises:
        UserError: the rate is above 1/step.
    """

    def __init__(self, rate: float, deviation: float, noise: CounterNoise, step: float | None = None) -> None:
        super().__init__(name="motor_current", outputs={"reading": 1}, rate=rate, delay=0.0, step=step)
        self._deviation, self._noise = deviation, noise
        self._current = self.DeclareVectorInputPort("current", 1)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        rate: float,
        deviation: float,
        noise: CounterNoise,
        *,
        current: OutputPort,
        step: float | None = None,
    ) -> "MotorCurrentSensor":
        """Adds the sensor and connects it to a motor."""
        sensor = cls(rate, deviation, noise, step)
        builder.AddSystem(sensor)
        builder.Connect(current, sensor.GetInputPort("current"))
        return sensor

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (1,)."""
        current = vector_of(self._current, context)
        return np.array(current) + self._deviation * self._noise.at(index)


def count_angle(scenario: RigScenario) -> float:
    """Angle of one count at the output, rad: 2 pi / (512 x 4 x 26) = 1.180e-4 (ERRATA E19)."""
    encoder = scenario.encoder
    return 2.0 * math.pi / (encoder.pulses * encoder.quadrature * scenario.maxon.gear_ratio)


def quantise(angle: float, count: float) -> float:
    """The angle of the nearest count; zero is a count."""
    return round(angle / count) * count


class RigEncoder(SampledSensor):
    """Angle by counts, rate by their difference over a window.

    Input ports:
        plant_state (2): angle rad, rate rad/s.
    Output ports:
        angle (1): rad.
        rate (1): rad/s, mean over the window; 0 until it is filled.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: rate Hz, window s.
        count: angle of one count, rad.
        step: of the integrator, s; None where nothing steps.

    Raises:
        UserError: the rate is above 1/step.
    """

    def __init__(self, settings: RigEncoderParameters, count: float, step: float | None = None) -> None:
        super().__init__(name="encoder", outputs={"angle": 1, "rate": 1}, rate=settings.rate, delay=0.0, step=step)
        self._count = count
        self._state = self.DeclareVectorInputPort("plant_state", 2)
        samples = max(1, round(settings.rate_window * settings.rate))
        self._window = samples / settings.rate
        self._past = DiscreteVector(self, np.full(samples, math.nan))

    @classmethod
    def add_to_builder(cls, builder: DiagramBuilder, scenario: RigScenario, *, plant_state: OutputPort) -> "RigEncoder":
        """Adds the encoder and connects it to the state of a rig."""
        encoder = cls(scenario.encoder, count_angle(scenario), scenario.simulation.step)
        builder.AddSystem(encoder)
        builder.Connect(plant_state, encoder.GetInputPort("plant_state"))
        return encoder

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (2,)."""
        angle = self._reading(context)
        earlier = self._past.read(context)[0]
        return np.array([angle, 0.0 if math.isnan(earlier) else (angle - earlier) / self._window])

    def _reading(self, context: Context) -> float:
        state = vector_of(self._state, context)
        return quantise(float(state[0]), self._count)

    def _sample(self, context: Context, state: State) -> None:
        super()._sample(context, state)
        past = self._past.read(context)
        self._past.write(state.get_mutable_discrete_state(), np.append(past[1:], self._reading(context)))
