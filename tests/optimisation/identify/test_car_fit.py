"""A car from the log of its own drive: what is refused, what is used, and whether the truth lies in
the intervals.
"""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.identify.car_fit import fit_car, prior_range, unknowns
from aerodima.optimisation.identify.car_log import TAIL, CarDrive, LoggedCommands, car_drive
from aerodima.optimisation.identify.fit_report import format_estimate, write_report
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import RunLog, write_run_log
from aerodima.workbench.scenario.scenario import load_scenario
from tests.commands import call
from tests.optimisation.coverage import assert_held
from tests.optimisation.identify.car_truth import drawn, emulated
from tests.refusals import assert_named, assert_refused

SINGLE_TRACK = Path(__file__).parents[2] / "data/single_track"


def still_log(steered=0.5, **columns):
    """A log without motion of the first 4 s of `turn_none`, steered from 2.0 to 2.5 s."""
    scenario = load_scenario("turn_none")
    time = np.arange(0.0, 4.0, 0.002)
    steering = steered * ((time >= 2.0) & (time < 2.5))
    table = pd.DataFrame({"time_s": time, "steering_command_rad": steering})
    zeros = ["planned_turn", "imu_roll_rad", "imu_pitch_rad", "imu_acceleration_y_m_per_s2"]
    table[[*zeros, "imu_gyro_x_rad_per_s", "imu_gyro_z_rad_per_s"]] = 0.0
    table = table.assign(**{"throttle_command": 0.35, "speed_m_per_s": 3.3, **columns})
    for source, rate in (("imu", 100.0), ("speed", 10.0)):
        table[f"status_{source}_age_s"] = time - np.floor(time * rate + 1e-6) / rate
    return RunLog(table, scenario.resolved(), 1, source="run.parquet")


def changed(**columns):
    log = still_log()
    return replace(log, table=log.table.assign(**columns))


def gyro_with_nan(table):
    return np.where(table.time_s == table.time_s[1100], math.nan, 0.0)


def nameless_gyro():
    log = still_log()
    return replace(log, table=log.table.rename(columns={"imu_gyro_z_rad_per_s": "x"}))


def speed_with_nan():
    """And without the throttle, which is then that of the speed."""
    log = changed(speed_m_per_s=gyro_with_nan)
    return replace(log, table=log.table.drop(columns="throttle_command"))


def cut():
    return replace(still_log(), table=still_log().table.query("time_s > 1.9 and time_s < 2.1"))


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: replace(still_log(), kind="swing"), ("swing",)),
        (lambda: still_log(0.0), ("steering_command_rad", "0.01 rad")),
        (lambda: changed(imu_gyro_z_rad_per_s=gyro_with_nan), ("imu_gyro_z_rad_per_s", "2.2 s")),
        (nameless_gyro, ("imu_gyro_z_rad_per_s",)),
        (speed_with_nan, ("speed_m_per_s", "2.2 s")),
        (
            lambda: changed(status_speed_age_s=lambda table: table.time_s % 1.0),
            ("speed_m_per_s", "2", "5"),
        ),
        (lambda: still_log(throttle_command=0.0), ("throttle_command", "0 m/s")),
        (cut, ("1.9", "2.098 s", "2 s", "0.5 s")),
    ],
)
def test_a_log_that_cannot_be_fitted_is_refused(make, named):
    assert_refused(lambda: car_drive(make()), UserError, "run.parquet", *named)


def test_of_a_flipped_run_what_is_before_the_flip_is_used():
    drive = car_drive(changed(imu_roll_rad=lambda table: np.where(table.time_s < 2.4, 0.0, 1.2)))
    (warning,) = drive.warnings
    assert "2.4 s" in warning
    assert max(channel.time[-1] for channel in drive.channels.values()) <= 2.4


def test_all_samples_of_a_sensor_that_is_fresh_in_every_row_count():
    held = car_drive(still_log()).channels
    fresh = car_drive(changed(status_imu_age_s=0.0, status_speed_age_s=0.0))
    rows = held["yaw_rate"].time.size, held["speed"].time.size
    assert rows == pytest.approx((150, 15), abs=5)  # 100 and 10 Hz for 1.5 s
    for channel in fresh.channels.values():
        assert np.diff(channel.time) == pytest.approx(0.002)
        assert channel.time.size == pytest.approx(750, abs=25)


def test_a_gyro_of_the_other_sign_is_the_first_warning():
    turned = np.sin(2.0 * still_log().time)
    log = changed(imu_yaw_rad=turned, imu_gyro_z_rad_per_s=-np.gradient(turned, 0.002))
    assert "imu_gyro_z_rad_per_s" in car_drive(log).warnings[0]


@pytest.mark.parametrize(("stop", "cut"), [(math.pi / 2, True), (3.1416, False)])
def test_a_swung_log_ends_at_the_stop_of_the_tail_not_at_the_limit_of_its_command(stop, cut):
    log = still_log()
    scenario = load_scenario("turn_swing", [f"tail.roll_stop={stop}"])
    angle = np.interp(log.table["time_s"], [2.0, 2.3], [-math.pi / 2, math.pi / 2])
    columns = dict.fromkeys([*TAIL["pitch"], *TAIL["roll"]], 0.0)
    table = log.table.assign(**columns, tail_roll_angle_rad=angle)
    found = car_drive(replace(log, table=table, scenario=scenario.resolved()))
    assert bool(found.warnings) == cut
    last = max(channel.time[-1] for channel in found.channels.values())
    assert (last <= 2.3) == cut


def test_commands_are_held_and_steering_alone_is_late():
    time = np.array([1.0, 1.1, 1.2])
    driver = np.array([[0.0, 0.3, 0.0], [0.1, 0.2, 0.3], [1.0, 1.0, 1.0]])
    commands = LoggedCommands(time, driver, np.zeros((2, 3, 5)), 100.0, begin=1.0, latency=0.05)
    assert commands.at(0.12) == (0.0, 0.2, 1.0)
    assert commands.at(0.15) == (0.3, 0.2, 1.0)


def single_track(name, speed):
    """The log of a F1TENTH that another program simulated."""
    table = pd.read_csv(SINGLE_TRACK / f"{name}.csv")
    car = load_scenario("f1tenth", [f"manoeuvre.speed={speed}"]).resolved()
    return RunLog(table, car, 1, kind="car_log", source="single_track.parquet")


def test_a_log_of_speed_steering_yaw_rate_and_acceleration_alone_is_driven_at_its_speed():
    drive = car_drive(single_track("gentle", 3.0))
    assert set(drive.channels) == {"yaw_rate", "lateral_acceleration", "speed"}
    assert drive.scenario.drive.governor
    assert drive.line_speed == pytest.approx(3.0)
    names = {*unknowns(drive).names}
    assert names & {"tyre_friction", "com_height", "gyro_bias_x"} == {"tyre_friction"}
    named = ("throttle_command", "imu_roll_rad", "imu_gyro_x_rad_per_s")
    assert_named("; ".join(drive.warnings), named)


def test_a_small_car_has_the_prior_of_a_large_one_in_proportion():
    small = load_scenario("f1tenth").car
    low, high = prior_range("com_height", small)
    assert low < small.com_height < high < 0.12  # where the range of the large car begins
    assert prior_range("tyre_friction", small) == (0.35, 1.2)


class Formula(CarDrive):
    """A drive whose car is a formula in place of a simulation, as rough as one; its height shows
    nowhere, and its step acts as so much friction per 2 ms.
    """

    per_step = 0.0

    def run(self, car, begin, driven, latency, step):
        time = np.arange(1.4, 3.2, 0.002)
        slip = car["tyre_slip_angle"]
        friction = car["tyre_friction"] + self.per_step * step / 0.002
        late = time - self.turn - latency
        turning = np.clip(late / 0.2, 0.0, 1.0)
        begins = np.exp(-np.square((late - 0.2) / 0.1))
        rough = 2e-4 * np.sign(math.sin(2e5 * friction)) * turning
        gain = 1.0 - math.exp(-3.0 * (time[-1] - time[0]))
        return {
            "time": time,
            "yaw_rate": 3.0 * friction * turning - 2.0 * slip * begins + rough,
            "roll_rate": 5.0 * slip * begins + rough,
            "lateral_acceleration": 7.0 * friction * turning + rough,
            "speed": begin + gain * (driven - begin) * (time > self.turn),
        }


class Stepped(Formula):
    per_step = 0.02


class Gentle(Formula):
    def run(self, *arguments):
        motion = super().run(*arguments)
        return {**motion, "lateral_acceleration": 0.5 * motion["lateral_acceleration"]}


TRUTH = {"tyre_friction": 0.61, "tyre_slip_angle": 0.12}


@cache
def fit_of_formula(kind, noise, delay=0.03):
    """Of a log of a formula without steps, with noise in units of what its sensors have."""
    base = car_drive(still_log())
    drive = kind(**vars(base))
    sampled = drive.sampled(drive.run(TRUTH, 3.0, 3.2, 0.0, 0.0), delay)
    rng = np.random.default_rng(5)
    channels = {}
    for name, channel in drive.channels.items():
        error = noise * channel.deviation * rng.normal(size=channel.value.size)
        channels[name] = replace(channel, value=sampled[name] + error)
    return fit_car(replace(drive, channels=channels))


def test_a_rough_cost_settles_and_what_the_log_does_not_show_is_named():
    found = fit_of_formula(Formula, 0.3)
    assert found.success, found.status
    (warning,) = found.warnings
    assert "com_height" in warning
    assert all(found[name].holds(value) for name, value in (TRUTH | {"delay": 0.03}).items())
    assert found["com_height"].upper - found["com_height"].lower > 0.2
    assert found.attempts[0]["start"]["delay"] in np.arange(0.0, 0.1501, 0.005)  # those tried first


def test_a_channel_with_three_times_the_noise_weighs_and_widens_by_three():
    found = fit_of_formula(Formula, 3.0)
    misfits = [value for name, value in found.facts.items() if name.startswith("misfit_")]
    assert len(misfits) == 4
    # The few samples of the GPS know their scatter to a quarter.
    assert misfits == pytest.approx([3.0] * 4, rel=0.6)
    narrow = fit_of_formula(Formula, 1.0)["tyre_friction"].standard_deviation
    assert found["tyre_friction"].standard_deviation == pytest.approx(3.0 * narrow, rel=0.3)


def test_what_the_step_of_the_plant_does_is_taken_off_and_in_the_interval():
    """Half a step acts as 0.01 of friction, of which half is the standard deviation."""
    friction = fit_of_formula(Stepped, 0.3)["tyre_friction"]
    assert friction.value == pytest.approx(0.61, abs=0.007)
    assert friction.standard_deviation == pytest.approx(0.005, rel=0.3)


def test_friction_is_a_lower_bound_where_the_tyres_use_little_of_it():
    """7 and 3.5 m/s2 per friction are 0.71 and 0.36 of it; the limit is 0.6."""
    hard = fit_of_formula(Formula, 0.3)
    assert hard.facts["friction_used"] == pytest.approx(7.0 / 9.81, abs=0.006)
    assert math.isfinite(hard["tyre_friction"].upper)
    gentle = fit_of_formula(Gentle, 0.3)
    assert gentle.facts["friction_used"] == pytest.approx(3.5 / 9.81, abs=0.006)
    friction = gentle["tyre_friction"]
    assert friction.lower == pytest.approx(0.61, abs=0.05)
    assert friction.upper == math.inf
    assert format_estimate(friction).endswith(" .. inf)")
    (warning,) = [text for text in gentle.warnings if "lower bound" in text]
    assert_named(warning, ["tyre_friction", "0.36", "0.6"])


def test_a_delay_is_not_below_zero_and_stopping_there_is_a_warning():
    found = fit_of_formula(Formula, 0.3, delay=-0.02)
    assert found["delay"].value == 0.0
    assert found["delay"].bound == "lower"
    assert any("delay" in warning for warning in found.warnings)


def test_the_report_draws_log_and_model_of_every_channel(tmp_path):
    found = fit_of_formula(Formula, 0.3)
    assert set(found.curves) == {"yaw_rate", "roll_rate", "lateral_acceleration", "speed"}
    curve = found.curves["yaw_rate"]
    assert curve["labels"][1] == "yaw rate, rad/s"
    assert curve["model"] == pytest.approx(curve["measured"], abs=0.1)
    assert tmp_path / "curves.png" in write_report(tmp_path, "Cars", [found])


UNKNOWNS = ("tyre_friction", "tyre_slip_angle", "com_height", "delay", "gyro_bias_z")


@pytest.mark.slow
def test_the_truth_of_a_drive_lies_in_the_intervals():
    truth = drawn(4)
    found = fit_car(car_drive(emulated(truth)))
    assert found.success
    assert [name for name in UNKNOWNS if not found[name].holds(truth.values[name])] == []
    assert found["tyre_friction"].upper - found["tyre_friction"].lower < 0.03
    assert not found.warnings


@pytest.mark.slow
@pytest.mark.nightly
def test_turns_of_another_program_show_its_tyres():
    """Of a gentle turn the stiffness, to 10 %: its axles differ by 15 % and ours do not, and our
    tyres are not straight up to a quarter of their friction. Of a hard one the friction, to 5 %:
    its tyres have a peak, which ours approach.
    """
    gentle = fit_car(car_drive(single_track("gentle", 3.0)))
    slope = gentle["tyre_friction"].value / math.tan(gentle["tyre_slip_angle"].value)
    assert slope == pytest.approx(1.0489 * (4.718 + 5.4562) / 2.0, rel=0.1)
    assert gentle["tyre_friction"].holds(1.0489)
    assert gentle["tyre_slip_angle"].holds(math.atan(2.0 / (4.718 + 5.4562)))
    hard = fit_car(car_drive(single_track("hard", 4.0)))
    assert hard["tyre_friction"].value == pytest.approx(1.0489, rel=0.05)


@pytest.mark.slow
@pytest.mark.nightly
def test_intervals_of_drives_hold_the_truth():
    truths = [drawn(number) for number in range(12)]
    fits = [fit_car(car_drive(emulated(truth))) for truth in truths]
    for name in UNKNOWNS:
        pairs = zip(fits, truths, strict=True)
        assert_held([found[name].holds(truth.values[name]) for found, truth in pairs])


@pytest.mark.parametrize(
    ("flags", "named"), [(("--set", "car.mas=6"), ("car.mas", "mass")), ((), ("other", "car_run"))]
)
def test_wrong_settings_and_logs_end_in_one_line(tmp_path, flags, named):
    log = write_run_log(replace(still_log(), kind="other"), tmp_path / "run.parquet")
    words = ("fit", "car", log, "--out", tmp_path / "fits", "--workers", 1, *flags)
    result = call(*words)
    assert result.exit_code == 2
    assert_named(result.stderr, named)
