"""The examples of `workbench/logs/README.md`, as they stand there."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from aerodima.workbench import logs
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from tests.commands import call, done
from tests.refusals import assert_named
from tests.workbench.logs.foreign_logs import (
    CAR_SPEED,
    GAP,
    GPS_LATE,
    RELEASED_AT,
    WRENCH,
    YAW_RATE,
    car_files,
    swing_readings,
    swing_truth,
    write_laboratory_csv,
)

README = (Path(logs.__file__).parent / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands(example):
    return [shlex.split(line)[1:] for line in blocks("bash")[example].splitlines()]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for block in blocks("yaml"):
        name = re.match(r"# file: (\S+)", block)
        assert name, block
        (tmp_path / name.group(1)).write_text(block, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_swing_of_the_readme_comes_out_as_it_was(folder):
    """Degrees, mA, N mm, turned signs, 500 Hz, a gap, drift and offsets: the truth is met within
    the noise left.
    """
    write_laboratory_csv(folder / "swing.csv", swing_readings())
    importing, conditioning = commands(0)
    notes = call(*importing).stderr
    assert_named(notes, (f"{GAP[0]:g} s", f"{GAP[1] - GAP[0]:.2g} s", "19", "Temp"))
    said = done(*conditioning)
    assert "19 rows" in said
    assert "force_x_n" in said
    run_log = read_run_log(folder / "swing.parquet")
    assert run_log.kind == "swing"
    assert run_log.extra["tail"] == "1"
    assert run_log.extra["wind_speed_m_per_s"] == pytest.approx(10.0)
    assert np.allclose(np.diff(run_log.time), 1 / 500.0)
    # The kinks at lift and release ring in a 20 Hz filter of order 6; the swing itself (0.64 Hz)
    # passes it.
    swinging = run_log.time > RELEASED_AT + 1.0
    truth = swing_truth(run_log.time)[swinging]
    away = np.abs(truth["time_s"].to_numpy() - np.mean(GAP)) > 0.2
    for name, noise in zip(WRENCH, [0.01, 0.01, 0.02, 5e-4, 5e-4, 5e-4], strict=True):
        error = (run_log.signal(name)[swinging] - truth[name].to_numpy())[away]
        # 20 of 250 Hz are left of the white noise. One rest of 2.9 s leaves a slope of sqrt(12 /
        # 1450) / 2.9 s of the noise, 0.03 per s, half of it noise of the mean; over up to 24.5 s
        # that is 0.8 of it, twice that at 2 sigma.
        assert np.sqrt(np.mean(error**2)) < 1.6 * noise, name
    (in_python,) = blocks("python")
    names = {}
    exec(in_python, names)  # the same log, drift from a rest before and one after the swing
    assert len(names["log"].extra["conditioning"]) == 3
    for name, noise in zip(names["forces"], [0.01, 0.02], strict=True):
        error = (names["log"].signal(name)[swinging] - truth[name].to_numpy())[away]
        # 0.28 of the noise passes the filter; the drift line adds about as much.
        assert np.sqrt(np.mean(error**2)) < 0.5 * noise, name
    # The gap is bridged by straight lines: the angle bends by at most pi/2 * 16.5/s2 * (0.04 s)2 /
    # 8 = 5e-3 rad there.
    assert np.max(np.abs(run_log.signal("angle_rad")[swinging] - truth["angle_rad"])) < 6e-3


def test_quaternion_and_time_in_two_columns_of_the_readme(folder):
    names, row = re.search(r"(secs,nsecs,qw.*)\n(.*)", README).groups()
    (folder / "imu.csv").write_text(f"{names}\n{row}\n{row.replace(',25', ',26')}\n")
    done(*commands(2)[0])
    run_log = read_run_log(folder / "ros.parquet")
    assert np.allclose(run_log.time, [0.0, 0.01], atol=5e-7)
    assert np.allclose(run_log.signal("imu_yaw_rad"), np.pi / 4, atol=1e-4)


@pytest.mark.slow
def test_run_of_the_car_of_the_readme_gives_its_metrics(folder):
    car_files(folder)
    importing, metrics, replay = commands(1)
    notes = call(*importing).stderr
    assert "speed_m_per_s" in notes
    assert "6 earlier rows" in notes
    assert "average_yaw_rate_rad_per_s" in done(*metrics)
    done(*replay)
    assert (folder / "car.html").stat().st_size > 1e6
    run_log = read_run_log(folder / "car.parquet")
    speed = run_log.signal("speed_m_per_s")
    changes = run_log.time[1:][np.diff(speed) != 0.0]
    # Rows start at the first after 55 ms: 60 ms.
    assert changes[0] == pytest.approx(0.1 + GPS_LATE - 0.055, abs=1e-6)
    assert np.allclose(np.diff(changes), 0.1, atol=1e-6), "a GPS sample is held for ten rows"
    measured = metrics_of(run_log)
    assert measured.direction == "left"
    assert measured.raw.average_yaw_rate_rad_per_s == pytest.approx(YAW_RATE, rel=0.02)
    assert measured.raw.max_linear_acceleration_m_per_s2 == pytest.approx(
        CAR_SPEED * YAW_RATE, rel=1e-9
    )
    assert measured.raw.speed_m_per_s == pytest.approx(CAR_SPEED)
    assert measured.heading_change_rad == pytest.approx(YAW_RATE * 0.64, abs=YAW_RATE / 100.0)
    assert measured.tail_energy_j is None, "the log has no tail"
