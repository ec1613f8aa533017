"""Search for a law: on a made-up landscape, and one case of a reduced car."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.runs import Runs
from aerodima.optimisation.swing.law_search import (
    APART,
    TRAINED,
    LawSearch,
    Screening,
    course_table,
    score,
    screened_courses,
    screening_of,
    search_laws,
)
from aerodima.optimisation.swing.task import Floor, SteeringSearch, Task
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.checked_files import read_yaml
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import UserError
from aerodima.workbench.resources import model_path

PUBLISHED = TRAINED.published_law()
ONE_AMPLITUDE = SteeringSearch(math.radians(2.0), math.radians(8.0), runs=1, spread=1)


def found(seed: int = 1) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Finalists and all laws that were tried, of which the one at 0.3 of every range is the best."""
    tried: list[dict[str, float]] = []

    def worth(laws: Sequence[Mapping[str, float]]) -> FloatArray:
        tried.extend(map(dict, laws))
        return np.array([1.0 - np.linalg.norm(TRAINED.shares(law) - 0.3) for law in laws])

    search = LawSearch(laws=5, generations=40, finalists=3, seed=seed)
    return search_laws(TRAINED, search, PUBLISHED, worth, [].append), tried


def test_the_search_comes_to_the_best_law_and_to_others_beside_it() -> None:
    finalists, tried = found()
    assert TRAINED.shares(finalists[0]) == pytest.approx(0.3, abs=0.12)
    distances = [np.max(np.abs(TRAINED.shares(a) - TRAINED.shares(b))) for a, b in pairwise(finalists)]
    assert min(distances) >= APART - 1e-3  # four digits
    assert tried[0] == pytest.approx(PUBLISHED, rel=1e-3)
    assert found()[0] == finalists
    assert found(seed=2)[0] != finalists
    for law in tried[::100]:
        SwingSettings.published(**law)  # raises where the car would refuse it


def test_the_worst_car_counts_as_much_as_the_mean() -> None:
    courses = np.array([[1.0, 1.0, 2.0, 2.0], [2.0, 2.0, 2.0, 2.0]])
    assert score(courses, courses[0], "aabb") == pytest.approx([1.0, 0.5 * (1.5 + 1.0)])
    # A case without a turn of the published swing says nothing.
    assert score(courses, np.array([1.0, 0.0, 2.0, 2.0]), "aabb") == pytest.approx([1.0, 0.5 * (4 / 3 + 1.0)])
    with pytest.raises(UserError, match="training cars a, b: no turn of the published swing counts"):
        score(courses, np.zeros(4), "aabb")


def test_a_scenario_file_with_another_content_is_screened_anew(tmp_path: Path) -> None:
    """Its cars are kept in the process, and the courses in the store."""
    path = tmp_path / "car.yaml"
    designed, found = read_yaml(model_path("scenarios/turn_designed.yaml")), []
    with RowStore(tmp_path / "runs.jsonl", {}) as store:
        engine = Runs(store=store)
        for mass in (6.5, 8.0, 6.5):
            path.write_text(yaml.safe_dump({**designed, "car": {"mass": mass}}))
            cases = screening_of(Task(scenario=str(path)), [Floor(Member("own", 1.0, {}), 4.5, 1.3, 0.6)], 7)
            found.append(course_table(replace(cases, steering=ONE_AMPLITUDE), [{}], engine)[0, 0])
    assert found[0] == found[2] != found[1]
    assert len(store.rows) == 2


def test_a_law_is_screened_as_its_scenario_would_be() -> None:
    """With 4 degrees, as if driven from standstill. A swing that begins on the straight counts for nothing."""
    law = PUBLISHED | {"swing_speed": 9.0, "delay": 0.1}
    case = ("car.tyre_friction=0.9", "manoeuvre.turn_hold=0.5")
    task = Screening("turn_designed", (case,), ("",), ONE_AMPLITUDE, 1.0, 0.5, laws=(law,), fixed=TRAINED.fixed)
    (course,) = screened_courses(task)
    steered = f"manoeuvre.steer_angle={math.radians(4.0)!r}"
    scenario = load_scenario("turn_designed", (*case, *TRAINED.settings(law), steered))
    turns = drive_turns(Vehicles.of([scenario]), TurnPlans.of([scenario]), duration=task.duration)
    assert turns.clean[0]
    assert turns.trigger == pytest.approx(0.11)  # the command is seen a tick late
    assert course == pytest.approx(turns.course, abs=1e-9)
    early = replace(task, laws=({"trigger_yaw_rate": 1e-5},), fixed=())
    assert screened_courses(early) == [[0.0]]
