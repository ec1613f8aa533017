"""Compiled functions give what their NumPy functions give, for every car, and refuse what they do not know."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.optimisation.screening.compiled import LANES, Compiled, for_cars
from aerodima.optimisation.screening.entry_runs import driven
from aerodima.optimisation.screening.vehicle_motion import COMMANDED, STATES
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench import load_scenario

RNG = np.random.default_rng(5)


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: [np.sin(a) * np.cos(b) - np.tanh(a) / (2.0 + np.abs(b))],
        lambda a, b: [np.maximum(a, b), np.minimum(a, 0.3), np.clip(a, -0.5, b)],
        lambda a, b: [1.0 * (a > b), 1.0 * (a >= b), (a < 0.1) & (b <= a), np.where(a > b, a, np.inf)],
        lambda a, b: [np.sum(np.stack([a, b, -a]) ** 2, axis=(0, 1)), np.min(np.concatenate([a, b]), axis=0)],
        lambda a, b: [(a * a + 1.0) ** 0.5, 0.0 * a + 3.0, np.zeros_like(a) + b],
    ],
)
@pytest.mark.parametrize("cars", [1, LANES, 2 * LANES + 3])
def test_functions_of_arrays(function: Callable[..., Any], cars: int) -> None:
    a, b = RNG.normal(size=(2, 3, cars))
    compiled = Compiled(function, [(3,), (3,)])
    rows = compiled.rows_for(cars)
    rows[:, :cars] = np.concatenate([a, b])
    for found, expected in zip(compiled(rows, cars), function(a, b), strict=True):
        assert_allclose(found, expected, rtol=1e-14, atol=1e-15)


def test_the_record_holds_an_operation_once() -> None:
    twice = Compiled(lambda a: [np.sin(a) + np.sin(a)], [()])
    rows = twice.rows_for(1)
    rows[0, 0] = 0.5
    assert twice(rows, 1)[0][0] == pytest.approx(2.0 * np.sin(0.5), abs=1e-15)
    assert twice.operations == 3  # input, sine, sum


def test_unknown_functions_are_refused() -> None:
    with pytest.raises(NotImplementedError, match=r"numpy\.arctan2"):
        Compiled(lambda a, b: [np.arctan2(a, b)], [(), ()])
    with pytest.raises(NotImplementedError, match="power 3"):
        Compiled(lambda a: [a**3], [()])
    for keywords in ({"keepdims": True}, {"initial": 1.0}):
        with pytest.raises(NotImplementedError, match=r"numpy\.add"):
            Compiled(lambda a, given=keywords: [np.sum(a, axis=0, **given)], [(3,)])


def test_a_second_of_sliding_cars() -> None:
    """From 3 to 6 m/s with the wheels at full lock: every step of every car, compiled and in NumPy."""
    cars = Vehicles.of([load_scenario("turn_designed", [f"car.tyre_friction={one}"]) for one in (0.3, 0.5, 0.8)])
    speed = np.array([3.0, 4.5, 6.0])
    state = np.zeros((len(STATES), cars.count))
    state[STATES.index("v_x")] = speed
    state[[place for place, name in enumerate(STATES) if name.startswith("spin")]] = speed / cars.rolling_radius
    tail = np.tile([[[0.0], [0.0], [17.0], [5.0]], [[-0.8], [0.0], [17.0], [5.0]]], cars.count)
    step, given = for_cars(driven, cars, *COMMANDED), (np.full((2, 3), 0.5), speed / cars.rolling_radius, tail)
    for _ in range(500):
        compiled, expected = step(state, *given), driven(cars, state, *given)
        for found, wanted in zip(compiled, expected, strict=True):
            assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
        state = expected[0]
    assert np.all(np.abs(state[STATES.index("yaw")]) > 0.3)


def test_a_step_of_a_car_on_the_ground() -> None:
    frictions = np.linspace(0.3, 1.2, 11)
    cars = Vehicles.of([load_scenario("turn_designed", [f"car.tyre_friction={one}"]) for one in frictions])
    state = 0.1 * RNG.normal(size=(len(STATES), cars.count))
    state[STATES.index("z")] = RNG.uniform(-0.02, 0.05, cars.count)
    given = [state, *(RNG.normal(size=(*shape, cars.count)) for shape in COMMANDED[1:])]
    for found, expected in zip(for_cars(driven, cars, *COMMANDED)(*given), driven(cars, *given), strict=True):
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
