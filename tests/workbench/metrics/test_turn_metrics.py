import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.signals import IMU_FILTER, low_pass
from aerodima.workbench.metrics.turn_metrics import metrics_of, outcome_from, outcome_of
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import SPEED, STEP, both_sides, made_up_run, times

TURN = (2.0, 2.64)
PEAK = 2.0
"""Of the yaw-rate pulse, rad/s."""


def pulse(peak=PEAK, start=TURN[0]):
    """Half a sine over the window: mean 2/pi of the peak, integral 2/pi of peak x length."""
    phase = np.clip((times() - start) / (TURN[1] - TURN[0]), 0.0, 1.0)
    return peak * np.sin(np.pi * phase)


def ramp(size):
    return size * np.interp(times(), TURN, [0.0, 1.0])


def doublet(size, start=2.1):
    """A roll rate out and back: +size for 0.25 s, then -size for as long; leans by size x 0.25 s in
    between.
    """
    t = times()
    return size * np.select([t < start, t < start + 0.25, t < start + 0.5], [0.0, 1.0, -1.0], 0.0)


def measured(*signals, **options):
    return metrics_of(made_up_run(*signals, **options))


def turning(side):
    """A turn to the left (side +1): yaw to the left, acceleration to the left, body and tail moving
    accordingly.
    """
    return {
        "imu_gyro_z_rad_per_s": side * pulse(),
        "imu_acceleration_y_m_per_s2": side * np.where(times() >= 1.9, 4.0, 0.0),
        "imu_gyro_x_rad_per_s": side * doublet(1.2),
        "gyro_z_truth_rad_per_s": side * pulse(),
        "acceleration_y_truth_m_per_s2": side * np.where(times() >= 1.9, 4.0, 0.0),
        "gyro_x_truth_rad_per_s": side * doublet(1.2),
        "roll_truth_rad": side * ramp(0.3),
        "yaw_truth_rad": side * ramp(0.8),
        "tilt_truth_rad": ramp(0.3),
        "tail_roll_torque_n_m": side * pulse(5.0),
        "tail_power_truth_w": pulse(10.0) - 3.0,
    }


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_known_yaw_rate_pulse_gives_the_known_metrics(side):
    """Maxima are magnitudes, averages are signed. Trapezoid sums of a sine over 320 steps err by
    (pi/320)^2/12 = 8e-6 of the integral.
    """
    raw = measured({"gyro_z_truth_rad_per_s": side * pulse()}).raw
    assert raw.speed_m_per_s == SPEED
    assert raw.max_yaw_rate_rad_per_s == pytest.approx(PEAK, rel=1e-5)
    assert raw.average_yaw_rate_rad_per_s == pytest.approx(side * PEAK * 2.0 / math.pi, rel=1e-5)
    assert raw.max_kohut_deg_m_per_s2 == pytest.approx(math.degrees(SPEED * PEAK), rel=1e-5)
    assert raw.average_kohut_deg_m_per_s2 == pytest.approx(
        side * SPEED * PEAK * 360.0 / math.pi**2, rel=1e-5
    )


def test_only_the_window_counts_and_both_its_ends_do():
    t = times()
    inside = (t >= TURN[0] - 1e-9) & (t <= TURN[1] + 1e-9)
    assert np.count_nonzero(turn_signals(made_up_run()).in_window) == 321
    raw = measured({"acceleration_y_truth_m_per_s2": np.where(inside, 1.0, 50.0)}).raw
    assert (raw.max_linear_acceleration_m_per_s2, raw.average_linear_acceleration_m_per_s2) == (
        1.0,
        1.0,
    )
    for edge in TURN:
        spike = np.where(np.abs(t - edge) < 0.5 * STEP, 7.0, 0.0)
        assert measured({"gyro_z_truth_rad_per_s": spike}).raw.max_yaw_rate_rad_per_s == 7.0


def test_left_and_right_turns_that_mirror_each_other_measure_the_same():
    left = measured(turning(1.0))
    right = measured(turning(-1.0), direction="right")
    assert (left.direction, right.direction) == ("left", "right")
    for one, other in ((left.raw, right.raw), (left.filtered, right.filtered)):
        assert astuple(one) == pytest.approx(astuple(other), rel=1e-12)
    assert left.raw.average_yaw_rate_rad_per_s > 0
    assert replace(right, direction="left", raw=left.raw, filtered=left.filtered) == left


@both_sides
def test_the_roll_integral_is_the_largest_lean_outwards(direction, side):
    """1.2 rad/s for 0.25 s outwards and back is a lean of 0.3 rad, after the turn, too; each edge
    of the doublet is blurred by a step.
    """
    for outwards, lean in ((doublet(1.2), 0.3), (doublet(-1.2), 0.0), (doublet(1.2, 3.2), 0.3)):
        rate = {"gyro_x_truth_rad_per_s": side * outwards}
        found = measured(rate, direction).raw.roll_integral_rad
        assert found == pytest.approx(lean, abs=1.2 * STEP)


def test_filtered_metrics_are_those_of_the_imu_at_100_hz_after_the_filter():
    run = made_up_run(turning(1.0))
    logged = times()[::5]
    smooth = low_pass(logged, pulse()[::5], IMU_FILTER)
    filtered = metrics_of(run).filtered
    assert filtered.max_yaw_rate_rad_per_s == pytest.approx(float(np.max(np.abs(smooth))), rel=1e-9)
    lean = np.cumsum(low_pass(logged, doublet(1.2)[::5], IMU_FILTER)) * 0.01
    assert filtered.roll_integral_rad == pytest.approx(float(np.max(lean)), rel=5e-3)
    assert filtered.roll_integral_rad < 0.95 * metrics_of(run).raw.roll_integral_rad
    assert filtered.speed_m_per_s == pytest.approx(SPEED, rel=1e-9)
    assert filtered.max_kohut_deg_m_per_s2 == pytest.approx(
        SPEED * math.degrees(filtered.max_yaw_rate_rad_per_s), rel=1e-9
    )


@pytest.mark.parametrize(
    ("rate", "kept"), [(100.0, 401), (250.0, 1001), (333.0, 1333), (500.0, 2001), (1000.0, 2001)]
)
def test_signals_at_a_rate_are_the_newest_rows_of_its_instants(rate, kept):
    """A log of 500 Hz: a slower logger keeps the row at or just before k / rate, a faster one
    nothing more.
    """
    signals = turn_signals(made_up_run({"gyro_z_truth_rad_per_s": times()})).sampled(rate)
    assert signals.time.size == signals.yaw_rate.size == len(signals.wheel_loads) == kept
    np.testing.assert_array_equal(signals.yaw_rate, signals.time)
    if rate < 500.0:
        late = np.arange(kept) / rate - signals.time
        assert late.min() > -1e-9
        assert late.max() < STEP


def test_speed_passes_the_filter_of_the_gps():
    """A 3 Hz wave with its crest at the start of the turn: 1/(1 + 3^4) of it is left at a cut-off
    of 1 Hz.
    """
    speed = SPEED + np.cos(2.0 * np.pi * 3.0 * (times() - TURN[0]))
    metrics = measured({"velocity_x_truth_m_per_s": speed, "speed_m_per_s": speed})
    assert metrics.raw.speed_m_per_s == pytest.approx(SPEED + 1.0)
    assert metrics.filtered.speed_m_per_s == pytest.approx(SPEED + 1.0 / 82.0, abs=2e-3)


def test_speed_is_that_at_the_start_of_the_turn_over_the_ground():
    speed = {"velocity_x_truth_m_per_s": 1.5 * times(), "velocity_y_truth_m_per_s": 2.0 * times()}
    assert measured(speed).raw.speed_m_per_s == pytest.approx(2.5 * TURN[0], rel=1e-12)


def test_the_rest_of_a_run_is_measured_from_the_turn_on():
    metrics = measured(turning(1.0))
    assert metrics.source == "truth"
    assert metrics.peak_roll_rad == pytest.approx(0.3)
    assert metrics.heading_change_rad == pytest.approx(0.8)
    assert metrics.tail_torque_peak_n_m == pytest.approx(5.0, rel=1e-5)
    assert metrics.two_wheel_time_s == 0.0


def test_tail_energy_is_the_positive_work_only():
    power = np.where((times() >= 2.2) & (times() < 2.5), 40.0, -25.0)
    metrics = measured({"tail_power_truth_w": power})
    assert metrics.tail_energy_j == pytest.approx(12.0, abs=40.0 * STEP)


def test_time_on_two_wheels_counts_steps_with_fewer_than_three_wheels_loaded():
    t = times()
    lifted = np.where((t >= 2.2) & (t < 2.5), 0.0, 15.0)
    three = {"wheel_force_front_left_z_truth_n": lifted}
    two = {**three, "wheel_force_rear_left_z_truth_n": lifted}
    assert measured(three).two_wheel_time_s == 0.0
    metrics = measured(two)
    assert metrics.two_wheel_time_s == pytest.approx(0.3, abs=1e-9)


def test_speed_in_the_turn_counts_where_the_car_turns():
    first = times() < 0.5 * (TURN[0] + TURN[1])
    signals = {
        "velocity_x_truth_m_per_s": np.where(first, 3.0, 2.0),
        "gyro_z_truth_rad_per_s": np.where(first, 2.0, 1.0),
    }
    expected = (3.0 * 2.0 + 2.0 * 1.0) / (2.0 + 1.0)
    assert measured(signals).speed_in_turn_m_per_s == pytest.approx(expected, rel=STEP / 0.32)
    assert measured().speed_in_turn_m_per_s == SPEED


@pytest.mark.parametrize(("direction", "inner"), [("left", "rear_left"), ("right", "front_right")])
def test_the_lift_of_an_inner_wheel_ends_the_contact_and_that_of_an_outer_one_does_not(
    direction, inner
):
    t = times()
    outer = inner.replace("left", "x").replace("right", "left").replace("x", "right")
    rate = {"gyro_z_truth_rad_per_s": 5.0 * (t - 2.0) * (1.0 if direction == "left" else -1.0)}
    lifted = {f"wheel_force_{inner}_z_truth_n": np.where(t >= 2.3, 0.0, 15.0)}
    other = {f"wheel_force_{outer}_z_truth_n": np.where(t >= 2.1, 0.0, 15.0)}
    found = measured({**rate, **lifted, **other}, direction).lift_yaw_rate_rad_per_s
    assert found == pytest.approx(1.5, abs=5.0 * STEP)
    found = measured({**rate, **other}, direction).lift_yaw_rate_rad_per_s
    assert found == pytest.approx(5.0 * (TURN[1] - TURN[0]), abs=5.0 * STEP)


def test_without_truth_the_sensors_are_used_and_the_result_says_so():
    """A gyro bias of 0.05 rad/s would add 0.2 rad to the integral over 4 s; the straight driving
    before shows it.
    """
    sensed = {
        "imu_gyro_z_rad_per_s": pulse(),
        "imu_acceleration_y_m_per_s2": 4.0,
        "imu_gyro_x_rad_per_s": doublet(1.2) + 0.05,
        "imu_roll_rad": ramp(0.3),
        "imu_yaw_rad": np.mod(ramp(0.8) + 3.0 + np.pi, 2.0 * np.pi) - np.pi,
        "tail_roll_torque_n_m": pulse(5.0),
        "tail_roll_rate_rad_per_s": 2.0,
    }
    metrics = measured(sensed, truth=False)
    assert metrics.source == "sensors"
    assert metrics.raw.max_yaw_rate_rad_per_s == pytest.approx(PEAK, rel=1e-5)
    assert metrics.raw.average_linear_acceleration_m_per_s2 == pytest.approx(4.0)
    assert metrics.raw.roll_integral_rad == pytest.approx(0.3, abs=1.2 * STEP)
    assert metrics.raw.speed_m_per_s == SPEED
    assert metrics.heading_change_rad == pytest.approx(0.8)
    assert metrics.outcome.max_tilt_rad == pytest.approx(0.3)
    assert metrics.tail_energy_j == pytest.approx(2.0 * 5.0 * 0.64 * 2.0 / math.pi, rel=1e-4)
    assert (metrics.two_wheel_time_s, metrics.outcome.clean) == (None, None)
    assert metrics.lift_yaw_rate_rad_per_s is None


def test_the_turn_of_the_auto_sequence_starts_at_the_first_steering_command():
    t = times()
    run = made_up_run(
        {
            "steering_command_rad": np.where((t >= 2.5) & (t < 3.0), math.radians(30.0), 0.0),
            "gyro_z_truth_rad_per_s": pulse(start=2.5),
        },
        kind="auto_turn",
    )
    assert turn_signals(run).window == pytest.approx((2.5, 3.14))
    assert metrics_of(run).raw.average_yaw_rate_rad_per_s == pytest.approx(
        PEAK * 2.0 / math.pi, rel=1e-5
    )
    assert_refused(lambda: measured(kind="auto_turn"), LogError, "steering")


def test_a_straight_run_is_measured_over_all_of_it():
    assert turn_signals(made_up_run(kind="straight")).window == pytest.approx((2.0, 4.0))
    assert turn_signals(
        made_up_run(kind="slalom", turn_start=9.0, direction="right")
    ).window == pytest.approx((0.0, 4.0))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"gyro_z_truth_rad_per_s": np.where(times() == times()[1000], np.nan, 0.0)},
            ["yaw_rate", "nan", "2 s"],
        ),
        ({"tail_power_truth_w": np.nan}, ["tail motor power", "nan"]),
        ({"time_s": times()[::-1].copy()}, ["time_s", "row 2"]),
        ({"time_s": times() + (times() > 3.0) * 0.5}, ["1 gap", "3 s"]),
        ({"time_s": 0.5 * times()}, ["0 to 2 s", "2 to 2.64 s"]),
    ],
    ids=["NaN", "NaN power", "unsorted", "gap", "too short"],
)
def test_what_is_wrong_with_a_log_is_named(change, named):
    assert_refused(lambda: measured(change), LogError, *named)


@pytest.mark.parametrize("servo", [{}, {"rate": 0.0}, {"rate": -1.0}])
def test_a_servo_without_a_rate_is_named(servo):
    run = made_up_run()
    run = replace(run, scenario={**run.scenario, "servo": servo})
    assert_refused(lambda: metrics_of(run), LogError, "servo.rate")


@pytest.mark.parametrize("key", ["steer_angle", "turn_start", "turn_hold"])
@pytest.mark.parametrize("value", ["x", None, [1.0], math.nan])
def test_a_scenario_value_that_is_no_number_is_named(key, value):
    run = made_up_run(**{key: value})
    assert_refused(lambda: metrics_of(run), LogError, f"manoeuvre.{key}", repr(value))


def degrees(*corners):
    """A tilt history (rad) through these angles, evenly spaced over the run."""
    return np.radians(np.interp(times(), np.linspace(0.0, times()[-1], len(corners)), corners))


LOADED = np.full((times().size, 4), 15.0)
LIFTED = np.where(np.arange(4) < 2, 0.0, LOADED)


@pytest.mark.parametrize(
    ("tilt", "loads", "result"),
    [
        (degrees(0, 5, 0), LOADED, "survived"),
        (degrees(0, 74.9, 0), LOADED, "survived"),
        (degrees(0, 75.1, 0), LOADED, "flipped"),
        (degrees(0, 180), LIFTED, "flipped"),
        (degrees(0, 20.1), LIFTED, "flipped"),
        (degrees(0, 19.9), LIFTED, "survived"),
        (degrees(0, 20.1), LOADED, "survived"),
        (degrees(0, 20.1), None, "flipped"),
        (degrees(0, 19.9), None, "survived"),
    ],
)
def test_outcome_of_made_up_tilt_histories(tilt, loads, result):
    assert outcome_from(times(), tilt, loads).result == result


def test_a_small_roof_load_is_no_loaded_wheel():
    three = LOADED.copy()
    three[-1, 2] = 0.05
    assert outcome_from(times(), degrees(0, 21), three).end_wheels_loaded == 3
    assert outcome_from(times(), degrees(0, 21), three).result == "flipped"


@pytest.mark.parametrize(("part", "number"), [("cage", 0), ("board", 1), ("tail", 2)])
def test_clean_means_survived_without_touching_the_ground(part, number):
    nothing = np.zeros((times().size, 3))
    touching = nothing.copy()
    touching[700, number] = 3.0
    assert outcome_from(times(), degrees(0, 5), LOADED, nothing).clean is True
    hit = outcome_from(times(), degrees(0, 5), LOADED, touching)
    assert (hit.result, hit.clean, hit.touched) == ("survived", False, (part,))
    assert outcome_from(times(), degrees(0, 90), LOADED, nothing).clean is False


def test_board_may_carry_the_car_before_the_turn_and_not_in_it():
    """The anti-ramp board is there for the start; cage and tail are not."""
    time = times()
    touching = np.zeros((times().size, 3))
    early = (time >= 0.5) & (time < 0.75)
    touching[early, 1] = 50.0
    started = outcome_from(time, degrees(0, 5), LOADED, touching, turn_start=2.0)
    assert (started.clean, started.touched) == (True, ())
    assert started.board_before_turn_s == pytest.approx(0.25, abs=1e-9)
    touching[time.searchsorted(2.0), 1] = 50.0
    turning = outcome_from(time, degrees(0, 5), LOADED, touching, turn_start=2.0)
    assert (turning.clean, turning.touched) == (False, ("board",))
    assert turning.board_before_turn_s == started.board_before_turn_s
    touching[early] = [0.0, 0.0, 1.0]
    assert outcome_from(time, degrees(0, 5), LOADED, touching, turn_start=2.0).touched == (
        "board",
        "tail",
    )


def test_outcome_reads_the_log():
    outcome = outcome_of(
        made_up_run({"tilt_truth_rad": degrees(0, 30), "ground_contact_board_truth_n": 2.0})
    )
    assert (outcome.result, outcome.clean, outcome.touched, outcome.end_wheels_loaded) == (
        "survived", False, ("board",), 4,
    )  # fmt: skip
    assert outcome.board_before_turn_s == pytest.approx(TURN[0])
    assert outcome.end_tilt_rad == pytest.approx(math.radians(30.0))


def test_filtered_metrics_are_the_sensors_and_raw_ones_the_truth():
    """Published tables of the real car are from its IMU and GPS; those of the simulated one from an
    ideal IMU.
    """
    run = made_up_run(
        {**turning(1.0), "imu_gyro_z_rad_per_s": 3.0 * pulse(), "speed_m_per_s": 1.1 * SPEED}
    )
    metrics = metrics_of(run)
    honest = measured(turning(1.0))
    assert metrics.like("simulated") == metrics.raw == honest.raw
    assert metrics.like("physical") == metrics.filtered
    assert metrics.filtered.max_yaw_rate_rad_per_s == pytest.approx(
        3.0 * honest.filtered.max_yaw_rate_rad_per_s
    )
    assert metrics.filtered.speed_m_per_s == pytest.approx(1.1 * SPEED)
