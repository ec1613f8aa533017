"""From a scenario to a run log: complete, repeatable, safe."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import default_build
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import sensor_columns, truth_columns
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import car_run_columns, signals_equal

SHORT = ["manoeuvre.duration=0.5"]


@pytest.fixture
def run(tmp_path):
    def make(*settings, name="run", scenario="turn_swing"):
        return simulate(load_scenario(scenario, [*SHORT, *settings]), tmp_path / f"{name}.parquet")

    return make


def test_log_has_every_column_in_order_and_one_row_per_step(standard_runs):
    for mode in ("held", "swing"):
        log = standard_runs[mode]
        names = list(log.table.columns)
        positions = [
            name.removeprefix("plant_position_")
            for name in names
            if name.startswith("plant_position_")
        ]
        assert len(positions) == len(set(positions)) > 15
        expected = [column.name for column in car_run_columns(positions)]
        assert names[: len(expected)] == expected
        assert all(name.startswith("plant_velocity_") for name in names[len(expected) :])
        assert_allclose(log.time, np.arange(2001) * 0.002, atol=1e-9)
        assert np.isfinite(log.table.to_numpy()).all()


def test_log_of_a_car_without_tail_leaves_out_the_truth_of_the_tail_only(standard_runs):
    names = set(standard_runs["none"].table.columns)
    missing = {column.name for column in [*sensor_columns(), *truth_columns()]} - names
    assert missing
    assert all(name.startswith("tail_") and "_truth_" in name for name in missing)


def test_log_says_what_was_run(standard_runs):
    for mode, log in standard_runs.items():
        assert scenario_from_dict(log.scenario) == load_scenario(
            f"turn_{mode}", ["manoeuvre.speed=3.33"]
        )
        assert (log.kind, log.seed) == ("car_run", 1)
        assert {"drake", "python", "numpy"} <= set(log.versions)
        arm = log.scenario["tail"]
        tail = 0.0 if mode == "none" else arm["mass"] + arm["hub_mass"] + 0.001
        assert log.extra["tail_mass_kg"] == pytest.approx(tail, abs=1e-9)
        assert log.extra["total_mass_kg"] == pytest.approx(
            log.scenario["car"]["mass"] + tail, rel=1e-8
        )


def test_repeated_run_is_equal_bit_for_bit(run):
    assert signals_equal(run(name="first"), run(name="second"))


def test_another_seed_changes_what_the_noisy_sensors_say_and_nothing_else(run):
    one = run(name="one")
    other = run("seed=2", name="other")
    changed = {
        name
        for name in one.table.columns
        if not np.array_equal(one.signal(name), other.signal(name))
    }
    assert {
        "imu_gyro_z_rad_per_s",
        "imu_acceleration_y_m_per_s2",
        "imu_roll_rad",
        "speed_m_per_s",
    } <= changed
    noisy = ("imu_", "roll_estimate", "roll_rate_estimate", "sail_", "speed_m_per_s")
    assert all(name.startswith(noisy) for name in changed)


def test_controller_and_driver_act_at_100_hz(standard_runs):
    log = standard_runs["swing"]
    held = [name for name in log.table.columns if "_command" in name] + [
        "planned_turn",
        "controller_state",
    ]
    changes = 0
    for name in held:
        rows = np.flatnonzero(np.diff(log.signal(name)))
        # The row of an instant shows what controllers do at it: a change at 10 ms is between rows 4
        # and 5.
        assert np.all(rows % 5 == 4), name
        changes += rows.size
    assert changes > 10
    states = {1.0, 3.0, 4.0}
    assert states <= set(log.signal("controller_state")[5:]) <= {*states, 2.0}


def test_sensors_hold_their_sample_at_their_own_rate(standard_runs):
    log = standard_runs["none"]
    imu_rows = np.flatnonzero(np.diff(log.signal("imu_gyro_y_rad_per_s")))
    # 100 Hz with a delay of 5 ms, seen at the 2 ms rows: 5 rows apart unless two samples are equal,
    # at the same phase.
    assert np.mean(np.diff(imu_rows) == 5) > 0.9
    assert len(set(imu_rows % 5)) == 1
    gps_rows = np.flatnonzero(np.diff(log.signal("speed_m_per_s")))
    assert np.all(np.diff(gps_rows) % 50 == 0)


def test_log_rate_thins_the_rows_only(run):
    full = run(name="full")
    thin = run("simulation.log_rate=100", name="thin")
    assert_allclose(thin.time, np.arange(51) * 0.01, atol=1e-9)
    for name in ("position_x_truth_m", "imu_gyro_z_rad_per_s", "wheel_force_rear_left_z_truth_n"):
        assert_array_equal(thin.signal(name), full.signal(name)[::5])


def test_step_of_the_scenario_is_that_of_the_plant(run):
    log = run("simulation.step=0.001", "simulation.log_rate=1000", scenario="turn_none")
    assert log.time.size == 501
    moved = np.flatnonzero(np.diff(log.signal("position_x_truth_m")) != 0.0)
    assert np.all(np.diff(moved) == 1)


def test_existing_log_is_refused_and_left_alone(run, tmp_path):
    first = run()
    content = (tmp_path / "run.parquet").read_bytes()
    assert_refused(lambda: run("seed=3"), LogError, "run.parquet", "--force")
    assert (tmp_path / "run.parquet").read_bytes() == content
    assert not journal_path(tmp_path / "run.parquet").exists()
    again = simulate(
        load_scenario("turn_swing", [*SHORT, "seed=3"]), tmp_path / "run.parquet", force=True
    )
    assert (first.seed, again.seed) == (1, 3)
    assert read_run_log(tmp_path / "run.parquet").seed == 3


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (["manoeuvre.speed=20"], ["manoeuvre.speed", "20 m/s", "14.4 m/s"]),
        (["car.mass=2"], ["car.mass", "2 kg"]),
        (["car.gyration_roll=0.4"], ["car.gyration_roll", "0.4 m", "0.158663 m"]),
    ],
)
def test_scenario_that_cannot_be_built_leaves_no_log(run, tmp_path, settings, named):
    assert_refused(lambda: run(*settings), UserError, *named)
    assert list(tmp_path.iterdir()) == []


def test_a_run_whose_driver_is_the_users_goes_on_to_its_end():
    """Nobody knows when it steers for the last time; the scenario's own is over after its turn."""
    scenario = load_scenario("turn_none", ["manoeuvre.speed=1.0"])
    short = simulate(scenario, record="outcome")
    whole = simulate(scenario, record="outcome", build=default_build(scenario))
    assert short.time[-1] < 3.0
    assert whole.time[-1] == pytest.approx(scenario.manoeuvre.duration)


def test_progress_is_told_ten_times_a_second(tmp_path):
    told = []
    simulate(load_scenario("turn_none", SHORT), progress=lambda *times: told.append(times))
    times = np.array([time for time, _ in told])
    assert {length for _, length in told} == {0.5}
    assert 5 <= len(told) <= 7
    assert_allclose(np.diff(times), 0.1, atol=0.01)
