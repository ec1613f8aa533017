"""Files that earlier versions wrote are read as they were meant; the README in their folder says
how they were made.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from aerodima.optimisation import (
    fit_added_mass_log,
    fit_friction_log,
    fit_robot_tail_log,
    fit_static_log,
    load_study,
)
from aerodima.workbench import (
    UserError,
    load_coefficients,
    load_ensemble,
    load_rig_scenario,
    load_scenario,
    read_run_log,
)
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.scenario.swing_file import read_swing, swing_at, swing_from_dict
from tests.commands import refused
from tests.refusals import assert_refused

FOLDER = Path(__file__).resolve().parent / "data" / "old_files" / "d80c6d9"
LOGS = ("turn", "hold", "flick", "bar", "robot")
FITS = {
    "static": (fit_static_log, "hold"),
    "friction": (fit_friction_log, "bar"),
    "added_mass": (fit_added_mass_log, "flick"),
    "robot": (partial(fit_robot_tail_log, shape="bins"), "robot"),
}


def values(name):
    """What the version that wrote a file read from it."""
    return json.loads((FOLDER / "values.json").read_text(encoding="utf-8"))[name]


@pytest.mark.parametrize("name", LOGS)
def test_log_has_its_rows_columns_and_last_values(name):
    table = read_run_log(FOLDER / f"{name}.parquet").table
    was = values(f"{name}.parquet")
    assert table.shape == (was["rows"], was["columns"])
    assert {column: table[column].iloc[-1] for column in was["last"]} == was["last"]


def test_outcome_of_an_old_run_is_that_of_its_day():
    outcome = outcome_of(read_run_log(FOLDER / "turn.parquet"))
    was = values("turn.parquet")["outcome"]
    assert (outcome.result, outcome.clean, list(outcome.touched)) == (
        was["result"],
        was["clean"],
        was["touched"],
    )
    assert outcome.max_tilt_rad == pytest.approx(was["max_tilt_rad"], rel=1e-12)


def test_old_run_can_be_made_again():
    """Its scenario is one of today, with the numbers that it had."""
    from aerodima.workbench.scenario.scenario import scenario_from_dict

    was = read_run_log(FOLDER / "turn.parquet").scenario
    scenario = scenario_from_dict(was).resolved()
    pairs = [
        (section, key, scenario[section][key], value)
        for section, keys in was.items()
        if isinstance(keys, dict)
        for key, value in keys.items()
        if key in (scenario.get(section) or ())
    ]
    assert len(pairs) > 120
    assert [pair for pair in pairs if pair[2] != pair[3]] == []


def test_scenario_files_give_the_numbers_that_they_name():
    turn = load_scenario(FOLDER / "turn.yaml")
    hold = load_rig_scenario(FOLDER / "hold.yaml")
    assert (turn.car.com_height, turn.tail.sail, turn.wind.mean_y, turn.seed) == (
        0.21,
        "free",
        2.0,
        7,
    )
    assert (hold.experiment.tail, hold.experiment.wind_speed, hold.maxon.torque_constant) == (
        2,
        12.0,
        0.40,
    )


def test_exported_bundle_drives():
    from aerodima.workbench.control.controller_bundle import load_drive

    scenario, law = load_drive(str(FOLDER / "bundle.json"))
    assert (scenario.name, scenario.manoeuvre.direction) == ("a turn of our own", "right")
    assert law.rate == scenario.controller.rate


def test_swing_with_feedback_is_refused_and_plays_what_it_played_without():
    path = FOLDER / "swing.yaml"
    assert_refused(lambda: read_swing(path), UserError, str(path), "gains.feedback")
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    was = values("swing.yaml")
    del data["gains"]["feedback"]
    swing = swing_from_dict(data)
    assert (swing.name, swing.trigger.threshold_rad_per_s) == (was["name"], was["threshold"])
    assert swing_at(swing, 0.62).roll_position == pytest.approx(was["roll_at_0.62_s"], abs=1e-12)


def test_ensemble_has_its_members():
    ensemble = load_ensemble(FOLDER / "ensemble.yaml")
    was = values("ensemble.yaml")
    assert (ensemble.name, len(ensemble.members), ensemble.best.name) == (
        was["name"],
        was["members"],
        was["best"],
    )
    assert ensemble.effective_size == pytest.approx(was["effective_size"])
    assert ensemble.members[0].weight == pytest.approx(was["first"]["weight"])
    assert ensemble.members[0].values == was["first"]["values"]
    car = ensemble.scenario(ensemble.members[0], "turn_none").car
    assert car.com_height == was["first"]["values"]["car.com_height"]


def test_coefficients_give_the_same_force():
    found = load_coefficients(FOLDER / "robot_tail_bins.yaml")
    was = values("robot_tail_bins.yaml")
    assert (found.name, found.kind) == (was["name"], was["kind"])
    force = found.law().section_force(
        v=(0.0, 6.0, 0.0), a=(0.0, 0.0, 1.0), n=(0.0, 1.0, 0.0), area=0.1, density=1.2
    )
    assert force[1] == pytest.approx(was["force_y_n"], rel=1e-12)


def test_study_file_plans_the_runs_that_its_table_has():
    from aerodima.optimisation.studies.run_study import read_table
    from aerodima.optimisation.studies.study import plan_runs

    runs = plan_runs(load_study(FOLDER / "study.yaml"))
    table = read_table(FOLDER / "study")
    assert [run.task.name for run in runs] == list(table["run"])
    for factor in ("manoeuvre.speed", "car.tyre_friction", "car.mass"):
        # NaN where a block has no such factor
        planned = np.array([run.place[factor] for run in runs], float)
        assert np.allclose(planned, table[factor], equal_nan=True, rtol=1e-9)


def test_table_of_a_study_is_that_of_its_csv():
    from aerodima.optimisation.studies.run_study import read_table

    table = read_table(FOLDER / "study")
    text = pd.read_csv(FOLDER / "study" / "table.csv")
    assert list(table.columns) == list(text.columns)
    assert np.allclose(table["peak_roll_rad"].astype(float), text["peak_roll_rad"])
    assert list(table["outcome"]) == list(text["outcome"])


@pytest.mark.slow
def test_a_study_goes_on_in_no_folder_of_an_earlier_version():
    """Its rows were made by other versions: the folder is refused by name, and nothing in it is
    touched.
    """
    before = {path: path.read_bytes() for path in (FOLDER / "study").iterdir()}
    words = (FOLDER / "study.yaml", "--out", FOLDER / "study", "--workers", 1)
    assert "--force" in refused("sweep", "run", *words)
    assert {path: path.read_bytes() for path in (FOLDER / "study").iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize("name", FITS)
def test_fit_of_an_old_log_is_the_one_of_its_day(name):
    fit, log = FITS[name]
    report = yaml.safe_load((FOLDER / f"fit_{name}.yaml").read_text(encoding="utf-8"))
    (was,) = report["fits"]
    found = fit(str(FOLDER / f"{log}.parquet"))
    assert report["schema"] == "aerodima/fit-report/1"
    for estimate in was["estimates"]:
        # A solver of another build ends elsewhere within its tolerance, far inside the interval.
        width = estimate["upper"] - estimate["lower"]
        assert found[estimate["name"]].value == pytest.approx(
            estimate["value"], abs=max(1e-3 * width, 1e-9)
        )
        assert found[estimate["name"]].unit == estimate["unit"]
