"""Compiled steps give what their NumPy functions give, for every car, and refuse what they do not
know.
"""

import sys
from copy import deepcopy
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.optimisation.swerve.reduced_swerves import knots_of
from aerodima.workbench import load_scenario
from aerodima.workbench.car.reduced.compiled import steps
from aerodima.workbench.car.reduced.compiled.batch_arrays import attributes
from aerodima.workbench.car.reduced.compiled.machine_code import LANES
from aerodima.workbench.car.reduced.compiled.steps import run, run_in_numpy
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.states import STATES
from aerodima.workbench.car.reduced.swerves import FeedbackSwerve, PlayedSwerve
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import TurnRollout, drive_turns
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_library import find_swing
from tests.refusals import assert_refused

RNG = np.random.default_rng(5)
ONCE = np.array([False])
FOLLOWING = ("tail.mode=swing", "controller.law=feedback")
FRICTIONS = tuple([f"car.tyre_friction={one}"] for one in (0.3, 0.5, 0.8, 1.1))


class Pair(SimpleNamespace):
    """A batch of two arrays that has no tick; its step gives what a function of them gives."""

    def tick(self):
        """Nothing."""


def batch_of(function, **arrays):
    """Of a class of its own: code is made once for a class."""
    return type("Made", (Pair,), {"step": lambda self: function(*vars(self).values())})(**arrays)


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: [
            np.sin(300.0 * a) / (2.0 + np.abs(b)),
            np.cos(300.0 * b),
            np.tanh(30.0 * a),
            np.tanh(1e-5 * b),
            np.arctan(100.0 * a),
        ],
        lambda a, b: [np.tan(0.4 * np.tanh(a)) - np.rint(10.0 * b)],
        lambda a, b: [np.maximum(a, b), np.minimum(a, 0.3), np.clip(a, -0.5, b)],
        lambda a, b: [
            1.0 * (a > b),
            1.0 * (a >= b),
            (a < 0.1) & (b <= a),
            np.where(a > b, a, np.inf),
        ],
        lambda a, b: [1.0 * (a == a), (a < 0.1) | ~(b <= a), np.isnan(np.where(a > b, np.nan, a))],
        lambda a, b: [np.logical_and.reduce(np.stack([a, b]) > -0.5)],
        lambda a, b: [
            np.sum(np.stack([a, b, -a]) ** 2, axis=(0, 1)),
            np.min(np.concatenate([a, b]), axis=0),
        ],
        lambda a, b: [(a * a + 1.0) ** 0.5, 0.0 * a + 3.0, np.zeros_like(a) + b],
    ],
)
@pytest.mark.parametrize("cars", [1, LANES, 2 * LANES + 3])
def test_functions_of_arrays(function, cars):
    a, b = RNG.normal(size=(2, 3, cars))
    for found, expected in zip(
        run(batch_of(function, a=a, b=b), ONCE, keep=True), function(a, b), strict=True
    ):
        assert_allclose(found[0], expected, rtol=1e-14, atol=1e-15)


ONES = np.ones((3, 2))


@pytest.mark.parametrize(
    ("function", "named"),
    [
        (lambda a, b: [np.arctan2(a, b)], "numpy.arctan2"),
        (lambda a, b: [a**3], "3"),
        (lambda a, b: [np.sum(a, axis=0, keepdims=True)], "numpy.add"),
        (lambda a, b: [np.sum(a, axis=0, initial=1.0)], "numpy.add"),
    ],
)
def test_what_cannot_be_compiled_is_refused(function, named):
    batch = batch_of(function, a=ONES, b=ONES)
    assert_refused(lambda: run(batch, ONCE), NotImplementedError, named)


@pytest.mark.parametrize("cars", [0, 3])
def test_arrays_of_different_cars_are_refused(cars):
    batch = batch_of(lambda a, b: [a], a=np.ones((1, cars)), b=np.ones((1, 0)))
    assert_refused(lambda: run(batch, ONCE), ValueError, "cars")


def test_without_llvm_a_batch_steps_in_numpy_and_one_line_says_so(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    monkeypatch.setattr(steps, "_has_llvm", cache(steps._has_llvm.__wrapped__))
    for batch in (batch_of(lambda a, b: [a * b], a=ONES, b=2.0 * ONES) for _ in range(2)):
        assert np.array_equal(run(batch, ONCE, keep=True)[0][0], 2.0 * ONES)
    (line,) = capsys.readouterr().err.splitlines()
    assert "llvmlite" in line


def agree(batch, ticks, *given):
    """All arrays of a batch after steps, compiled and in NumPy from the same states; 6 of 50, the
    others compiled.
    """
    for index in range(len(ticks)):
        now = [one[index : index + 1] for one in (ticks, *given)]
        if index % 50 < 6:
            twin = deepcopy(batch)
            run_in_numpy(twin, *now)
        run(batch, *now)
        if index % 50 < 6:
            for (found, name), (expected, _) in zip(
                attributes(batch), attributes(twin), strict=True
            ):
                if isinstance(found[name], np.ndarray):  # not the constants
                    assert_allclose(
                        found[name],
                        expected[name],
                        rtol=1e-9,
                        atol=1e-9,
                        err_msg=f"{name}, {index}",
                    )


@pytest.mark.slow
def test_steps_of_turns():
    """The tails swing, the cars slide or tip."""
    scenarios = [load_scenario("turn_designed", words) for words in FRICTIONS]
    cars = VehicleParams.from_scenarios(scenarios)
    plans = TurnPlans.from_scenarios(scenarios)
    begun = drive_turns(cars, plans, duration=0.0).last
    driven = TurnRollout(cars, plans, begun, 0.002)
    index = np.arange(600)
    agree(driven, index % 5 == 0, 0.002 * index)
    assert (driven._phase >= SwingState.SWING).all()


@pytest.mark.slow
@pytest.mark.parametrize("played", [False, True])
def test_steps_of_swerves(played):
    """At 6 m/s, steered to either side; the tail follows the state, or knots."""
    words = ("manoeuvre.speed=6.0", *FOLLOWING)
    scenarios = [load_scenario("swerve", (*settings, *words)) for settings in FRICTIONS]
    cars = VehicleParams.from_scenarios(scenarios)
    n = cars.count
    steering = np.outer([0.3, -0.2, 0.1, 0.1, 0.4], np.linspace(0.5, 1.5, n))
    if played:
        knots = knots_of(find_swing("thesis_8_rad_per_s"), n)
        rollout = PlayedSwerve(cars, scenarios[0], steering, np.zeros(n), knots)
    else:
        gains = {name: value * np.ones(n) for name, value in scenarios[0].feedback}
        rollout = FeedbackSwerve(cars, scenarios[0], steering, SimpleNamespace(**gains))
    index = np.arange(500)
    agree(rollout, index % 5 == 0, 0.002 * index - 0.1)
    assert np.all(np.abs(rollout.state[STATES.index("yaw")]) > 0.01)
