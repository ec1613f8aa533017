"""`aerodima log compare`: two runs beside one another, on the terminal and as a page."""

from dataclasses import replace
from functools import partial

import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import write_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.view.replay_page import (
    comparison_page,
    different_cars,
    metrics_rows,
    scenario_differences,
)
from tests.commands import done
from tests.refusals import assert_refused


@pytest.fixture
def high(tailless):
    """The run as if the car had been higher."""
    car = {**tailless.scenario["car"], "com_height": 0.26}
    return replace(tailless, scenario={**tailless.scenario, "car": car})


def test_only_what_was_set_differently_is_listed(tailless, high):
    differences = scenario_differences([tailless, high])
    assert differences["car.com_height"][1] == 0.26
    assert set(differences) == {"car.com_height"}
    assert different_cars(differences) == ["car.com_height"]


def test_another_use_of_the_tail_is_not_another_car(tailless, tailed):
    differences = scenario_differences([tailless, tailed])
    assert differences["tail.mode"] == ["none", "swing"]
    assert different_cars(differences) == []


def test_command_prints_and_writes(tailless, high, refused, tmp_path):
    out = tmp_path / "page.html"
    other = write_run_log(high, tmp_path / "high.parquet")
    words = ("log", "compare", tailless.source, other, "--html", out)
    assert "car.com_height" in done(*words)
    assert out.stat().st_size > 1e6
    assert "--force" in refused(*words)


def test_log_without_sensors_is_refused_by_name(tailless, tailed):
    bare = replace(tailed, table=tailed.table[["time_s"]], source="bare.parquet")
    work = partial(comparison_page, [tailless, bare], ["none", "bare"])
    assert_refused(work, LogError, "bare.parquet")


def test_a_foreign_log_is_compared_by_what_both_have_and_the_rest_is_named(tailless, tmp_path):
    """Speed, steering, yaw rate and lateral acceleration, as many loggers have them."""
    lacking = ["imu_roll_rad", "imu_yaw_rad", "imu_pitch_rad", "imu_gyro_x_rad_per_s"]
    logged = ["speed_m_per_s", "imu_gyro_z_rad_per_s", "imu_acceleration_y_m_per_s2"]
    table = tailless.table[["time_s", "steering_command_rad", *logged]]
    path = write_run_log(replace(tailless, table=table, kind="car_log"), tmp_path / "f.parquet")
    whole = replace(tailless, table=tailless.table[[*table, *lacking]], kind="car_log")
    sensors = metrics_of(whole).as_row()
    words = ("log", "compare", path, tailless.source, "--html", tmp_path / "page.html")
    lines = {line.split()[0]: line.split("  ") for line in done(*words).splitlines() if line}
    cells = {name: [cell.strip() for cell in line if cell] for name, line in lines.items()}
    assert cells["not_logged"][1:] == [", ".join(lacking), "–"]
    assert cells["outcome"][1:] == ["unknown", "survived"]
    for name in ("max_yaw_rate_rad_per_s", "average_linear_acceleration_m_per_s2"):
        assert float(cells[name][1]) == pytest.approx(sensors[name], rel=1e-3)
    for name in ("max_tilt_rad", "peak_roll_rad", "roll_integral_rad", "heading_change_rad"):
        assert cells[name][1] == "–" != cells[name][2]
    assert "unknown" in done("log", "metrics", path)


def test_values_stay_with_their_run(tailless, tailed):
    rows = metrics_rows([tailless, tailed])
    swapped = metrics_rows([tailed, tailless])
    assert rows["peak_roll_rad"] == swapped["peak_roll_rad"][::-1]
    assert rows["peak_roll_rad"][0] != rows["peak_roll_rad"][1]
