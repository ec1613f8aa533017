"""Sensors of the rig: the six-axis force sensor under it, the current of its motor, and its
encoder.

Reading = wrench - offset + bias + drift t + noise, clipped at the range. The offset is the wrench
at which the sensor was zeroed (Table 4.4): add it to a reading. Table 4.8 is an accuracy, so it
makes a bias per log; the noise of a sample is a hundredth of it (design section 11). Bias and drift
are drawn once per log from its seed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import Context

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.core.sampled import AngleEncoder, CounterNoise, SampledSensor
from aerodima.workbench.scenario.rig_scenario import ForceSensorParameters, RigEncoderParameters

AXES = 6
"""Number of axes: F_x, F_y, F_z (N), T_x, T_y, T_z (N m), in this order everywhere."""


@dataclass(frozen=True)
class SensorErrors:
    """The errors of a sensor in one log.

    Attributes:
        offset: wrench at which the sensor was zeroed (n), N and N m.
        bias: constant error (n), N and N m.
        drift: change of the error per second (n), N/s and N m/s.
        noise: standard deviation of a sample (n), N and N m.
        limits: limits of the range, to either side (n), N and N m.
        stream: noise of the samples, n numbers each.
    """

    offset: FloatArray
    bias: FloatArray
    drift: FloatArray
    noise: FloatArray
    limits: FloatArray
    stream: CounterNoise

    def readings(
        self, values: FloatArray, time: FloatArray | float, noise: FloatArray
    ) -> FloatArray:
        """Returns readings (..., n) of true values at times (..., 1), s, with numbers (..., n) of
        the stream as noise.
        """
        shifted = values - self.offset + self.bias + self.drift * time
        return np.clip(shifted + self.noise * noise, -self.limits, self.limits)

    def first_readings(self, values: FloatArray, count: int, rate: float) -> FloatArray:
        """Returns the first readings of a log at once (count, n): the same numbers as a `RigSensor`
        gives one by one.

        Args:
            values: true values (n), or one row per sample (count, n).
            count: number of samples, taken at k / rate.
            rate: rate of the samples, Hz.
        """
        return self.readings(values, np.arange(count)[:, None] / rate, self.stream.first(count))


def force_errors(
    settings: ForceSensorParameters, offsets: Sequence[float], seed: int
) -> SensorErrors:
    """Draws the errors of the force sensor in one log from a seed."""
    accuracy = np.array(settings.accuracies)
    bias = CounterNoise(seed, "force_sensor_bias", AXES).constant()
    drift = CounterNoise(seed, "force_sensor_drift", AXES).constant()
    return SensorErrors(
        offset=np.asarray(offsets, dtype=float),
        bias=accuracy * bias,
        drift=accuracy * settings.drift_fraction * drift,
        noise=accuracy * settings.noise_fraction,
        limits=np.array(settings.ranges),
        stream=CounterNoise(seed, "force_sensor", AXES),
    )


def current_errors(noise: float, seed: int) -> SensorErrors:
    """Makes the errors of the logged current: white noise alone, A."""
    none = np.zeros(1)
    stream = CounterNoise(seed, "maxon_current", 1)
    return SensorErrors(none, none, none, np.array([noise]), np.array([math.inf]), stream)


class RigSensor(SampledSensor):
    """The force sensor, or that of the motor's current, as a system.

    Input ports:
        value (n): true value; for the force sensor the wrench of the support on the rig at W, W
            axes.
    Output ports:
        reading (n): reading of the sensor; force N and torque N m, or current A.
        sample_time (1): time of the sample, s, see `SampledSensor`.

    Args:
        name: name of the system.
        rate: rate of the samples, Hz.
        errors: errors of the sensor in the log.
    """

    def __init__(self, name: str, rate: float, errors: SensorErrors) -> None:
        size = len(errors.noise)
        super().__init__(name=name, outputs={"reading": size}, rate=rate, delay=0.0)
        self._errors = errors
        self._value = self.DeclareVectorInputPort("value", size)

    def measure(self, context: Context, index: int) -> FloatArray:
        """Takes one sample (n,)."""
        value = vector_of(self._value, context)
        return self._errors.readings(value, index / self.rate, self._errors.stream.at(index))


def quantise(angle: float, count: float) -> float:
    """Returns the angle of the nearest count; zero is a count."""
    return round(angle / count) * count


class RigEncoder(AngleEncoder):
    """Encoder of the rig, which measures the angle in counts.

    Args:
        settings: parameters of the encoder: sampling rate, Hz, and window of the angle's rate, s.
        count: angle of one count, rad.
    """

    def __init__(self, settings: RigEncoderParameters, count: float) -> None:
        super().__init__("encoder", settings.rate, 0.0, settings.rate_window)
        self._count = count

    def reading(self, angle: float, index: int) -> float:
        """See `AngleEncoder.reading`."""
        return quantise(angle, self._count)
