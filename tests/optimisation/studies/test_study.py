"""Study files: grids, samples, ensembles; what is wrong in them is named."""

import numpy as np
import pytest

from aerodima.optimisation.studies.study import (
    Normal,
    Sample,
    Uniform,
    load_study,
    plan_runs,
)
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from tests.optimisation.studies.tiny import tiny_study, write_study
from tests.refusals import assert_refused


def test_grid_is_every_combination_in_order(tmp_path):
    text = (
        "grid:\n  manoeuvre.speed: [2.0, 3.0]\n  car.tyre_friction: {first: 0.5, last: 0.6, "
        "number: 3}\n"
    )
    runs = plan_runs(load_study(write_study(tmp_path / "s.yaml", text)))
    points = [(run.place["manoeuvre.speed"], run.place["car.tyre_friction"]) for run in runs]
    assert points == [(v, mu) for v in (2.0, 3.0) for mu in (0.5, 0.55, 0.6)]
    scenario = load_scenario(runs[1].task.scenario, list(runs[1].task.settings))
    assert (scenario.manoeuvre.speed, scenario.car.tyre_friction, scenario.tail.mode) == (
        2.0,
        0.55,
        "none",
    )


@pytest.mark.parametrize("method", ["sobol", "lhs"])
def test_sample_is_even_within_its_limits_and_the_same_for_the_same_seed(method):
    factors = {
        "car.mass": Uniform(low=5.0, high=6.0),
        "manoeuvre.speed": Normal(mean=4.0, deviation=0.1),
    }
    sample = Sample(method=method, number=64, seed=3, factors=factors, new_seeds=True)
    rows = sample.rows()
    assert rows == sample.rows()
    assert rows != sample.model_copy(update={"seed": 4}).rows()
    mass, speed = (np.array([row[name] for row in rows]) for name in factors)
    assert 5.0 <= mass.min() <= 5.05
    assert 5.95 <= mass.max() <= 6.0
    assert np.mean(mass) == pytest.approx(5.5, abs=0.02)  # a random sample of 64 would err by 0.036
    assert (np.mean(speed), np.std(speed)) == pytest.approx((4.0, 0.1), abs=0.02)
    assert [row["seed"] for row in rows] == list(range(1, 65))


def test_ensemble_multiplies_the_runs_and_overrides_come_after_the_member(tmp_path):
    text = (
        "scenario: straight\nsettings: [car.com_x=0.13]\n"
        "ensemble: physical\nmembers: 2\ngrid:\n  car.com_height: [0.2]\n"
    )
    path = tmp_path / "s.yaml"
    path.write_text(text)
    runs = plan_runs(load_study(path))
    members = load_ensemble("physical").resample(2)
    assert [run.place["member"] for run in runs] == [member.name for member in members]
    assert sum(float(run.place["weight"]) for run in runs) == pytest.approx(1.0)
    cars = [load_scenario("straight", list(run.task.settings)).car for run in runs]
    assert {(car.com_x, car.com_height) for car in cars} == {(0.13, 0.2)}
    assert cars[0] != cars[1]


def test_small_and_large_numbers_reach_the_scenario_as_numbers(tmp_path):
    text = "grid:\n  sail_encoder.noise: [1.0e-5]\n  car.tyre_stiffness_front: [1.0e6]\n"
    (run,) = plan_runs(load_study(write_study(tmp_path / "s.yaml", text)))
    scenario = load_scenario("straight", list(run.task.settings))
    assert (scenario.sail_encoder.noise, scenario.car.tyre_stiffness_front) == (1e-5, 1e6)


OWN_SEEDS = "sample: {number: 2, new_seeds: true, factors: {car.mass: {low: 5.0, high: 6.0}}}\n"


def test_seeds_of_grid_and_sample_are_added_as_integers(tmp_path):
    text = f"grid: {{seed: [0, 1000]}}\n{OWN_SEEDS}"
    runs = plan_runs(load_study(write_study(tmp_path / "s.yaml", text)))
    scenarios = [load_scenario("straight", list(run.task.settings)) for run in runs]
    assert [scenario.seed for scenario in scenarios] == [1, 2, 1001, 1002]


WRONG = [
    ("grid:\n  car.tyre_frction: [0.5]\n", ("car.tyre_frction", "car.tyre_friction")),
    ("grid:\n  cars.mass: [5.0]\n", ("cars", "car")),
    ("grid:\n  speed: [5.0]\n", ("speed",)),
    ("grid:\n  car.mass: []\n", ("car.mass", "[]")),
    ("grid:\n  car.mass: {first: 5.0, last: 6.0, number: 0}\n", ("number", "0")),
    ("grid:\n  car.mass: [.nan]\n", ("nan",)),
    ("sample: {number: 4, factors: {}}\n", ("factors",)),
    ("sample: {number: 4, factors: {car.mass: {low: 6.0, high: 5.0}}}\n", ("high", "5")),
    ("grid: {seed: [x]}\nsample: {number: 2, factors: {seed: {low: 5.0, high: 6.0}}}\n", ("seed",)),
    (f"grid: {{seed: [x]}}\n{OWN_SEEDS}", ("seed", "numbers")),
    ("samples: {number: 4}\n", ("samples",)),
    (
        "grid: {car.mass: {first: 5, last: 6, number: 9999}, "
        "car.track: {first: 0.2, last: 0.3, number: 99}}",
        ("989901", "100000"),
    ),
    ("ensemble: nothing\n", ("nothing",)),
]


@pytest.mark.parametrize(("text", "named"), WRONG)
def test_mistakes_in_a_study_are_named(tmp_path, text, named):
    path = write_study(tmp_path / "wrong.yaml", text)
    assert_refused(lambda: plan_runs(load_study(path)), UserError, *named)


@pytest.mark.parametrize(
    ("was", "becomes"), [("study/1", "study/0"), ("scenario: straight", "scenario: sideways")]
)
def test_other_schema_and_missing_scenario_are_refused(tmp_path, was, becomes):
    path = tiny_study(tmp_path)
    path.write_text(path.read_text().replace(was, becomes))
    assert_refused(lambda: load_study(path), UserError, str(path), becomes.split(": ")[-1])
