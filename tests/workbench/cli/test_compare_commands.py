"""`aerodima log compare`: two runs beside one another, on the terminal and as a page."""

from dataclasses import replace
from functools import partial

import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.replay_page import (
    comparison_page,
    different_cars,
    metrics_rows,
    scenario_differences,
)
from tests.commands import done
from tests.refusals import assert_refused

SHORT = ("speed=1.0", "turn_start=0.2", "speed_ramp=0.1", "turn_hold=0.1", "duration=0.7")


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    settings = [f"manoeuvre.{setting}" for setting in SHORT]
    paths = {}
    for name, scenario, more in (
        ("none", "turn_none", []),
        ("held", "turn_held", []),
        ("high", "turn_none", ["car.com_height=0.26"]),
    ):
        paths[name] = folder / f"{name}.parquet"
        simulate(load_scenario(scenario, [*settings, *more]), paths[name])
    return paths


@pytest.fixture(scope="module")
def runs(logs):
    return {name: read_run_log(path) for name, path in logs.items()}


def test_only_what_was_set_differently_is_listed(runs):
    differences = scenario_differences([runs["none"], runs["high"]])
    assert differences["car.com_height"][1] == 0.26
    assert set(differences) == {"car.com_height"}
    assert different_cars(differences) == ["car.com_height"]


def test_another_use_of_the_tail_is_not_another_car(runs):
    differences = scenario_differences([runs["none"], runs["held"]])
    assert differences["tail.mode"] == ["none", "held"]
    assert different_cars(differences) == []


def test_command_prints_and_writes(logs, refused, tmp_path):
    out = tmp_path / "page.html"
    words = ("log", "compare", logs["none"], logs["high"], "--html", out)
    assert "car.com_height" in done(*words)
    assert out.stat().st_size > 1e6
    assert "--force" in refused(*words)


def test_log_without_sensors_is_refused_by_name(runs):
    bare = replace(runs["held"], table=runs["held"].table[["time_s"]], source="bare.parquet")
    work = partial(comparison_page, [runs["none"], bare], ["none", "bare"])
    assert_refused(work, LogError, "bare.parquet")


def test_values_stay_with_their_run(runs):
    rows = metrics_rows([runs["none"], runs["high"]])
    swapped = metrics_rows([runs["high"], runs["none"]])
    assert rows["peak_roll_rad"] == swapped["peak_roll_rad"][::-1]
    assert rows["peak_roll_rad"][0] != rows["peak_roll_rad"][1]
