"""Base of all sensors, which sample at a rate and show each sample a delay after it was taken."""

import hashlib
import math

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem, State

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.event_order import EventPriority, period_of
from aerodima.workbench.core.port_wiring import DiscreteVector, vector_of
from aerodima.workbench.core.quantity import RATE_TOLERANCE

TURN = 2.0 * math.pi
"""One revolution, rad."""
BLOCK = 64
"""Number of samples drawn at once; part of the definition of the stream."""


class SampledSensor(LeafSystem):
    """A sensor that samples periodically and reports late; subclasses define what a sample is.

    Sample k is taken at k / rate and appears on the output at k / rate + delay, where it stays
    until the next one: whole periods of the delay are a queue in discrete state, the rest is the
    phase of the event that shows the sample, so the delay is exact and nothing is interpolated.
    The robot is assumed to have stood before the run as it does at the initial time: the output
    then holds the first sample, taken a delay ago.

    With a discrete plant, sampling and appearing come before all else at an instant but the wind,
    and the plant's step comes last (`aerodima.workbench.core.event_order`): the sensor sees the
    plant as it is at that instant, not one step later, and a controller that acts at that instant
    already sees a sample without delay. Elsewhere sampling is an unrestricted update, which Drake
    runs before the discrete updates of the same instant. An instant between two steps of a discrete
    plant shows the plant as it will be after the step that has begun.

    Output ports:
        <outputs>: the newest sample that has appeared, split into ports; they cost nothing between
        samples.
        sample_time (1): time at which that sample was taken, s.

    Attributes:
        rate: sampling rate, Hz.

    Args:
        name: name of the system, e.g. "imu".
        outputs: name and size of the output ports, in the order of the numbers of a sample.
        rate: sampling rate, above 0 Hz; in a scenario at most 1/step of its plant.
        delay: time from taking a sample to showing it, 0 s or more.
        discrete: whether the plant is discrete.
    """

    def __init__(
        self,
        *,
        name: str,
        outputs: dict[str, int],
        rate: float,
        delay: float,
        discrete: bool = False,
    ) -> None:
        super().__init__()
        self.set_name(name)
        self.rate = rate
        self._delay = delay
        whole = math.floor(delay * rate + RATE_TOLERANCE)
        lag = max(0.0, delay - whole / rate)
        self._shows_at_once = lag * rate <= RATE_TOLERANCE
        self._outputs = []
        size = 0
        for port, width in outputs.items():
            vector = DiscreteVector(self, np.zeros(width), output=port)
            self._outputs.append((vector, slice(size, size + width)))
            size += width
        self._sample_time = DiscreteVector(self, [0.0], output="sample_time")
        self._queue_length = whole + 1
        self._row_size = size + 1
        self._queue = DiscreteVector(self, np.zeros(self._queue_length * self._row_size))
        self.DeclareInitializationUnrestrictedUpdateEvent(self._initialise)
        period = period_of(rate, EventPriority.SENSOR) if discrete else 1.0 / rate
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._sample)
        if not self._shows_at_once:
            self.DeclarePeriodicDiscreteUpdateEvent(period, lag * rate * period, self._show)

    def measure(self, context: Context, index: int) -> FloatArray:
        """Take sample `index` (size,) of the inputs now, with noise and resolution."""
        raise NotImplementedError

    def _row(self, context: Context) -> FloatArray:
        """Make a row of the queue: the sample, then the time at which it was taken."""
        time = context.get_time()
        row = np.empty(self._row_size)
        row[:-1] = self.measure(context, max(0, round(time * self.rate)))
        row[-1] = time
        return row

    def _initialise(self, context: Context, state: State) -> None:
        discrete_state = state.get_mutable_discrete_state()
        row = self._row(context)
        rows = np.tile(row, (self._queue_length, 1))
        rows[:, -1] -= np.arange(self._queue_length, 0, -1) / self.rate
        self._queue.write(discrete_state, rows.ravel())
        row[-1] -= self._delay
        self._set_outputs(row, discrete_state)

    def _sample(self, context: Context, state: State) -> None:
        self.take(context, state.get_mutable_discrete_state())

    def take(self, context: Context, discrete_state: DiscreteValues) -> FloatArray:
        """Take a sample and return it as the new row of the queue."""
        row = self._row(context)
        queue = row
        if self._queue_length > 1:
            queue = np.concatenate((self._queue.read(context)[self._row_size :], row))
        if self._shows_at_once:
            self._set_outputs(queue[: self._row_size], discrete_state)
        if not self._shows_at_once or self._queue_length > 1:  # else nobody reads the queue
            self._queue.write(discrete_state, queue)
        return row

    def _show(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._set_outputs(self._queue.read(context)[: self._row_size], discrete_state)

    def _set_outputs(self, row: FloatArray, discrete_state: DiscreteValues) -> None:
        for group, columns in self._outputs:
            group.write(discrete_state, row[columns])
        self._sample_time.write(discrete_state, row[-1:])


class AngleEncoder(SampledSensor):
    """Encoder of one joint: its angle in steps, and the rate from the difference of two readings.

    Subclasses define the reading. The rate comes from the difference between the reading and the
    one a window earlier, by the shorter way round: it is right up to half a turn per window,
    resolves one step per window, and lags by half the window.

    Input ports:
        joint_angle (1): angle of the joint, rad.
    Output ports:
        angle (1): angle read by the encoder, rad.
        rate (1): mean rate over the window, rad/s; 0 until the window is filled.
        sample_time (1): time of the sample, s, see `SampledSensor`.

    Args:
        name, rate, delay, discrete: as for `SampledSensor`.
        window: time over which the rate is taken, s; rounded to whole samples, at least one.
    """

    def __init__(
        self,
        name: str,
        rate: float,
        delay: float,
        window: float,
        discrete: bool = False,
    ) -> None:
        super().__init__(
            name=name,
            outputs={"angle": 1, "rate": 1},
            rate=rate,
            delay=delay,
            discrete=discrete,
        )
        self._angle = self.DeclareVectorInputPort("joint_angle", 1)
        samples = max(1, round(window * rate))
        self._window = samples / rate
        self._past = DiscreteVector(self, np.full(samples, math.nan))

    def reading(self, angle: float, index: int) -> float:
        """Read an angle (rad) as sample `index` of the encoder."""
        raise NotImplementedError

    def measure(self, context: Context, index: int) -> FloatArray:
        """Take one sample (2,): angle rad, rate rad/s."""
        angle = self.reading(float(vector_of(self._angle, context)[0]), index)
        earlier = self._past.read(context)[0]
        rate = 0.0
        if not math.isnan(earlier):
            rate = math.remainder(angle - earlier, TURN) / self._window
        return np.array([angle, rate])

    def take(self, context: Context, discrete_state: DiscreteValues) -> FloatArray:
        """Take a sample and keep the angle for the rate of later samples."""
        row = super().take(context, discrete_state)
        self._past.write(discrete_state, np.concatenate((self._past.read(context)[1:], row[:1])))
        return row


class CounterNoise:
    """Standard normal numbers addressed by sample index, so that a repeated run gets the same noise
    bit for bit.

    A counter-based generator (Philox) is keyed by seed and name and positioned by the index: there
    is no hidden state to reset, sensors do not disturb each other's streams, and the order of the
    calls does not matter.

    Args:
        seed: seed of the run, 0 to 2**64 - 1.
        name: name of the sensor; another name gives an independent stream.
        width: count of numbers per sample.
    """

    def __init__(self, seed: int, name: str, width: int) -> None:
        self._key = [seed, int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")]
        self._width = width
        self._block_index = -1
        self._block = np.empty((0, width))

    def at(self, index: int) -> FloatArray:
        """Draw the numbers (width,) of sample `index` >= 0."""
        block_index, row = divmod(index, BLOCK)
        if block_index != self._block_index:
            self._block = self._generator(block_index + 1).standard_normal((BLOCK, self._width))
            self._block_index = block_index
        return self._block[row]

    def first(self, count: int) -> FloatArray:
        """Draw the numbers (count, width) of the first samples: `at` 0 ... count - 1."""
        return np.array([self.at(index) for index in range(count)])

    def constant(self) -> FloatArray:
        """Draw numbers (width,) for the whole run, such as a bias; independent of all samples."""
        return self._generator(0).standard_normal(self._width)

    def _generator(self, stream: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, stream, 0]))
