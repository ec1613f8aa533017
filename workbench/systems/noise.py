"""Random numbers of a sensor as a pure function of seed, name and sample index."""

import hashlib

import numpy as np

BLOCK = 64
"""Samples drawn at once; part of the stream's definition."""


class CounterNoise:
    """Standard normal numbers addressed by sample index, so that a repeated run gets the same noise bit for bit.

    A counter-based generator (Philox) is keyed by seed and name and positioned by the index: there is no hidden
    state to reset, sensors do not disturb each other's streams, and the order of the calls does not matter.

    Args:
        seed: of the run, 0 to 2**64 - 1.
        name: of the sensor; another name gives an independent stream.
        width: numbers per sample.
    """

    def __init__(self, seed: int, name: str, width: int) -> None:
        self._key = [seed, int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")]
        self._width = width
        self._block_index = -1
        self._block = np.empty((0, width))

    def at(self, index: int) -> np.ndarray:
        """Numbers (width,) of sample `index` >= 0."""
        block_index, row = divmod(index, BLOCK)
        if block_index != self._block_index:
            self._block = self._generator(block_index + 1).standard_normal((BLOCK, self._width))
            self._block_index = block_index
        return self._block[row]

    def first(self, count: int) -> np.ndarray:
        """Numbers (count, width) of the first samples: the rows that `at` gives for 0 ... count - 1."""
        blocks = [
            self._generator(1 + block).standard_normal((BLOCK, self._width)) for block in range(-(-count // BLOCK))
        ]
        return np.concatenate([np.empty((0, self._width)), *blocks])[:count]

    def constant(self) -> np.ndarray:
        """Numbers (width,) that belong to the run as a whole, such as a bias; independent of all samples."""
        return self._generator(0).standard_normal(self._width)

    def _generator(self, stream: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, stream, 0]))
