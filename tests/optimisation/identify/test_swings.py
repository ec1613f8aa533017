"""Fits on swings: the pendulum against the rig's plant, known truth, and what can go wrong."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    fit_added_mass,
    fit_friction,
    fit_robot_tail,
    still_tail_law,
)
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.core.errors import FitError, UserError
from aerodima.workbench.rig.pendulum import (
    PendulumModel,
    air_torque,
    friction_torque,
    known_friction,
)
from aerodima.workbench.rig.swing_motion import simulate_swing, torque_response
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.optimisation.coverage import assert_standard, draws
from tests.optimisation.identify import swing_truth as truth
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import changed, stating


@pytest.mark.parametrize("name", ["flick", "bar", "robot"])
def test_rollout_converges_below_an_encoder_count(name):
    """The step of the fits against an eighth of it; the forces have kinks at the jet's edge, so not
    to rounding.
    """
    scenario = load_rig_scenario(name)
    pendulum = PendulumModel.from_scenario(scenario)
    torques = [t for t in (air_torque(scenario), known_friction(scenario)) if t is not None]
    coarse = np.array(simulate_swing(pendulum, torques, (1.2, 0.5), 0.004, 251))
    fine = np.array(simulate_swing(pendulum, torques, (1.2, 0.5), 0.0005, 2001))[:, ::8]
    angle, rate = np.max(np.abs(coarse - fine), axis=1)
    assert angle < 0.2 * 1.18e-4
    assert rate < 1e-3


def test_motor_torque_moves_it_downstream_and_a_motion_without_bounds_is_refused():
    pendulum = PendulumModel.from_scenario(load_rig_scenario("bar"))
    assert simulate_swing(pendulum, [], (0.0, 0.0), 0.004, 251, motor=[0.2] * 250)[0][-1] > 0.3
    with pytest.raises(FitError):
        simulate_swing(pendulum, [], (0.0, 0.0), 0.004, 251, motor=[500.0] * 250)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "duration"), [("bar", 4), ("robot", 2)])
def test_friction_of_a_simulated_swing_is_found(name, duration):
    scenario = load_rig_scenario(name, [f"experiment.duration={duration}"])
    result = fit_friction(swing_data(simulate(scenario), f"{name}_swing"))
    known = scenario.joint_friction
    assert result["coulomb"].value == pytest.approx(known.coulomb, rel=0.02)
    assert result["viscous"].value == pytest.approx(known.viscous, rel=0.04)
    assert result.success


@pytest.mark.slow
def test_added_mass_of_a_simulated_flick_is_found_and_brings_the_motion_to_the_noise():
    scenario = load_rig_scenario("flick", ["aero.added_mass=0.02", "experiment.duration=2.5"])
    result = fit_added_mass(swing_data(simulate(scenario), "swing"))
    assert result["added_mass"].value == pytest.approx(0.02, rel=0.005)
    assert result["added_mass"].holds(0.02)
    assert result.facts["angle_rms_with_rad"] < 0.2 * result.facts["angle_rms_without_rad"]


@pytest.mark.slow
def test_robot_tail_line_is_found_and_bins_lie_on_it():
    scenario = load_rig_scenario("robot", ["experiment.wind_speed=7.5", "experiment.duration=2.5"])
    data = swing_data(simulate(scenario), "robot_swing")
    line = fit_robot_tail(data, "line")
    # The rig's air is the line of ERRATA E26, 0.0449 v + 1.581.
    assert line["cn_slope"].value == pytest.approx(0.0449, abs=0.003)
    assert line["cn_intercept"].value == pytest.approx(1.581, abs=0.02)
    bins = fit_robot_tail(data, "bins")
    for estimate in bins.free:
        if estimate.name.startswith("cn_at_") and estimate.standard_deviation < 0.02:
            speed = float(estimate.name.removeprefix("cn_at_"))
            assert estimate.value == pytest.approx(0.0449 * speed + 1.581, abs=0.06)


@pytest.mark.slow
@draws(8, 30)
def test_intervals_of_added_mass_hold_the_truth_although_the_current_is_noisy(number):
    rng = np.random.default_rng(7)
    scores = []
    for seed in range(number):
        mass = rng.uniform(-0.01, 0.05)
        found = truth.added_mass_of(truth.flick_log(mass, seed, duration=1.0))["added_mass"]
        scores.append((found.value - mass) / found.standard_deviation)
    assert_standard(scores)


@pytest.mark.slow
@draws(6, 40)
def test_intervals_of_the_robot_tail_hold_the_truth(number):
    rng = np.random.default_rng(7)
    scores = []
    for _ in range(number):
        cn, angle = rng.uniform([1.2, 0.8], [2.6, 0.95])
        log = truth.robot_log(cn, angle, rng.choice([5.0, 7.5, 10.0]), rng.choice([4.0, 10.0]), 1.5)
        found = fit_robot_tail(swing_data(log, "robot_swing"))["cn"]
        scores.append((found.value - cn) / found.standard_deviation)
    assert_standard(scores)


@pytest.mark.slow
def test_an_error_of_the_model_widens_the_intervals_of_a_driven_swing():
    """A slow wave of the angle, as no parameter makes one: noise of angle and current explain a
    third of the square of what is left at most.
    """
    log = truth.flick_log(0.02, seed=1, duration=0.5)
    wave = 4e-3 * np.sin(40.0 * log.table.time_s)
    honest, bent = (
        truth.added_mass_of(changed(log, angle_rad=log.table.angle_rad + added))
        for added in (0.0, wave)
    )
    larger = bent.residual_rms["angle"] / honest.residual_rms["angle"]
    assert larger > 5.0
    wider = bent["added_mass"].standard_deviation / honest["added_mass"].standard_deviation
    assert wider == pytest.approx(larger / math.sqrt(3.0), rel=0.5)
    assert abs(bent["added_mass"].value - 0.02) < 3.0 * bent["added_mass"].standard_deviation


def test_noise_of_the_motor_is_that_of_the_mean_of_the_samples_of_a_step():
    data = swing_data(truth.flick_log(0.0, seed=5), "swing")
    stride = round(data.step * truth.RATE)
    rng = np.random.default_rng(5)
    time = np.arange(1500) / truth.RATE
    current = 1.5 * np.sin(2.0 * math.pi * (1.0 + rng.uniform()) * time)
    means = current[: stride * len(data.motor)].reshape(-1, stride).mean(axis=1)
    error = data.motor + data.scenario.maxon.torque_constant * means
    assert stride > 1
    assert np.std(error) == pytest.approx(data.motor_deviation, rel=0.15)


def test_resting_on_after_the_swing_makes_an_interval_neither_wider_nor_narrower():
    """At rest the reading repeats one rounding error; the saw of a slow approach is no slow error
    of the model.
    """
    short, long = (
        swing_data(truth.robot_log(2.0, 0.9, 7.5, 10.0, duration), "robot_swing")
        for duration in (1.5, 4.0)
    )
    assert long.time[-1] < 2.0
    count = 25.0 / (2**16 - 1)  # 16 bits over +-12.5 rad
    assert long.rounding == pytest.approx(count)
    found = fit_robot_tail(long)
    assert found.residual_rms["angle"] == pytest.approx(count / math.sqrt(12.0), rel=0.1)
    assert found.effective_samples == pytest.approx(len(long.time), rel=0.2)
    deviation = fit_robot_tail(short)["cn"].standard_deviation
    assert found["cn"].standard_deviation == pytest.approx(deviation, rel=0.2)
    assert found["cn"].holds(2.0)


@pytest.mark.parametrize("told", ["metadata", "scenario"])
def test_the_release_of_a_log_that_was_cut_is_found(told):
    """A log of a rest of 1 s and a swing, of which the first 0.6 s are cut off and the times begin
    at zero again.
    """
    swing = truth.bar_log(0.04, 0.036, 1.4, 2.0)
    rest = pd.concat([swing.table.head(1)] * 1000).assign(time_s=np.arange(1000) / 1000.0)
    table = pd.concat(
        [rest, swing.table.assign(time_s=swing.table.time_s + 1.0)], ignore_index=True
    )
    facts, moved = {}, {"conditioning": [{"time_shift_s": 0.6}]}
    if told == "metadata":
        facts, moved = {"rest_s": [0.0, 1.0]}, {"rest_s": [-0.6, 0.4]}
    experiment = {**swing.scenario["experiment"], "rest": 1.0}
    log = replace(swing, table=table, scenario={**swing.scenario, "experiment": experiment})
    log = stating(**facts)(log)
    kept = table[table.time_s > 0.6 - 1e-9].reset_index(drop=True)
    part = stating(**moved)(replace(log, table=kept.assign(time_s=kept.time_s - 0.6)))
    released = swing_data(swing, "bar_swing")
    for one in (log, part):
        data = swing_data(one, "bar_swing")
        assert data.angle.tolist() == released.angle.tolist()
        assert data.time == pytest.approx(released.time)


def test_a_filtered_angle_is_no_count():
    log = truth.robot_log(2.0, 0.9, 7.5, 10.0, 1.5)
    angle = log.table.angle_rad.rolling(5, min_periods=1).mean()
    assert swing_data(changed(log, angle_rad=angle), "robot_swing").rounding == 0.0


def test_response_to_a_push_is_that_of_two_rollouts():
    scenario = load_rig_scenario("flick")
    pendulum = PendulumModel.from_scenario(scenario)
    air = air_torque(scenario)
    torques = [air, friction_torque(0.04, 0.036, 10.0)]
    push = [0.0] * 20 + [1e-3] + [0.0] * 39
    motion, pushed = (
        simulate_swing(pendulum, torques, (1.0, 0.0), 0.004, 61, motor=motor)
        for motor in ([0.0] * 60, push)
    )
    response = torque_response(pendulum, torques, motion, 0.004, [0.0] * 60)
    # Damping within the step of the push is left out of it: half a percent, of no weight in an
    # interval.
    np.testing.assert_allclose(
        (pushed[0] - motion[0]) / 1e-3, response[:, 20], atol=1e-2 * np.max(response[:, 20])
    )


def test_jacobian_of_a_rollout_is_smooth_enough_for_differences():
    data = swing_data(truth.flick_log(0.01, seed=3), "swing")
    problem = SwingModel(data, still_tail_law).problem([added_mass_parameter(data)])
    x = problem.parameters.initial
    one_sided = problem.forward_jacobian(x, problem.residual(x))
    central = problem.central_jacobian(x)
    size = np.linalg.norm(central, axis=0)
    assert np.all(np.linalg.norm(one_sided - central, axis=0) < 1e-2 * size)


def gap(log):
    return replace(log, table=log.table.drop(index=range(500, 900)).reset_index(drop=True))


def still(log):
    return replace(changed(log, angle_rad=1.0), scenario={"mount": {}}, extra={})


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda log: replace(log, table=log.table.head(3)), ("3 samples",)),
        (gap, ("time_s", "0.401 s", "0.499 s")),
        (still, ("1.0000 rad",)),
        (lambda log: changed(log, angle_rad=1.0), ("1.0000 rad",)),
        (stating(rest_s=[0.0, 99.0]), ("99 s", "2 s")),
        (lambda log: changed(log, time_s=1e3 * log.time), ("1 s",)),
        (lambda log: changed(log, current_a=900.0), ("current_a", "900", "60 A")),
        (stating(current_sampling="often"), ("current_sampling", "often")),
    ],
)
def test_a_bad_swing_log_is_refused(damage, named):
    log = damage(truth.bar_log(0.04, 0.036, 1.4, 2.0))
    assert_refused(lambda: swing_data(log, "bar_swing"), UserError, *named)
