"""`aerodima log compare`: two runs beside one another, on the terminal and as a page."""

from dataclasses import replace
from functools import partial

import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import write_run_log
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


def test_values_stay_with_their_run(tailless, tailed):
    rows = metrics_rows([tailless, tailed])
    swapped = metrics_rows([tailed, tailless])
    assert rows["peak_roll_rad"] == swapped["peak_roll_rad"][::-1]
    assert rows["peak_roll_rad"][0] != rows["peak_roll_rad"][1]
