"""The case that the page of a judgement shows."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.swing.candidate import HELD, NO_TAIL
from aerodima.optimisation.swing.judge import Judgement, middle_case
from aerodima.optimisation.swing.judge_page import _case_sections, plot_paths
from aerodima.optimisation.swing.task import Task
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.report.report_page import Plot, Table, Templated
from aerodima.workbench.simulate.simulation import simulate


class OneCar(Task):
    test_cars: ClassVar[tuple[Member, ...]] = (Member("a", 1.0, {}),)


def table_of(courses: dict[str, list[float]]) -> pd.DataFrame:
    """A case per floor; courses in degrees."""
    rows = [
        {"candidate": name, "car": "a", "speed_m_per_s": 4.5, "floor": 1.0 + place, "pulse_s": 0.5, "friction": 0.9}
        | {"critical_friction": 0.9}
        | {"course_change_rad": math.radians(course), "steering_deg": 4.0}
        for name, own in courses.items()
        for place, course in enumerate(own)
    ]
    return pd.DataFrame(rows)


def test_the_case_in_the_middle_is_shown() -> None:
    cases = table_of({NO_TAIL.name: [30, 30, 30, 30], "a": [33, 60, 36, 31], "b": [31, 31, 39, 45]})
    shown = middle_case(cases)
    assert shown is not None
    assert set(shown["floor"]) == {3.0}, "gains of 10, 100, 30 and 50 %: the lesser of the two in the middle is 30"
    assert set(shown["candidate"]) == {NO_TAIL.name, "b", "a"}


def test_a_candidate_without_a_turn_is_not_shown_and_a_study_without_gains_shows_nothing() -> None:
    cases = table_of({NO_TAIL.name: [30], "a": [33], "b": [math.nan]})
    shown = middle_case(cases)
    assert shown is not None
    assert list(shown["candidate"]) == [NO_TAIL.name, "a"]
    assert middle_case(table_of({NO_TAIL.name: [math.nan], "a": [33]})) is None
    assert middle_case(table_of({"a": [33]})) is None


def test_the_page_has_paths_and_replays_of_the_case() -> None:
    cases = table_of({NO_TAIL.name: [25], HELD.name: [28]})
    task = OneCar(scenario="turn_designed", fine_step=0.004)
    found = Judgement(cases, pd.DataFrame(), (NO_TAIL, HELD), ())
    (section,) = _case_sections(task, found)
    which, paths, replays = section.parts
    assert which == Table(["car", "speed_m_per_s", "floor", "pulse_s", "friction"], [["a", "4.5", "1", "0.5", "0.9"]])
    assert isinstance(paths, Plot)
    assert isinstance(replays, Templated)


def test_paths_begin_at_the_steering_along_the_first_axis_and_bend_to_the_left() -> None:
    run_log = simulate(
        load_scenario("turn_none", ["manoeuvre.speed=2.0", "simulation.step=0.004", "simulation.log_rate=250"])
    )
    axes = plot_paths({"none": run_log}).axes[0]
    x, y = np.asarray(axes.lines[0].get_data(), dtype=float)
    assert (x[0], y[0]) == (0.0, 0.0)
    tenth = int(np.searchsorted(x, 0.1))
    assert abs(y[tenth]) < 0.02
    assert y[-1] > 0.3
    assert axes.get_aspect() == pytest.approx(1.0)
