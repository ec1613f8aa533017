"""Steps of a batch, with its ticks, as machine code where `llvmlite` is installed."""

import sys
from functools import cache
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.compiled.batch_arrays import attributes
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.core.extras import install_command

_COMPILED: dict[tuple[Any, ...], Any] = {}
"""Compiled code by class, shapes and constants of a batch."""


def run(batch: Any, ticks: BoolArray, *given: np.ndarray, keep: bool = False) -> list[FloatArray]:
    """Steps the cars of a batch.

    Args:
        batch: object with two methods: `batch.step(*numbers)` replaces arrays of the batch, or of
            objects that it consists of, and returns arrays; `batch.tick(*numbers)` replaces arrays.
            The last axis of all arrays is the car. Both methods use only shapes and the NumPy
            functions of `trace.OPERATIONS`. They are compiled once in a process for each class,
            shapes and constants.
        ticks: whether a step begins with a tick (steps).
        given: numbers that the steps are given, (steps) each, the same for all cars.
        keep: whether to keep what the steps returned.

    Returns:
        What the steps returned (steps, ..., n) each; nothing unless it is kept.

    Raises:
        ValueError: no cars.
        NotImplementedError: a function that cannot be compiled.
    """
    values = [owner[name] for owner, name in attributes(batch)]
    counts = {value.shape[-1] for value in values if isinstance(value, np.ndarray)}
    if len(counts) != 1 or 0 in counts:
        raise ValueError(f"cars: {sorted(counts)}; one number, at least 1, is needed")
    if not len(ticks):
        return []
    if not _has_llvm():
        return run_in_numpy(batch, ticks, *given, keep=keep)
    from aerodima.workbench.car.reduced.compiled.machine_code import CompiledBatch

    layout = (
        value.shape[:-1] if isinstance(value, np.ndarray) else ("constant", value)
        for value in values
    )
    key = (type(batch), len(given), *layout)
    if key not in _COMPILED:
        _COMPILED[key] = CompiledBatch(batch, len(given))
    numbers = np.stack([ticks, *given], axis=-1).astype(float)
    return _COMPILED[key](batch, numbers, keep)


def run_in_numpy(
    batch: Any, ticks: BoolArray, *given: FloatArray, keep: bool = False
) -> list[FloatArray]:
    """Does what `run` does, one step after the other, without compiling anything."""
    kept = []
    for tick, *numbers in zip(ticks, *given, strict=True):
        if tick:
            batch.tick(*numbers)
        results = batch.step(*numbers)
        if keep:
            kept.append(results)
    return [np.array(values) for values in zip(*kept, strict=True)]


@cache
def _has_llvm() -> bool:
    """Returns whether code can be made; says once in a process if it cannot."""
    try:
        import llvmlite  # noqa: F401
    except ImportError:
        print(
            "reduced cars run in NumPy, some 80 times slower, without llvmlite: "
            f"{install_command('search')}",
            file=sys.stderr,
        )
        return False
    return True
