"""Comparison of candidates: the climb of the steering on the full car, and the whole way from names
to a verified motion.
"""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml

from aerodima.optimisation import BoundEffort, SearchEffort, judge
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.candidate import swing_player, user_law
from aerodima.optimisation.swerve.reduced_swerves import ReducedSwerve, SteeringItem
from aerodima.optimisation.swerve.steering import STEERING_KEYS
from aerodima.optimisation.swerve.suite import FOLDED, ensemble_cases
from aerodima.optimisation.swing import full_runs
from aerodima.optimisation.swing.full_runs import (
    CLIMB_STEP,
    Descent,
    FullRun,
    confirm_best,
    drive_full,
)
from aerodima.workbench.car.swerve import aside
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import read_swing
from tests.code_measure import ROOT
from tests.commands import call, done
from tests.page_blocks import blocks

GUIDE = ROOT / "docs" / "howto" / "optimise.md"
LAW = '''"""A law that fails."""


class Broken:
    rate, memory_size = 100.0, 0

    def start(self):
        raise ZeroDivisionError("no law")

    def step(self, memory, observation):
        raise ZeroDivisionError("no law")
'''


def descent():
    (case,) = ensemble_cases("physical", "test", 1, "built", [1.2])
    result = {"score": 0.4, "steering": [0.1, 0.05, 0.02, 0.2, 0.4], "variant": 0}
    return Descent(FOLDED, case, 6.0, "aside-0.5", case.settings(), result, step=CLIMB_STEP)


@pytest.mark.parametrize(("limit", "expected"), [(1.26, 1.25), (0.78, 0.775), (0.2, None)])
def test_angles_are_scaled_to_where_the_swerve_just_counts(limit, expected):
    """The value grows with the share, up to a share at which the car tips."""
    one = descent()
    driven = 0
    while shares := one.next_shares():
        (share,) = shares
        driven += 1
        one.rows[share] = {"counts": share <= limit, "value": share}
    row = one.as_row()
    assert row["share"] == row["value"] == expected
    assert row["runs"] == driven <= 8
    settings = one.run(0.5).settings
    assert "manoeuvre.level_1=0.05" in settings
    assert "manoeuvre.level_1_end=0.2" in settings


def test_no_share_turns_wheels_beyond_the_limit_of_the_servo():
    one = descent()
    one.result = {**one.result, "steering": [0.4, 0.1, 0.02, 0.2, 0.4]}
    scenario = load_scenario("swerve", one.run(1.6).settings)
    assert scenario.manoeuvre.level_1 == pytest.approx(scenario.servo.limit)
    assert scenario.manoeuvre.level_3 == pytest.approx(0.02 * 1.6)


def test_a_driver_at_full_lock_is_driven_once_and_not_with_less():
    one = descent()
    control = ("rollover_control.gain=10.0",)
    one.candidate = replace(one.candidate, settings=(*one.candidate.settings, *control))
    one.result = {**one.result, "score": -1e4}
    assert one.next_shares() == [1.0], "what tips on the reduced car is driven, too"
    one.rows[1.0] = {"counts": True, "value": 0.4}
    assert one.next_shares() == []
    one.step = 0.0005
    one.rows[1.0] = {"counts": False, "value": 0.4}
    assert one.next_confirmations() == [1.0], "what counts is the step of the table"
    one.confirmed[1.0] = {"counts": True, "value": 0.38}
    assert one.next_confirmations() == []
    assert one.as_row()["value"] == 0.38
    one.confirmed[1.0] = {"counts": False, "value": 0.0}
    assert one.next_confirmations() == []
    assert one.as_row()["value"] is None


def test_the_best_run_is_driven_at_the_finer_step_with_angles_that_count_there():
    one = descent()
    one.step = 0.0005
    one.rows |= {1.1: {"counts": True, "value": 0.4}, 1.0: {"counts": True, "value": 0.5}}
    while shares := one.next_confirmations():
        (share,) = shares
        one.confirmed[share] = {"counts": share < 0.96, "value": share}
    row = one.as_row()
    assert list(one.confirmed) == [1.0, 0.9, 0.95, 0.975]
    assert (row["value"], row["share"], row["runs"]) == (0.95, 0.95, 6)
    fine = load_scenario("swerve", json.loads(row["settings"]))
    assert fine.simulation.step == 0.0005
    assert fine.manoeuvre.level_1 == pytest.approx(0.095)
    one.confirmed = {}
    while shares := one.next_confirmations():
        one.confirmed |= {share: {"counts": False} for share in shares}
    assert min(one.confirmed) == 0.4
    assert one.as_row()["value"] is None


def test_further_runs_are_taken_where_they_count_and_are_better():
    one = descent()
    one.rows[1.0] = {"counts": True, "value": 0.4}
    runs = [one.run(share) for share in (0.9, 1.1, 1.2)]
    worse = [{"counts": True, "value": 0.3}] * 2 + [{"counts": False, "value": 0.9}]
    assert one.improve(runs, worse) is None
    assert one.as_row()["share"] == 1.0
    better = [{"counts": True, "value": value} for value in (0.5, 0.6, 0.2)]
    assert one.improve(runs, better) == 1
    row = one.as_row()
    assert (row["value"], row["runs"], row["share"]) == (0.6, 7, None)
    assert json.loads(row["settings"]) == list(runs[1].settings)


def test_a_run_of_a_search_is_confirmed_where_no_share_of_the_first_steering_counted():
    one = descent()
    one.step = 0.0005
    one.rows[1.0] = {"counts": False}
    assert one.next_confirmations() == []
    one.improve([one.run(0.9)], [{"counts": True, "value": 0.4}])
    assert one.next_confirmations() == [1.0]
    one.confirmed[1.0] = {"counts": True, "value": 0.35}
    assert one.next_confirmations() == []
    assert one.as_row()["value"] == 0.35


@pytest.mark.parametrize(
    ("most", "value", "share", "runs"),
    [(0.3, 0.39, 1.0, 10), (0.6, 0.39, 1.0, 10), (0.95, 0.57, None, 7)],
)
def test_the_better_of_climb_and_search_stands_in_the_table(monkeypatch, most, value, share, runs):
    """The best run of the search counts at the finer step with at most so much of its angles: with
    none that is tried, with some that make it the worse run, or that leave it the better one. Runs
    are those of climb and search, one each, and the confirmations of both.
    """
    one = descent()
    one.step = 0.0005
    one.rows[1.0] = {"counts": True, "value": 0.4}
    searched = one.run(1.0)._replace(aim="aside-1.0")
    one.improve([searched], [{"counts": True, "value": 0.6}])

    def drive(items, _runs):
        rows = []
        for item in items:
            factor = load_scenario("swerve", item.settings).manoeuvre.level_1 / 0.1
            if item.aim == searched.aim:
                rows.append({"counts": factor < most + 1e-9, "value": 0.6 * factor})
            else:
                rows.append({"counts": True, "value": 0.39 * factor})
        return rows

    monkeypatch.setattr(full_runs, "drive_items", drive)
    confirm_best([one], CachedRunner())
    row = one.as_row()
    assert row["value"] == pytest.approx(value)
    assert (row["share"], row["runs"]) == (share, runs)


def test_the_best_run_of_a_search_stands_in_a_table_of_the_coarse_step():
    one = descent()
    one.rows[1.0] = {"counts": True, "value": 0.4}
    one.improve([one.run(0.9)], [{"counts": True, "value": 0.6}])
    confirm_best([one], CachedRunner())
    assert one.as_row()["value"] == 0.6


def test_reduced_cars_alone_are_compared_without_a_full_run(tmp_path):
    table = judge(
        ["none", "held"],
        cars=1,
        speeds=[6.0],
        folder=tmp_path,
        step=None,
        runs=CachedRunner(),
        steering_effort=SearchEffort(16, 1, 1),
    )
    assert list(table["candidate"])[:2] == ["no tail", "tail to the inside, held"]
    assert set(table["plant"]) == {"reduced"}
    assert table["value"].equals(table["reduced_value"])
    assert (table["runs"] == 0).all()


STILL = '''"""A law that does nothing."""
import numpy as np


class Still:
    rate, memory_size = 100.0, 1

    def start(self):
        return np.zeros(1)

    def step(self, memory, seen):
        return memory, np.zeros(5), np.zeros(5), 0
'''


def test_a_law_that_reduced_cars_cannot_follow_has_no_value_there(tmp_path):
    """Its steering is that of the folded tail, and had brought its value along."""
    law = tmp_path / "still.py"
    law.write_text(STILL)
    table = judge(
        ["none", "folded"],
        laws=[f"{law}:Still"],
        cars=1,
        speeds=[6.0],
        folder=tmp_path / "out",
        step=None,
        runs=CachedRunner(),
        steering_effort=SearchEffort(16, 1, 1),
    ).set_index("candidate")
    assert table["value"].notna().to_dict() == {
        "no tail": True,
        "tail folded back, locked": True,
        "Still": False,
    }
    assert table.loc["Still", "level_1"] == table.loc["tail folded back, locked", "level_1"]


def test_the_tail_of_a_law_of_the_readers_waits_in_the_middle(tmp_path):
    law = tmp_path / "still.py"
    law.write_text(STILL)
    scenario = load_scenario("swerve", user_law(f"{law}:Still").settings)
    assert scenario.resting_roll == 0.0


def test_a_run_that_breaks_a_limit_does_not_count():
    run = FullRun(
        ("manoeuvre.level_1=0.05", "manoeuvre.speed=4", "simulation.step=0.002"), "course"
    )
    rolls = drive_full(run)
    for limit, counts in (("roll=0.3", True), ("roll=0.001", False), ("speed=4.2", False)):
        row = drive_full(run._replace(limits=(limit,)))
        assert row["counts"] is counts, limit
        assert row["value"] == rolls["value"]


def test_a_run_whose_aim_is_no_number_does_not_count(tmp_path):
    aim = tmp_path / "aims.py"
    aim.write_text("def unknown(swerve):\n    return float('nan') * swerve.speed[0]\n")
    run = ("manoeuvre.level_1=0.05", "manoeuvre.speed=4", "simulation.step=0.002")
    assert drive_full(FullRun(run, "aside-0.5"))["counts"]
    assert not drive_full(FullRun(run, f"{aim}:unknown"))["counts"]


def test_a_changed_swing_file_is_searched_anew(tmp_path):
    path = tmp_path / "mine.yaml"
    text = model_path("swings/inside_8_rad_per_s.yaml").read_text(encoding="utf-8")
    path.write_text(text, encoding="utf-8")
    settings = ("tail.mode=swing", f"controller.swing_file={path}")
    item = SteeringItem((settings,), "aside-0.5", None)
    before = item.key
    assert item.key == before
    path.write_text(text.replace("kp: 60.0", "kp: 50.0", 1), encoding="utf-8")
    assert item.key != before


def test_a_candidate_without_a_steering_is_not_driven():
    one = descent()
    one.result = one.result | {"score": -1e3}
    assert one.next_shares() == []
    assert one.as_row()["reduced_value"] is None


def test_a_run_that_cannot_be_made_does_not_count(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(LAW)
    law = drive_full(FullRun(("tail.mode=swing",), "aside-0.5", f"{path}:Broken"))
    assert not law["counts"]
    assert "no law" in law["error"]
    angle = drive_full(FullRun(("manoeuvre.level_1=1.0",), "aside-0.5"))
    assert not angle["counts"]
    assert "manoeuvre.level_1" in angle["error"]


@pytest.mark.slow
def test_a_comparison_has_every_candidate_and_goes_on_with_its_runs(tmp_path):
    efforts = {
        "steering_effort": SearchEffort(24, 3),
        "bound_effort": BoundEffort(members=24, generations=1, starts=1, iterations=3),
        "further": 8,
    }
    runs = CachedRunner()
    arguments = {"cars": 1, "floors": [1.2], "speeds": [6.0], "folder": tmp_path, "runs": runs}
    arguments["step"] = 0.002
    names = ["none", "folded", "bound-announced"]
    table = judge(names, **arguments, **efforts)
    assert list(table["candidate"]) == [
        "no tail",
        "tail folded back, locked",
        "bound",
        "announced bound",
    ]
    assert (table["reduced_value"] > 0.3).all()
    assert table["value"].to_numpy() == pytest.approx(table["reduced_value"].to_numpy(), rel=0.25)
    assert table["reduced_value"][2] >= table["reduced_value"][1]
    assert (table["runs"] >= 9).all()
    for value, settings in zip(table["value"], table["settings"], strict=True):
        again = drive_full(FullRun(tuple(json.loads(settings)), "aside-0.5"))
        assert again["counts"]
        assert again["value"] == value
    made = runs.ran
    again = judge(names, **arguments, **efforts)
    assert runs.ran == made
    assert np.array_equal(again["value"], table["value"])
    # A motion that is judged as a file has the trim of its driver.
    (file,) = (tmp_path / "swings").glob("announced*.yaml")
    swing = read_swing(file)
    trim = f"manoeuvre.trim_angle={table['trim_angle'][3]:.9g}"
    assert swing.provenance.settings[-1] == trim
    candidate = swing_player(str(file))
    assert candidate.settings[-1] == trim
    settings = (
        *(ensemble_cases("physical", "test", 1, "built", [1.2])[0]).settings(),
        *candidate.settings,
    )
    swerve = ReducedSwerve(load_scenario("swerve", (*settings, "manoeuvre.speed=6.0"))).drive(
        table.loc[3, list(STEERING_KEYS[:5])].to_numpy(float)[:, None]
    )
    assert aside(swerve) == pytest.approx(table["reduced_value"][3], abs=1e-6)


@pytest.mark.slow
def test_an_aim_of_ones_own_becomes_a_verified_motion_and_a_replay(tmp_path):
    """The example of the page, step by step."""
    (block,) = [block for block in blocks(GUIDE) if block["title"] == "aims.py"]
    aim = tmp_path / "aims.py"
    aim.write_text(block["text"])
    out = tmp_path / "motion"
    words = ["--aim", f"{aim}:thrifty", "--limit", "roll=0.3", "--floor", "1.2", "--speed", "6"]
    words += ["--members", "60", "--generations", "3", "--starts", "1", "--iterations", "8"]
    words += ["--step", "0.002"]
    assert "s to go" in call("swing", "search", *words, "--out", out).stderr
    path = out / "swing.yaml"
    path.unlink()
    found = call("swing", "search", *words, "--out", out)
    assert "0 runs made" in found.stderr
    swing = read_swing(path)
    assert str(swing.provenance.found["aim"]).endswith("aims.py:thrifty")
    assert swing.provenance.options["limits"] == "roll=0.3"
    verdict = call("swing", "verify", path, "--out", tmp_path / "v")
    assert found.exit_code == verdict.exit_code == 0, found.output
    checks = yaml.safe_load((tmp_path / "v" / "verification.yaml").read_text())["checks"]
    values = {check["name"]: check["value"] for check in checks}
    assert values["the swerve counts"] == 1.0, verdict.output
    claimed = swing.provenance.found["aim_value"]
    log, page = tmp_path / "thrifty.parquet", tmp_path / "thrifty.html"
    setting = "simulation.step=0.002"
    done("run", "--swing", path, "--set", setting, "--out", log, "--html", page)
    assert log.is_file()
    assert page.is_file()
    assert values[f"aim {aim}:thrifty"] == pytest.approx(claimed, abs=1e-6)


@pytest.mark.slow
def test_the_command_leaves_table_summary_and_page_and_goes_on_in_its_folder(tmp_path):
    words = ["swing", "judge", "--reduced", "--cars", "1", "--speed", "6", "--candidate", "none"]
    words += ["--workers", "1", "--out", tmp_path]
    first = call(*words)
    assert first.exit_code in (0, 1), first.output
    table = pd.read_csv(tmp_path / "swerves.csv")
    assert set(table["plant"]) == {"reduced"}
    assert "no tail" in first.output
    assert "no tail" in (tmp_path / "report.html").read_text()
    again = call(*words)
    assert again.exit_code == first.exit_code
    assert pd.read_csv(tmp_path / "swerves.csv").equals(table)
