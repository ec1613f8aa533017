"""Plan and prior of the two systems: what is refused, what a car can be, and what its runs get."""

import numpy as np
import pandas as pd
import pytest
import yaml

from aerodima.optimisation.calibrate.calibration_plan import (
    NEEDED,
    CarPrior,
    figures_of,
    load_plan,
)
from aerodima.optimisation.calibrate.validation import measurements
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import read_yaml
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

PLAN = load_plan()
PRIOR = CarPrior(PLAN)


def changed(tmp_path, **changes):
    content = read_yaml(model_path("calibration/plans/two_systems.yaml"))
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(content | changes))
    return path


def sized(**sizes):
    return {"size": PLAN.size.model_dump() | sizes}


def with_turns(turns):
    return {"turns": [turn.model_dump() for turn in turns]}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"body": [*PLAN.body, "car.com_hight"]}, ("car.com_hight", "com_height")),
        ({"body": [*PLAN.body, "car.gearbox_mass"]}, ("car.gearbox_mass",)),
        (
            {"ranges": {"car.tyre_slip_angel": [0.1, 0.2]}},
            ("car.tyre_slip_angel", "car.tyre_slip_angle"),
        ),
        ({"ranges": {"car.tyre_slip_angle": [0.2, 0.1]}}, ("0.2", "0.1")),
        ({"nuisances": {"window": [0.5, 0.9]}}, ("latency",)),
        ({"nuisances": PLAN.nuisances | {"latency": [0.0, 0.6]}}, ("latency", "0.6", "0.3")),
        ({"outcome_width": {"none": 0.01, "held": 0.01}}, ("outcome_width", "swing")),
        ({"left_out": {"Table 7.1 roll": "no"}}, ("Table 7.1 roll",)),
        ({"body": [*PLAN.body[:8], *PLAN.body[9:]]}, ("body", "imu.x")),
        (
            with_turns(PLAN.turns[:4]) | {"ranges": {}, "density": {}},
            ("turns: system", "physical"),
        ),
        (sized(rounds=40), ("rounds", "40")),
        (sized(cars=1990), ("2002", "2000")),
        (with_turns(t for t in PLAN.turns if t.table in ("", "Table 7.3")), ("two",)),
        (with_turns((*PLAN.turns, PLAN.turns[0])), ("Table 7.1",)),
        ({"trends": [PLAN.trends[0].model_dump() | {"tail": "held"}]}, ("trends", "held")),
        ({"schema": "aerodima/calibration-plan/2"}, ("calibration-plan/2",)),
    ],
)
def test_wrong_plan_is_refused_with_place_and_value(tmp_path, changes, named):
    path = changed(tmp_path, **changes)
    assert_refused(lambda: load_plan(path), ScenarioError, "plan.yaml", *named)


def test_a_body_of_the_needed_keys_has_all_that_the_lab_measures():
    prior = CarPrior(PLAN.model_copy(update={"body": NEEDED}))
    cars = prior.spread(2, seed=1)
    assert all(np.isfinite(one.value(cars)).all() for one in measurements(prior))


def test_figures_are_those_of_the_tables_less_those_that_no_car_reaches():
    names = [figure.name for figure in figures_of(PLAN)]
    assert len(names) == len(set(names)) == 4 * 5 - 3
    assert not set(names) & set(PLAN.left_out)
    published = {figure.name: figure.published for figure in figures_of(PLAN)}
    assert published["Table 7.3 max_yaw_rate_rad_per_s"] == 1.91
    assert published["Table 7.4 average_yaw_rate_rad_per_s"] == 0.70


def test_every_car_of_the_prior_is_a_scenario_in_both_systems():
    for car in PRIOR.draw(6, seed=1):
        for turn in PLAN.turns:
            load_scenario(f"turn_{turn.tail}", PRIOR.settings(car, turn))


def test_the_systems_share_a_body_and_have_tyres_of_their_own():
    car = PRIOR.draw(1, seed=2)[0]
    simulated, physical = (PRIOR.settings(car, turn) for turn in (PLAN.turns[0], PLAN.turns[4]))
    body = len(PLAN.body)
    assert simulated[:body] == physical[:body]
    assert not set(simulated[body : body + 2]) & set(physical)


def test_a_biased_gyro_swings_earlier():
    car = PRIOR.draw(1, seed=3)[0]
    car[PRIOR.column("gyro_bias")] = 0.04
    (fast,) = (turn for turn in PLAN.turns if turn.table == "Table 7.4")
    scenario = load_scenario("turn_swing", PRIOR.settings(car, fast))
    assert scenario.controller.trigger_yaw_rate == pytest.approx(0.96)


def test_parts_of_the_car_lie_inside_the_prior():
    parts = pd.read_csv(model_path("calibration/parts.csv"))
    assert (parts.min_mass_kg <= parts.mass_kg).all()
    assert (parts.mass_kg <= parts.max_mass_kg).all()
    mass = parts.mass_kg.sum()
    places = parts.mass_kg @ parts[["x_m", "z_m"]] / mass
    for key, value in (("mass", mass), ("com_x", places.x_m), ("com_height", places.z_m)):
        low, high = PRIOR.ranges[PRIOR.column(f"car.{key}")]
        assert low < value < high


def test_density_is_that_of_the_plan_and_nothing_outside():
    cars = np.tile(PRIOR.draw(1, seed=4), (3, 1))
    mean = PLAN.density["car.com_height"].mean
    cars[:, PRIOR.column("car.com_height")] = mean, mean + 0.04, 0.5
    here, there, outside = PRIOR.log_density(cars)
    assert here - there == pytest.approx(0.5)
    assert outside == -np.inf
