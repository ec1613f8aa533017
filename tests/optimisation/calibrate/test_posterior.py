"""Emulator, sampler, intervals and information, on cars whose answer is known in closed form."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.stats import norm

from aerodima.optimisation.calibrate import validation
from aerodima.optimisation.calibrate.calibration import (
    Posterior,
    log_density,
    log_likelihood,
    sample,
)
from aerodima.optimisation.calibrate.calibration_plan import (
    DISCREPANCY,
    LIFT,
    CarPrior,
    figures_of,
    load_plan,
)
from aerodima.optimisation.calibrate.regression import Regression, TrainingSet, tune
from aerodima.optimisation.calibrate.surrogate import METRICS, Surrogate, _unseen
from aerodima.optimisation.studies.runs import CachedRunner

SHIPPED = load_plan()
PLAN = SHIPPED.model_copy(
    update={
        "size": SHIPPED.size.model_copy(update={"walkers": 60, "steps": 600}),
        "discrepancy": (0.049, 0.051),
        "trends": (),
    }
)
PRIOR = CarPrior(PLAN)
RNG = np.random.default_rng(0)


NO_RESIDUALS = np.zeros((0, 1))


def tuned_process(data):
    return Regression.process(data, tune(data.tuning_rows()))


def constant(value, deviation=1e-6):
    return level([value], deviation)


def level(values, deviation=1e-6):
    """Values (k) that are the same for all cars."""
    model = partial(_line, values, np.zeros((1, len(values))))
    return Regression((0,), model, np.full(len(values), deviation), NO_RESIDUALS)


def cars_on(turn, friction, number=1):
    """Drawn cars, always the same, of which each has this friction in the system of a turn."""
    cars = PRIOR.draw(number, seed=4)
    cars[:, PRIOR.column(turn.friction)] = friction
    return cars


def emulator(slope=None, level=0.0):
    """All figures as published, whatever the car, but one that is a line in one coordinate; all
    outcomes certain.

    Args:
        slope: name of the figure, of the coordinate, and the figure's change over half of the
            coordinate's range.
        level: added to that figure.
    """
    figures = {}
    for turn in PLAN.turns:
        if turn.table:
            row = np.array([3.0] * len(METRICS))
            line = np.zeros((len(PRIOR.names), len(METRICS)))
            for figure in (f for f in figures_of(PLAN) if f.turn == turn):
                place = METRICS.index(figure.metric)
                row[place] = figure.published
                if slope is not None and figure.name == slope[0]:
                    row[place] += level
                    line[PRIOR.column(slope[1]), place] = slope[2]
            columns = tuple(range(len(line)))
            model = partial(_line, row, line)
            figures[turn.name] = Regression(columns, model, np.full(len(row), 1e-6), NO_RESIDUALS)
    flips = {turn.name: constant(9.0 if turn.ends == "survived" else -9.0) for turn in PLAN.turns}
    return Surrogate(PRIOR, flips, figures)


def _line(row, line, inputs):
    return row + inputs @ line


def test_a_trend_counts_what_differs_from_a_power_of_the_speed():
    """Equal yaw rates cost nothing; one that is off by its deviation costs half a nat, less what
    the mean of all five takes up.
    """
    trend = SHIPPED.trends[0]
    plan = PLAN.model_copy(update={"trends": (trend,)})
    cars = PRIOR.draw(3, seed=1)
    reference = plan.reference(trend).name
    shown = {reference: np.full((3, len(METRICS)), 2.0)}

    def log_trends(rates):
        means = {
            turn.name: level(np.log([rate, 1.0]))
            for turn, rate in zip(trend.turns(), rates, strict=True)
        }
        surrogate = replace(emulator(), prior=replace(PRIOR, plan=plan), means=means)
        return surrogate.log_trends(cars, shown)

    assert log_trends([2.0] * 4) == pytest.approx(0.0)
    off = 2.0 * np.exp(trend.deviation)
    assert log_trends([2.0, off, 2.0, 2.0]) == pytest.approx(-0.5 * (1.0 - 1.0 / 5.0))


def test_curved_figures_are_learnt_and_what_is_missed_is_said():
    cars = PRIOR.spread(900, seed=1)
    scaled = PRIOR.scaled(cars)
    x, y, z = scaled[:, :3].T
    bent = 2.0 + x - 0.5 * x * z + 0.3 * np.tanh(2.0 * y)
    values = np.column_stack([bent, 1.0 - bent]) + 0.05 * RNG.standard_normal((len(cars), 1))
    fitted = tuned_process(TrainingSet([0, 1, 2], scaled, values, np.arange(len(cars))))
    assert np.std(fitted(scaled)[:, 0] - bent) < 0.04
    assert fitted.deviation == pytest.approx([0.05, 0.05], rel=0.35)
    twice = np.tile(np.arange(900), 2)
    repeated = tuned_process(TrainingSet([0, 1, 2], scaled[twice], values[twice], twice))
    # A car does not vouch for itself.
    assert repeated.deviation == pytest.approx([0.05, 0.05], rel=0.35)


def test_deviation_of_a_surface_is_that_of_normal_errors_and_knows_no_wild_ones():
    scaled = RNG.uniform(-1.0, 1.0, size=(1000, 1))
    errors = np.array([0.05, 0.2]) * RNG.standard_normal((1000, 2))
    errors[::100] += 2.0  # cars at the edge of a flip
    errors[50::100] -= 2.0
    fitted = Regression.line(TrainingSet([0], scaled, scaled + errors, np.arange(1000)))
    assert fitted.deviation == pytest.approx([0.05, 0.2], rel=0.12)


def test_what_is_missed_of_a_row_is_its_value_less_the_prediction_without_its_car():
    cars = PRIOR.spread(60, seed=16)
    scaled = PRIOR.scaled(cars)
    values = scaled[:, :1] + 0.01 * RNG.standard_normal((len(cars), 1))
    values[7] += 1.0
    data = TrainingSet([0], scaled, values, np.arange(len(cars)))
    for fit in (tuned_process, Regression.line):
        assert fit(data).residuals[7, 0] == pytest.approx(1.0, abs=0.15)


def test_margin_of_a_car_that_was_not_seen_lacks_what_is_missed_of_its_flip():
    turn = PLAN.turns[0]
    tried = cars_on(turn, 0.5, number=2)
    surface = replace(constant(0.0), residuals=np.array([[0.1], [-0.05]]))
    flip = np.array([np.log(0.6), np.nan, np.log(0.7)])
    margin = _unseen(PRIOR, turn, flip, surface, tried, np.array([0, 2]))
    assert margin == pytest.approx([np.log(0.6 / 0.5) - 0.1, np.log(0.7 / 0.5) + 0.05])


@pytest.mark.slow
def test_full_cars_shift_flips_and_figures_go_with_the_margin():
    """Full cars flip at a tenth more friction, and show a figure that is 3 less the logarithm of
    their margin.
    """
    slopes = -np.ones((1, len(METRICS)))
    line = partial(_line, 3.0, slopes)
    leaning = Regression((len(PRIOR.names),), line, np.ones(len(METRICS)), NO_RESIDUALS)
    flips = {turn.name: constant(np.log(0.6)) for turn in PLAN.turns}
    figures = {turn.name: leaning for turn in PLAN.turns if turn.table}
    first = replace(emulator(), flips=flips, figures=figures)
    cars = PRIOR.spread(20, seed=2)
    found = {}
    for t in PLAN.turns:
        tried = cars.copy()
        tried[:, PRIOR.column(t.friction)] = 0.66 * np.exp(-0.2)
        shown = np.full((20, len(METRICS)), 3.0 - np.log(0.2))
        found[t.name] = {"flips": [np.log(0.66)] * 20, "inputs": tried, "figures": shown}
    figure = figures_of(PLAN)[0]
    found[figure.turn.name]["flips"][0] = None
    corrected = first.corrected(cars, found)
    car = cars_on(figure.turn, 0.66 * np.exp(-0.05))
    assert corrected.margin(car, figure.turn)[0] == pytest.approx(0.05, abs=1e-6)
    assert corrected.flip_deviation(figure.turn) < 1e-6
    assert corrected.value(car, figure)[0] == pytest.approx(3.0 - np.log(0.05), abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("margin", [0.0, -0.15])
def test_what_is_missed_of_a_car_is_one_number_for_all_speeds(margin):
    """A car that survives the slower turn by a hair, or against three deviations, and flips in the
    faster one.
    """
    slow, fast = PLAN.turns[:2]
    missed = 0.05
    width = PLAN.outcome_width["none"]
    car = cars_on(slow, 0.6 * np.exp(-margin))
    one = constant(np.log(0.6), missed)
    made = replace(emulator(), flips=emulator().flips | {slow.name: one, fast.name: one})
    alone = norm.cdf(margin / np.hypot(width, missed))
    assert made.survival(car, slow)[0] == pytest.approx(alone)
    errors = np.linspace(-6.0, 6.0, 20_001) * missed
    z = (errors + margin) / width
    expected = np.trapezoid(norm.pdf(errors, 0.0, missed) * norm.cdf(z) * norm.cdf(-z), errors)
    margins = {turn.name: made.margin(car, turn) for turn in made.prior.plan.turns}
    assert np.exp(made.log_outcomes(margins)[0]) == pytest.approx(expected, rel=0.01)
    rng = np.random.default_rng(5)
    drawn = [made.draw_outcomes(car, rng) for _ in range(1500)]
    assert np.mean([ends[slow.name] and not ends[fast.name] for ends in drawn]) == pytest.approx(
        expected, abs=0.025
    )
    if margin == 0.0:
        assert expected < 0.1 < made.survival(car, slow)[0] * (1.0 - made.survival(car, fast)[0])


def test_likelihood_knows_who_survived_and_whose_wheel_lifted():
    """Friction 0.5 or 0.7 at a flip of 0.6; the inner wheel lifts at 0.8 or 1.2 rad/s, published
    1.
    """
    first = emulator()
    turn = PLAN.turns[0]
    cars = np.vstack([cars_on(turn, friction) for friction in (0.5, 0.7)])
    made = replace(first, flips=first.flips | {turn.name: constant(np.log(0.6))})
    low, high = log_likelihood(made, (), cars)
    assert low > high + 5.0
    ends = (turn.model_copy(update={"ends": "flipped"}), *PLAN.turns[1:])
    flipped = replace(made, prior=CarPrior(PLAN.model_copy(update={"turns": ends})))
    low, high = log_likelihood(flipped, (), cars)
    assert low < high - 5.0

    def lifting(rate):
        row = np.where(np.array(METRICS) == LIFT, rate, 3.0)
        figures = first.figures | {turn.name: level(row)}
        return log_likelihood(replace(first, figures=figures), (), cars)[0]

    assert lifting(1.2) > lifting(0.8) + 2.0


@pytest.mark.slow
def test_posterior_is_that_of_the_closed_form():
    """A figure that is linear in one coordinate leaves a normal of known mean and deviation."""
    (figure,) = (f for f in figures_of(PLAN) if f.name == "Table 7.3 max_yaw_rate_rad_per_s")
    slope = 4.0 * 0.05 * figure.published
    found = sample(emulator((figure.name, "imu.x", slope), -0.2 * slope), figures_of(PLAN), seed=1)
    scaled = PRIOR.scaled(found.cars)[:, PRIOR.column("imu.x")]
    assert found.size > 100
    assert np.mean(scaled) == pytest.approx(0.2, abs=0.05)
    assert np.std(scaled) == pytest.approx(0.25, rel=0.15)
    free = PRIOR.scaled(found.cars)[:, PRIOR.column("imu.z")]
    assert np.std(free) == pytest.approx(1 / np.sqrt(3), rel=0.1)


def test_density_of_a_figure_is_a_normal_of_its_share_and_that_of_cars_their_mean():
    figure = figures_of(PLAN)[0]
    car = PRIOR.draw(1, seed=5)
    made = emulator((figure.name, "imu.x", 0.0), 0.1 * figure.published)
    # A share of what is predicted.
    spread = 1.1 * car[0, PRIOR.column(DISCREPANCY)]
    expected = -0.5 * (0.1 / spread) ** 2 - np.log(spread * np.sqrt(2 * np.pi))
    assert log_density(made, figure, car)[0] == pytest.approx(expected, rel=1e-6)
    same = np.repeat(car, 5, axis=0)
    assert validation.joint_density(made, [figure], same) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
@pytest.mark.nightly
def test_intervals_hold_what_they_promise_when_the_model_is_perfect():
    posterior = Posterior(PRIOR.draw(400, seed=6), 400.0, 0.3)
    inside = validation.perfect_model(
        emulator(), posterior, ("Table 7.3", "Table 7.4"), 2, 7, CachedRunner()
    )
    assert 0.75 <= inside <= 1.0


@pytest.mark.slow
def test_left_out_table_is_predicted_without_its_figures():
    """Its own figures, however far off, leave the prediction where the other tables put it."""
    table = "Table 7.4"
    moved = [
        replace(f, published=9.0 * f.published) if f.turn.table == table else f
        for f in figures_of(PLAN)
    ]
    honest, far = (
        validation.leave_out(validation.Question(emulator(), figures, table, 8))
        for figures in (figures_of(PLAN), moved)
    )
    assert all(row["inside"] for row in honest.rows)
    assert not any(row["inside"] for row in far.rows)
    assert honest.density > far.density + 20.0
    for row, other in zip(honest.rows, far.rows, strict=True):
        for name in ("low", "median", "high"):
            assert row[name] == pytest.approx(other[name], rel=1e-9)


@pytest.mark.parametrize("name", ["tail mass", "angle of balance", "slip angle at the limit"])
def test_simulated_measurement_narrows_the_posterior_as_promised(name):
    """The mean of the divergence of the narrowed cars from all of them is the promised gain."""
    cars = PRIOR.draw(1500, seed=9)
    measured = next(m for m in validation.measurements(PRIOR) if m.name == name)
    promised = validation.information(measured, cars, seed=10)
    rng = np.random.default_rng(11)
    gains = []
    for truth in rng.choice(measured.value(cars), 300):
        seen = truth + measured.deviation * rng.standard_normal()
        weights = norm.pdf(seen, measured.value(cars), measured.deviation)
        weights /= weights.sum()
        gains.append(np.sum(weights * np.log(np.maximum(weights * len(cars), 1e-300))))
    assert promised > 0.3
    assert np.mean(gains) == pytest.approx(promised, abs=0.12)


@pytest.mark.slow
def test_best_determined_combination_is_the_one_that_was_measured():
    cars = PRIOR.draw(3000, seed=14)
    measured = "physical car.tyre_friction", "car.com_height"
    product = np.prod(cars[:, [PRIOR.column(name) for name in measured]], axis=1)
    kept = cars[np.abs(product / np.median(product) - 1.0) < 0.05]
    ratio, weights = validation.combinations(PRIOR, kept, 15)[0]
    assert ratio < 0.1
    assert set(list(weights)[:2]) == set(measured)
    assert np.prod([weights[name] for name in measured]) > 0.0
