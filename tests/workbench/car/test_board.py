"""The anti-ramp board: what it stops, and what it weighs."""

import math

import numpy as np
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from tests.certain_cars import HIGH_CAR
from tests.workbench.stands import CarStand

FULL_THROTTLE = ("manoeuvre.speed=12.9", "manoeuvre.speed_ramp=0.001", "manoeuvre.duration=1.2")


def started(*settings):
    settings = [*HIGH_CAR, *FULL_THROTTLE, *settings]
    return simulate(load_scenario("straight", settings), record="outcome")


@pytest.mark.slow
@pytest.mark.parametrize("tail", ["none", "held"])
def test_full_throttle_from_rest_lifts_the_front_wheels_and_the_board_stops_it(tail):
    log = started(f"tail.mode={tail}")
    car = load_scenario("straight").car
    assert metrics_of(log).outcome.result == "survived"
    assert log.signal("ground_contact_board_truth_n").max() > 10.0
    # The pitch at which the lower face of the rear edge meets the ground, with the rear suspension
    # on its stops.
    lever = math.hypot(car.board_x, car.tyre_radius - car.board_height)
    touch = math.asin(car.tyre_radius / lever) - math.asin(
        (car.tyre_radius - car.board_height) / lever
    )
    assert 0.1 < -log.signal("pitch_truth_rad").min() < touch + 0.05


@pytest.mark.parametrize("tail", ["none", "held"])
def test_without_its_board_the_car_tips_over_backwards(tail):
    run = started(f"tail.mode={tail}", "car.board=false")
    assert metrics_of(run).outcome.result == "flipped"
    # Backwards and not sideways: the nose went up beyond 60 degrees.
    assert -run.signal("pitch_truth_rad").min() > math.radians(60.0)


def test_car_weighs_and_balances_the_same_without_its_board():
    with_board, without = (
        CarStand(load_scenario("turn_none", [f"car.board={word}"])) for word in ("true", "false")
    )
    assert without.plant.CalcTotalMass(without.plant_context) == pytest.approx(
        with_board.plant.CalcTotalMass(with_board.plant_context), rel=1e-9
    )
    np.testing.assert_allclose(without.com(), with_board.com(), atol=1e-8)
    assert not without.plant.HasBodyNamed("board")
