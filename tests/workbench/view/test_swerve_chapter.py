"""The swerve that the demo begins with: all who complete it are shown, and what the page says."""

import json

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.swerve import aside, outline_from_above, swerve_of
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view import swerve_chapter as chapter
from tests.refusals import assert_refused

CHOSEN = chapter.load_shown_swerve()


def shown_rows():
    table = pd.read_csv(model_path(chapter.SWERVES)).query("plant == 'full'")
    for column in chapter.PLACE:
        table = table[table[column] == getattr(CHOSEN, column)]
    return table.set_index("candidate")


def test_every_candidate_that_completes_the_shown_swerve_is_shown():
    rows = shown_rows()
    complete = rows.index[rows["counts"].astype(str) == "True"]
    assert list(CHOSEN.runs()) == list(complete)
    for baseline in ("no tail", "no tail, rollover control", "low ballast", "bound"):
        assert baseline in rows.index, "it was tried"
    assert set(CHOSEN.words) <= set(rows.index)


def test_a_shown_run_is_at_the_speed_on_the_floor_and_with_the_steering_of_its_row():
    rows = shown_rows()
    runs = CHOSEN.runs()
    assert {run.manoeuvre.speed for run in runs.values()} == {CHOSEN.speed_m_per_s}
    assert len({run.car.tyre_friction for run in runs.values()}) == 1
    assert len({run.simulation.step for run in runs.values()}) == 1
    for candidate, run in runs.items():
        row = rows.loc[candidate]
        assert [f"{key}={getattr(run.manoeuvre, key)!r}" for key in ("level_1", "level_1_end")] == [
            setting.removeprefix("manoeuvre.")
            for setting in json.loads(row["settings"])
            if setting.startswith(("manoeuvre.level_1=", "manoeuvre.level_1_end="))
        ]


def row(candidate, car, value, **place):
    return {
        "plant": "reduced",
        "candidate": candidate,
        "car": car,
        "value": value,
        "floor": "x 1",
        "aim": "aside-0.5",
        "speed_m_per_s": 6.0,
    } | place


def test_medians_say_how_many_cars_and_the_gain_over_the_same_cars(tmp_path, monkeypatch):
    rows = [row("no tail", car, value) for car, value in (("a", 0.4), ("b", 0.5), ("c", 0.2))]
    rows += [row("z", car, value) for car, value in (("a", 0.44), ("b", 0.6), ("c", None))]
    rows += [row("none of it", car, None) for car in "abc"]
    rows += [row("no tail", "a", 0.3, speed_m_per_s=8.0), row("z", "a", 0.6, plant="full")]
    path = tmp_path / "swerves.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    monkeypatch.setattr(chapter, "model_path", lambda _name: path)
    medians = chapter.swerve_medians()
    assert medians["friction x 1, 6 m/s"].to_dict() == {
        "no tail": "0.400, +0% (3 of 3)",
        "z": "0.520, +15% (2 of 3)",
        "none of it": "–",
    }
    eight = medians["friction x 1, 8 m/s"].to_dict()
    assert eight == {"no tail": "0.300, +0% (1 of 1)", "z": "–", "none of it": "–"}, "not compared"
    assert list(medians.index) == ["no tail", "z", "none of it"], "in the order of the table"


@pytest.mark.slow
def test_the_chapter_says_how_far_a_run_swerves_and_whether_it_counts():
    levels = ("manoeuvre.level_1=0.03", "manoeuvre.level_2=0.0", "manoeuvre.level_3=0.0")
    settings = ("manoeuvre.speed=4", "simulation.step=0.002", *levels)
    swerve = load_scenario("swerve", settings)
    log = simulate(swerve)
    lefts = outline_from_above(log, (0.0, 0.5))[1].min(axis=0)
    outcome = swerve_of(simulate(swerve, record="outcome"))
    assert lefts[1] - lefts[0] == pytest.approx(aside(outcome)[0], abs=1e-3)
    assert lefts[1] - lefts[0] > 0.04
    in_step, *tables = chapter.swerve_chapter(CHOSEN, {"no tail": log})
    assert [section.title for section in tables] == [
        "How far they swerve: reduced cars",
        "How far they swerve: full cars",
    ]
    above, replays = in_step.parts
    assert f"{CHOSEN.rows()['value']['no tail']:.2f} m aside" in str(vars(replays))
    (run,) = above.values["runs"]
    outlines = np.array(run["outlines"])
    soon = round((above.values["start"] + 0.5) / above.values["step"])
    assert outlines[soon][:, 1].min() == pytest.approx(lefts[1], abs=1e-3)


def test_a_choice_that_is_not_whole_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "shown.yaml"
    path.write_text("schema: aerodima/shown_swerve/1\ntail: built\n")
    monkeypatch.setattr(chapter, "model_path", lambda _name: path)
    assert_refused(chapter.load_shown_swerve, ScenarioError, "floor", "car")
