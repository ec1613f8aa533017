"""The motor current as its amplifier reports it: sampled, with white noise."""

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from aerodima.workbench.sensors.sampled import CounterNoise, SampledSensor
from aerodima.workbench.systems.system_ports import vector_of


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
