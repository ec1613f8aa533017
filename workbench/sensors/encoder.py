"""Encoders of the tail: the sail's absolute encoder, and the joint motors' own reports."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from aerodima.workbench.errors import UserError
from aerodima.workbench.sensors.sampled import CounterNoise, SampledSensor
from aerodima.workbench.systems.system_ports import DiscreteVector, vector_of

TURN = 2.0 * math.pi


class AngleEncoder(SampledSensor):
    """Encoder of one joint: its angle in steps, and the rate from the difference of two readings.

    Subclasses say what is read. The rate is the difference between the reading and the one a window earlier, by the
    shorter way round: it is right up to half a turn per window, resolves one step per window, lags by half the window.

    Input ports:
        joint_angle (1): rad.
    Output ports:
        angle (1): rad.
        rate (1): rad/s, mean over the window; 0 until it is filled.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        name, rate, delay, step, discrete: as for `SampledSensor`.
        window: of the rate, s; rounded to whole samples, at least one.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(
        self, name: str, rate: float, delay: float, window: float, step: float | None, discrete: bool = False
    ) -> None:
        outputs = {"angle": 1, "rate": 1}
        super().__init__(name=name, outputs=outputs, rate=rate, delay=delay, step=step, discrete=discrete)
        self._angle = self.DeclareVectorInputPort("joint_angle", 1)
        samples = max(1, round(window * rate))
        self._window = samples / rate
        self._past = DiscreteVector(self, np.full(samples, math.nan))

    def reading(self, angle: float, index: int) -> float:
        """What sample `index` says of an angle, rad."""
        raise NotImplementedError

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (2,): angle rad, rate rad/s."""
        angle = self.reading(float(vector_of(self._angle, context)[0]), index)
        earlier = self._past.read(context)[0]
        return np.array([angle, 0.0 if math.isnan(earlier) else math.remainder(angle - earlier, TURN) / self._window])

    def take(self, context: Context, discrete_state: DiscreteValues) -> np.ndarray:
        """See `SampledSensor.take`; keeps the angle for the rate of later samples."""
        row = super().take(context, discrete_state)
        past = self._past.read(context)
        self._past.write(discrete_state, np.concatenate((past[1:], row[:1])))
        return row


class SailEncoder(AngleEncoder):
    """Absolute magnetic encoder of the freely turning sail.

    A word of n bits has 2^n equal steps per turn; the reading is the step that the angle with its noise lies in, from 0
    to below 2 pi (thesis 5.4.5 maps it to 0-360 degrees; 12 bit there, the named part has 10, ERRATA E30).

    Args:
        settings: `scenario.sail_encoder`: rate Hz, delay s, bits, noise rad (standard deviation before quantisation).
        seed: of the noise.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.
        window: of the rate, s.

    Raises:
        UserError: rate, delay or word length not allowed.
    """

    def __init__(
        self,
        settings: Any,
        *,
        seed: int = 0,
        step: float | None = None,
        discrete: bool = False,
        window: float = 0.02,
    ) -> None:
        super().__init__("sail_encoder", settings.rate, settings.delay, window, step, discrete)
        if not 4 <= settings.bits <= 20:
            raise UserError(f"sail_encoder.bits: {settings.bits}; allowed: 4 to 20")
        self._steps = 2**settings.bits
        self._noise, self._deviation = CounterNoise(seed, "sail_encoder", 1), settings.noise

    def reading(self, angle: float, index: int) -> float:
        """See `AngleEncoder.reading`; in [0, 2 pi)."""
        noisy = angle + self._deviation * float(self._noise.at(index)[0])
        return noisy / TURN * self._steps // 1.0 % self._steps * (TURN / self._steps)


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
        joints (4): angles of pitch and roll, rad, then their rates, rad/s.
    Output ports:
        angles (2): pitch, roll, rad.
        rates (2): pitch, roll, rad/s.
        sample_time (1), age (1): s, see `SampledSensor`.

    Args:
        rate: Hz, one reply per command.
        reply: ranges and word lengths.
        delay: s.
        step: of the plant, s.
        discrete: whether the plant is discrete, see `SampledSensor`.

    Raises:
        UserError: rate or delay not allowed.
    """

    def __init__(
        self,
        rate: float,
        reply: MotorReply,
        *,
        delay: float = 0.0,
        step: float | None = None,
        discrete: bool = False,
    ) -> None:
        outputs = {"angles": 2, "rates": 2}
        super().__init__(name="tail_motors", outputs=outputs, rate=rate, delay=delay, step=step, discrete=discrete)
        self._joints = self.DeclareVectorInputPort("joints", 4)
        angle, speed = (reply.position_range, reply.position_bits), (reply.speed_range, reply.speed_bits)
        self._words = (angle, angle, speed, speed)

    def measure(self, context: Context, index: int) -> np.ndarray:
        """One sample (4,)."""
        values = vector_of(self._joints, context).tolist()
        return np.array([quantise_symmetric(value, *word) for value, word in zip(values, self._words, strict=True)])
