"""The entry speeds that the demo begins with: choice and table go together, and what the
page says.
"""

import pandas as pd

from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view import entry_chapter as chapter

CHOSEN = chapter.load_shown_entry()


def test_the_shipped_table_has_what_is_shown():
    table = pd.read_csv(model_path(chapter.ENTRIES))
    assert CHOSEN.manoeuvre in set(table["manoeuvre"])
    assert {one.name for one in CHOSEN.candidates} <= set(table["candidate"])
    assert CHOSEN.car in set(table["car"])
    assert CHOSEN.floor in set(table["floor"])
    assert not table.duplicated(["manoeuvre", "candidate", "car", "floor"]).any()


def row(candidate, speed, ended_by="", ceiling=False, floor="x 1"):
    place = {"manoeuvre": "turn", "candidate": candidate, "floor": floor}
    return place | {"entry_speed_m_per_s": speed, "ended_by": ended_by, "at_ceiling": ceiling}


def test_medians_say_how_many_cars_and_what_a_ceiling_hides(tmp_path, monkeypatch):
    rows = [row("b", speed, "two wheels") for speed in (3.0, 3.5, None)] + [
        row("b", 9.0, "error: NaN")
    ]
    rows += [row("a", 3.0), row("a", 4.0, ceiling=True), row("none of it", None, "lateral")]
    rows += [
        row("known", 3.0),
        row("known", 3.2),
        row("known", 5.0, ceiling=True),
        row("known", 1.0, floor="x 1.2"),
    ]
    path = tmp_path / "entries.csv"
    pd.DataFrame(rows).to_csv(path, index=False)
    monkeypatch.setattr(chapter, "model_path", lambda _name: path)
    found = chapter.entry_medians("x 1")["turn"]
    said = {
        "b": "3.25 (2 of 4)",
        "a": "≥ 3.50 (2 of 2)",
        "none of it": "none",
        "known": "3.20 (3 of 3)",
    }
    assert found.to_dict() == said
    assert list(found.index) == list(said), "in the order of the table"


def test_a_run_is_on_the_car_and_at_the_speed_that_are_named():
    first, *others = [CHOSEN.run(one) for one in CHOSEN.candidates]
    assert first.manoeuvre.speed == CHOSEN.speed_m_per_s
    car = next(
        member for member in load_ensemble(CHOSEN.ensemble).members if member.name == CHOSEN.car
    )
    own = (*car.settings_on(CHOSEN.scenario), *CHOSEN.settings)
    assert first.car == load_scenario(CHOSEN.scenario, own).car
    assert all((one.car, one.manoeuvre) == (first.car, first.manoeuvre) for one in others)
    assert len({str((one.tail.mode, one.controller)) for one in (first, *others)}) == len(
        CHOSEN.candidates
    )
