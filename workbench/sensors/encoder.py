"""Encoders of the tail: the sail's absolute encoder, and the joint motors' own reports."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues

from aerodima.workbench.errors import UserError
from aerodima.workbench.sensors.sampled import CounterNoise, SampledSensor
from aerodima.workbench.systems.system_ports import DiscreteVector, vector_of

TURN = 2.0 * math.pi


class SailEncoder(SampledSensor):
    """Absolute magnetic encoder of the freely turning sail: noisy, quantised angle, and the rate from its differences.

    A word of n bits has 2^n equal steps per turn; the reading is the step that the angle with its noise lies in, from 0
    to below 2 pi (thesis 5.4.5 maps it to 0-360 degrees; 12 bit there, the named part has 10, ERRATA E30). The rate is
    the difference between the reading and the one `rate_window` earlier, by the shorter way round: it is right up to
    half a turn per window, resolves one step per window, and lags by half the window.

    Input ports:
        plant_state (state_size): positions and velocities of the plant.
    Output ports:
        angle (1): rad in [0, 2 pi).
        rate (1): rad/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        settings: `scenario.sail_encoder`: rate Hz, delay s, bits, noise rad (standard deviation before quantisation).
        seed: of the noise.
        position_index: of the joint's angle in plant_state.
        state_size: of the plant.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.
        rate_window: s; rounded to whole samples, at least one.

    Raises:
        UserError: rate, delay or word length not allowed.
    """

    def __init__(
        self,
        settings: Any,
        *,
        seed: int = 0,
        position_index: int = 0,
        state_size: int = 1,
        step: float | None = None,
        discrete: bool = False,
        rate_window: float = 0.02,
    ) -> None:
        super().__init__(
            name="sail_encoder",
            outputs={"angle": 1, "rate": 1},
            rate=settings.rate,
            delay=settings.delay,
            step=step,
            discrete=discrete,
        )
        if not 4 <= settings.bits <= 20:
            raise UserError(f"sail_encoder.bits: {settings.bits}; allowed: 4 to 20")
        self._steps = 2**settings.bits
        self._position_index = position_index
        self._noise, self._deviation = CounterNoise(seed, "sail_encoder", 1), settings.noise
        self._plant_state = self.DeclareVectorInputPort("plant_state", state_size)
        samples = max(1, round(rate_window * settings.rate))
        self._window = samples / settings.rate
        self._past = DiscreteVector(self, np.full(samples, math.nan))

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        settings: Any,
        *,
        plant: MultibodyPlant,
        joint: Joint,
        seed: int = 0,
        rate_window: float = 0.02,
    ) -> "SailEncoder":
        """Adds the encoder on a revolute joint of a plant and connects it."""
        encoder = cls(
            settings,
            seed=seed,
            position_index=joint.position_start(),
            state_size=plant.num_multibody_states(),
            step=plant.time_step() or None,
            discrete=plant.time_step() > 0.0,
            rate_window=rate_window,
        )
        builder.AddSystem(encoder)
        builder.Connect(plant.get_state_output_port(), encoder.GetInputPort("plant_state"))
        return encoder

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (2,): angle rad, rate rad/s (0 until the window is filled)."""
        angle = self._reading(context, index)
        earlier = self._past.read(context)[0]
        if math.isnan(earlier):
            return np.array([angle, 0.0])
        return np.array([angle, math.remainder(angle - earlier, TURN) / self._window])

    def _reading(self, context: Context, index: int) -> float:
        state = vector_of(self._plant_state, context)
        angle = float(state[self._position_index]) + self._deviation * float(self._noise.at(index)[0])
        return angle / TURN * self._steps // 1.0 % self._steps * (TURN / self._steps)

    def take(self, context: Context, discrete_state: DiscreteValues) -> np.ndarray:
        """See `SampledSensor.take`; keeps the angle for the rate of later samples."""
        row = super().take(context, discrete_state)
        past = self._past.read(context)
        self._past.write(discrete_state, np.concatenate((past[1:], row[:1])))
        return row


@dataclass(frozen=True)
class MotorReply:
    """Words of the AK70-10's reply in MIT mode (design section 14).

    Args:
        position_range: rad, to either side.
        speed_range: rad/s, to either side.
        position_bits: word length.
        speed_bits: word length.
    """

    position_range: float = 12.5
    speed_range: float = 50.0
    position_bits: int = 16
    speed_bits: int = 12


def quantise_symmetric(value: float, limit: float, bits: int) -> float:
    """Value after a trip through an unsigned word of `bits` that spans [-limit, limit].

    Rounded to the nearest of 2^bits - 1 steps and clipped. The number of steps is odd, so zero itself cannot be sent:
    a motor at rest reports half a step.
    """
    step = 2.0 * limit / (2**bits - 1)
    return round((min(max(value, -limit), limit) + limit) / step) * step - limit


class MotorEncoder(SampledSensor):
    """Angle and speed of the two tail joints as their motors report them over the bus.

    `pydrake.systems.primitives.Multiplexer([2, 1, 2, 1])` makes the station's `tail_state` of angles, sail angle,
    rates and sail rate.

    Input ports:
        plant_state (state_size): positions and velocities of the plant.
    Output ports:
        angles (2): pitch, roll, rad.
        rates (2): pitch, roll, rad/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        rate: Hz, one reply per command.
        delay: s.
        indices: of pitch angle, roll angle, pitch rate, roll rate in plant_state.
        state_size: of the plant.
        reply: ranges and word lengths.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(
        self,
        rate: float,
        *,
        delay: float = 0.0,
        indices: tuple[int, int, int, int] = (0, 1, 2, 3),
        state_size: int = 4,
        reply: MotorReply | None = None,
        step: float | None = None,
        discrete: bool = False,
    ) -> None:
        super().__init__(
            name="tail_motors",
            outputs={"angles": 2, "rates": 2},
            rate=rate,
            delay=delay,
            step=step,
            discrete=discrete,
        )
        reply = reply or MotorReply()
        self._plant_state = self.DeclareVectorInputPort("plant_state", state_size)
        words = [(reply.position_range, reply.position_bits), (reply.speed_range, reply.speed_bits)]
        self._words = [(index, *words[place // 2]) for place, index in enumerate(indices)]

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        rate: float,
        *,
        plant: MultibodyPlant,
        pitch_joint: Joint,
        roll_joint: Joint,
        delay: float = 0.0,
        reply: MotorReply | None = None,
    ) -> "MotorEncoder":
        """Adds the encoders of two revolute joints of a plant and connects them."""
        joints = (pitch_joint, roll_joint)
        positions = [joint.position_start() for joint in joints]
        rates = [plant.num_positions() + joint.velocity_start() for joint in joints]
        encoder = cls(
            rate,
            delay=delay,
            indices=(positions[0], positions[1], rates[0], rates[1]),
            state_size=plant.num_multibody_states(),
            reply=reply,
            step=plant.time_step() or None,
            discrete=plant.time_step() > 0.0,
        )
        builder.AddSystem(encoder)
        builder.Connect(plant.get_state_output_port(), encoder.GetInputPort("plant_state"))
        return encoder

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (4,)."""
        state = vector_of(self._plant_state, context)
        return np.array([quantise_symmetric(float(state[index]), limit, bits) for index, limit, bits in self._words])
