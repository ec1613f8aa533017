"""Runs of the calibration: figures of a known motion, reduced against full cars, and the whole job,
which goes on.
"""

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.calibrate.calibration import _published_ends, fit_surrogate
from aerodima.optimisation.calibrate.calibration_plan import FIGURES, LIFT, CarPrior, load_plan
from aerodima.optimisation.calibrate.turn_runs import (
    AFTER,
    BEFORE,
    Motion,
    WorkItem,
    _motions,
    figures_of_motion,
    run_full,
    run_reduced,
    search_full,
)
from aerodima.optimisation.calibrate.validation_page import calibrate
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.car.reduced.rollout import STEP
from aerodima.workbench.car.reduced.states import RATES, STATES, V, W
from aerodima.workbench.car.reduced.turns import Turns
from aerodima.workbench.scenario.ensemble import load_ensemble
from tests.commands import refused

PLAN = load_plan()
PRIOR = CarPrior(PLAN)
SLOW = {turn.system: turn for turn in reversed(PLAN.turns) if turn.table and turn.tail == "none"}
STILL = {"window": 0.6, "latency": 0.0, "gyro_bias": 0.0, "forward": 0.0}


def motion(begin=0.0, end=2.0):
    """Yaws at 2 rad/s and rolls at 0.5 rad/s between two times after the steering; the inner wheels
    lift at 0.3 s.
    """
    time = STEP * np.arange(round((BEFORE + AFTER) / STEP)) - BEFORE
    turning = 1.0 * ((time >= begin - 1e-9) & (time < end - 1e-9))
    return Motion(2.0 * turning, 6.0 * turning, 0.5 * turning, time < 0.3)


def sized(plan, **size):
    return plan.model_copy(update={"size": plan.size.model_copy(update=size)})


def item(cars, system, plan=PLAN, **search):
    """Work on cars (m, n) in the slow turn of a system."""
    return WorkItem(plan, SLOW[system], tuple(map(tuple, cars)), **search)


def test_figures_of_a_steady_turn_in_the_simulated_system():
    found = figures_of_motion(motion(), SLOW["simulated"], STILL)
    assert [found[name] for name in FIGURES[:4]] == pytest.approx([2.0, 2.0, 6.0, 6.0])
    assert found["roll_integral_rad"] == pytest.approx(0.5 * AFTER, abs=0.01)
    assert found[LIFT] == 2.0


def mean_yaw_rate(begin=0.0, end=2.0, **nuisances):
    """Average yaw rate of a motion in the physical system, rad/s."""
    found = figures_of_motion(motion(begin, end), SLOW["physical"], STILL | nuisances)
    return found["average_yaw_rate_rad_per_s"]


def test_latency_moves_the_window_back_and_bias_adds():
    assert mean_yaw_rate(0.0, 0.5, latency=0.1, gyro_bias=0.03) == pytest.approx(
        2.0 * 0.5 / 0.6 + 0.03, rel=0.02
    )
    for latency in (0.0, 0.25):
        assert mean_yaw_rate(0.0, 0.25, window=0.5, latency=latency) == pytest.approx(1.0, rel=0.1)
    assert mean_yaw_rate(0.3, 0.5, window=0.5, latency=0.25) < 0.1


def test_filter_that_runs_forwards_only_is_late():
    delay = np.sqrt(2.0) / (2.0 * np.pi * 5.0)  # s, of a second-order Butterworth of 5 Hz
    forwards = mean_yaw_rate(forward=1.0)
    assert forwards == pytest.approx(2.0 * (1.0 - delay / 0.6), rel=0.01)
    assert mean_yaw_rate(forward=0.0) > 1.03 * forwards


def test_acceleration_at_the_imu_is_that_of_its_path():
    """A body that turns faster and faster about all axes while its origin moves on a curve."""
    turning = np.array([0.4, -0.5, 0.9])
    imu = np.array([0.13, 0.0, 0.21])
    time = STEP * np.arange(round(AFTER / STEP))[:, None]
    rates = (1.0 + 1.6 * time) * turning
    start, push, more = np.array([[2.0, 1.2, 0.0], [2.0, -0.6, -0.4], [0.2, -4.0, 0.3]])
    moved = start + time * (push + time * more)
    pushed = push + 2.0 * time * more
    lever = 1.6 * np.cross(turning, imu) + np.cross(rates, np.cross(rates, imu))
    expected = (pushed + np.cross(rates, moved) + lever)[:, 1]
    history = np.zeros((len(time), len(STATES), 1))
    history[:, RATES][:, W, 0] = rates
    history[:, RATES][:, V, 0] = moved
    loads = np.ones((len(history), 4, 1))
    nothing = dict.fromkeys(Turns.__dataclass_fields__, np.zeros(1))
    driven = Turns(**nothing | {"history": history, "loads": loads})
    (found,) = _motions(driven, imu[:1], imu[2:])
    first = round(BEFORE / STEP) + 1
    assert found.acceleration[first + 2 :] == pytest.approx(expected[2:-1], abs=5e-3)
    assert found.yaw_rate[first:] == pytest.approx(rates[:-1, 2])
    assert found.roll_rate[first:] == pytest.approx(rates[:-1, 0])


@pytest.mark.slow
@pytest.mark.parametrize("system", ["simulated", "physical"])
def test_reduced_cars_show_the_figures_of_full_ones(system):
    # Of 16 cars that were looked at, one misses its largest acceleration by 16 %, half by 4 %.
    cars = PRIOR.draw(2, seed=1)
    friction = PRIOR.column(SLOW[system].friction)
    cars[:, friction] = 0.5
    plan = sized(PLAN, rounds=2)
    reduced = run_reduced(item(cars, system, plan, reach=0.02))
    middle = [
        place for place, car in enumerate(reduced["inputs"]) if car[friction] == pytest.approx(0.5)
    ]
    inputs = [reduced["inputs"][place] for place in middle]
    assert len(inputs) == 2
    whole = run_full(item(inputs, system, plan))
    for full, place in zip(whole, middle, strict=True):
        assert full["survived"]
        shown = reduced["figures"][place]
        assert [full[name] for name in FIGURES[:2]] == pytest.approx(shown[:2], rel=0.05)
        assert [full[name] for name in FIGURES[2:4]] == pytest.approx(shown[2:4], rel=0.15)
        assert full[FIGURES[4]] == pytest.approx(shown[4], rel=0.2, abs=0.01)
        assert full[LIFT] == pytest.approx(shown[5], rel=0.1)


def test_car_that_cannot_be_run_has_no_figures_and_no_flip_and_its_error_is_kept():
    car = PRIOR.draw(1, seed=4)
    car[0, PRIOR.column("car.mass")] = 1.0
    piece = item(car, "simulated", reach=0.05, margins=(0.0,))
    (row,) = run_full(piece)
    found = search_full(piece)
    assert (found["flips"], found["inputs"]) == ([None], [])
    assert "car.mass: 1 kg" in row["error"]
    assert "car.mass: 1 kg" in found["errors"][0]


def test_turns_that_end_as_published_are_counted_and_errors_are_none():
    turns = PLAN.turns[:2]
    ends = [True, True, False, None], [False, True, False, False]
    rows = {
        turn.name: [{} if survived is None else {"survived": survived} for survived in column]
        for turn, column in zip(turns, ends, strict=True)
    }
    assert [turn.ends for turn in turns] == ["survived", "flipped"]
    assert _published_ends(turns, rows).tolist() == [2, 1, 1, 1]


def small_plan():
    """Two short turns of few cars: what the whole job takes is the job, not the cars."""
    settings = {system: (*given[:1], *SHORT) for system, given in PLAN.settings.items()}
    plan = PLAN.model_copy(update={"turns": tuple(SLOW.values()), "settings": settings})
    size = {"rounds": 3, "full": 4, "full_rounds": 5, "walkers": 60, "steps": 40, "ensemble": 2}
    return sized(plan, cars=40, fine_step=0.002, **size)


SHORT = ("manoeuvre.speed_ramp=1.2", "manoeuvre.turn_start=1.5", "manoeuvre.duration=3.5")


@pytest.mark.slow
def test_full_car_flips_at_the_friction_of_the_reduced_one():
    """Without a tail within 5 %, which is three times what the calibration found them apart."""
    plan = sized(small_plan(), rounds=6, full_rounds=3)
    prior = CarPrior(plan)
    car = prior.ranges.mean(axis=1)[None]
    (flip,) = run_reduced(item(car, "physical", plan, reach=0.8))["flips"]
    column = prior.column("physical car.tyre_friction")
    car[0, column] = np.exp(flip)
    found = search_full(item(car, "physical", plan, reach=0.05, margins=(0.0,)))
    assert found["flips"][0] == pytest.approx(flip, abs=0.05)
    for tried, shown in zip(found["inputs"], found["figures"], strict=True):
        assert tried[column] < np.exp(found["flips"][0])
        assert shown[1] > 0.3  # rad/s, to the left


@pytest.mark.slow
@pytest.mark.nightly
def test_whole_job_writes_pages_and_ensembles_and_goes_on_with_its_runs(tmp_path):
    plan = small_plan()
    runs = CachedRunner()
    page = calibrate(plan, runs, tmp_path, played=1)
    assert page.is_file()
    figures = pd.read_csv(tmp_path / "figures.csv")
    assert set(figures.figure.str[:9]) == {"Table 7.1", "Table 7.3"}
    assert (figures.low <= figures["median"]).all()
    assert (figures["median"] <= figures.high).all()
    outcomes = pd.read_csv(tmp_path / "outcomes.csv")
    assert set(outcomes.survived.str[-4:]) == {"of 2"}
    measured = pd.read_csv(tmp_path / "measure_next.csv")
    assert measured.gain_nats.is_monotonic_decreasing
    for system in SLOW:
        ensemble = load_ensemble(tmp_path / f"{system}.yaml")
        assert len(ensemble.members) == 2
        for member in ensemble.members:
            ensemble.scenario(member, "turn_swing")
    before = dict(runs._known)
    again = fit_surrogate(plan, runs)
    assert runs._known == before
    assert set(again.figures) == {turn.name for turn in plan.turns}


def test_wrong_plan_is_one_line(tmp_path):
    assert "no_such" in refused("calibrate", "--plan", "no_such", "--out", tmp_path)
    assert not (tmp_path / "index.html").exists()
