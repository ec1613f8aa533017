"""The rig's incremental encoder: counts of the rotor, so its angle is exact to half a count and never wraps."""

import math

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, State

from aerodima.workbench.config.rig_scenario import RigEncoderParameters, RigScenario
from aerodima.workbench.sensors.sampled import SampledSensor
from aerodima.workbench.systems.system_ports import DiscreteVector, vector_of


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
