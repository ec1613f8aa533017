"""Signals of runs on a page: which, with what unit, and that thinning them out loses no peak."""

import base64
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.scenario.signal_table import sensor_columns, truth_columns
from aerodima.workbench.view.run_channels import MAX_POINTS, channels_of, thinned
from tests.workbench.made_up_runs import changed


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


def longer(run, times):
    """The run as if logged so many times as fast, each sample held."""
    table = run.table.loc[run.table.index.repeat(times)].reset_index(drop=True)
    return replace(
        run, table=table.assign(time_s=np.linspace(run.time[0], run.time[-1], len(table)))
    )


def test_every_channel_has_unit_and_meaning_of_the_column_table(tailed):
    table = {column.name: column for column in [*sensor_columns(), *truth_columns()]}
    found = {channel["name"]: channel for channel in channels_of([tailed], ["run"])["channels"]}
    assert len(found) > 80
    for name, channel in found.items():
        assert (channel["unit"], channel["meaning"]) == (table[name].unit, table[name].meaning)
    assert not any(name.startswith(("plant_", "time_s")) for name in found)


def test_short_run_is_embedded_whole(tailed):
    data = channels_of([tailed], ["run"])
    (gyro,) = [channel for channel in data["channels"] if channel["name"] == "imu_gyro_z_rad_per_s"]
    assert_allclose(unpacked(data["runs"][0]["time"]), tailed.time, rtol=1e-6)
    assert_allclose(unpacked(gyro["values"][0]), tailed.signal("imu_gyro_z_rad_per_s"), rtol=1e-6)


def test_long_run_keeps_its_peaks_and_times_in_order(tailed):
    run = longer(tailed, 40)
    spike = run.table["speed_m_per_s"].to_numpy().copy()
    spike[7001] = 99.0
    run = changed(run, speed_m_per_s=spike)
    data = channels_of([run], ["run"])
    time = unpacked(data["runs"][0]["time"])
    (speed,) = [channel for channel in data["channels"] if channel["name"] == "speed_m_per_s"]
    values = unpacked(speed["values"][0])
    assert MAX_POINTS / 2 < values.size == time.size <= MAX_POINTS
    assert np.all(np.diff(time) > 0.0)
    assert time[-1] == pytest.approx(run.time[-1])
    assert values.max() == 99.0
    stretch = 2.0 * (run.time[-1] - run.time[0]) / time.size
    assert time[np.argmax(values)] == pytest.approx(run.time[7001], abs=1.1 * stretch)


@pytest.mark.parametrize("count", [5, 10, 11, 12, 101, 1000])
def test_thinning_keeps_extremes_and_order_for_any_length(count):
    values = np.random.default_rng(count).normal(size=count)
    thin = thinned(values, 10)
    assert thin.size <= 10
    assert (thin.min(), thin.max()) == (values.min(), values.max())
    places = [int(np.flatnonzero(values == value)[0]) for value in thin]
    assert places == sorted(places)


def test_gap_stays_a_gap():
    values = np.arange(1000.0)
    values[500:600] = np.nan
    assert np.count_nonzero(np.isnan(thinned(values, 100))) == pytest.approx(10, abs=2)


def test_constant_is_one_number_and_what_is_unknown_is_left_out(tailless):
    run = changed(tailless, status_imu_fault=0.0, roll_estimate_rad=np.nan)
    data = channels_of([run], ["run"])
    found = {channel["name"]: channel["values"][0] for channel in data["channels"]}
    assert found["status_imu_fault"] == 0.0
    assert "roll_estimate_rad" not in found
    assert not any(name.startswith("tail_") for name in found), "a car without a tail"


@pytest.mark.parametrize(
    ("name", "unit"),
    [("spring_force_n", "N"), ("pump_rad_per_s", "rad/s"), ("knob", ""), ("hip_torque_n_m", "N m")],
)
def test_column_that_the_table_does_not_have_says_its_unit_itself(tailed, name, unit):
    data = channels_of([changed(tailed, **{name: tailed.time})], ["run"])
    assert data["channels"][-1]["name"] == name
    assert data["channels"][-1]["unit"] == unit


def test_runs_of_other_length_and_start_begin_at_zero(tailed, tailless):
    late = replace(tailed, table=tailed.table.assign(time_s=tailed.time + 5.0).iloc[:300:2])
    data = channels_of([late, tailless], ["late", "tailless"])
    starts = [unpacked(run["time"])[0] for run in data["runs"]]
    assert starts == [0.0, 0.0]
    assert data["span"] == pytest.approx([0.0, tailless.time[-1]])
