"""Calculations written out: same values for numbers, arrays and complex steps, nothing done twice or for nothing."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.swing import reduced_model
from aerodima.optimisation.swing.straight_line import written_out
from tests.optimisation.swing.turn import car


def everything(k: float, x: Any, y: Any) -> tuple[Any, ...]:
    wave = np.sin(x) * np.cos(y) + k * np.tanh(x - 1)
    root = np.sqrt(1.0 + x**2 + np.exp(-y) / 3)
    return wave / root, 2.0 / root - (0.5 - np.log(root)) + (-x) * y, wave


def test_a_calculation_that_is_written_out_gives_what_it_gives_as_it_reads() -> None:
    x, y = np.random.default_rng(0).normal(size=(2, 7))
    function = written_out(everything, 2, 0.7)
    for points in ((x, y), (x + 0.3j, y), (x[:, None], y), (1.5, -0.5)):
        for found, expected in zip(function(*points), everything(0.7, *points), strict=True):
            assert np.allclose(found, expected, rtol=1e-14)


def test_zeros_ones_repetitions_and_what_no_result_needs_cost_nothing() -> None:
    done: Counter[str] = Counter()

    class Counting(np.ndarray):
        def __array_ufunc__(self, ufunc: np.ufunc, _method: str, *given: Any) -> Any:
            done[ufunc.__name__] += 1
            return ufunc(*(np.asarray(value) for value in given)).view(Counting)

    def wasteful(x: Any, y: Any) -> tuple[Any, ...]:
        _unused = np.exp(y)
        return 0.0 * np.sin(x) + 1.0 * np.cos(y) - 0.0, x * y + y * x, 0.0 / x

    x = np.ones(3).view(Counting)
    cosine, product, nothing = written_out(wasteful, 2)(x, x)
    assert done == {"cos": 1, "multiply": 1, "add": 1}
    assert nothing == 0.0
    assert np.allclose(np.asarray(cosine), np.cos(1.0))
    assert np.allclose(np.asarray(product), 2.0)


@pytest.mark.parametrize(
    "calculation",
    [
        lambda x: (np.arctan(x),),
        lambda x: (x if x > 0 else 0.0,),
        lambda x: (x if x else 0.0,),
        lambda x: (1.0 if x == 0.0 else x,),
        lambda x: (x**0.5,),
        lambda x: (x**0,),
    ],
)
def test_what_cannot_be_written_out_is_refused(calculation: Any) -> None:
    with pytest.raises(TypeError):
        written_out(calculation, 1)


@pytest.mark.parametrize("joints", [1, 2])
def test_the_reduced_model_is_the_one_that_reads(joints: int) -> None:
    generator = np.random.default_rng(1)
    roll, rate = generator.normal(size=2) * [0.1, 0.5]
    tail = [generator.normal(size=joints) * size for size in (1.0, 5.0, 40.0)]
    inputs = np.array([0.7, 0.05, 4.5, 0.1, 1.0, 0.1])
    acceleration, torques = reduced_model.motion(roll, rate, tuple(tail), inputs, car())
    plain = reduced_model._motion(car(), roll, rate, *inputs, *np.concatenate(tail))
    assert np.allclose([acceleration, *torques], plain, rtol=1e-12)
    assert reduced_model.tip_height(roll, tail[0], car()) == pytest.approx(
        reduced_model._tip_height(car(), roll, *tail[0])[0], rel=1e-12
    )
