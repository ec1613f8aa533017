"""One's own car: a law of the tail is trained for it in the measure of the corner study, and judged on unseen cars.

What is stated of the car (scenario file and overrides) holds for all cars of the study; in everything else training and
test cars differ as those of an ensemble do. The law is trained on the stated car and on the training cars, and compared
with no tail, held, published and best constant rate, each with its own best steering, on the stated car and on the test
cars. Its second measure is the critical friction at full lock, on the stated car.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from aerodima.optimisation.studies.contestants import Contestant
from aerodima.optimisation.studies.corner_floors import critical_frictions
from aerodima.optimisation.studies.corner_plan import PULSE, CornerPlan, contestants_of
from aerodima.optimisation.studies.corner_result import Corner
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.law_search import LawSearch
from aerodima.optimisation.studies.law_training import CHUNK, CONSTANT_RATE, TRAINED
from aerodima.optimisation.studies.steering_search import SteeringSearch
from aerodima.optimisation.studies.study_store import open_runs
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunEngine
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.batch.row_store import saying_how_to_go_on
from aerodima.workbench.config.checked_files import find_file, read_yaml
from aerodima.workbench.config.ensemble import Member, load_ensemble
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.errors import SweepError

CAR, LAW, TURN = "car.yaml", "law.yaml", "turn.yaml"
"""Files that a study leaves: the car as a scenario, its law, and the turn that the law was proved in as a scenario."""
STATED = "the stated car"
"""Its name in tables."""
WORDS = {"none": "none", "held": "held", "published": "published", "constant": "constant rate", "trained": "yours"}
"""Who is compared, by the names that the corner study knows, in the words of the sentence."""
CLIMB, PROOF = 5, 2
"""About how many runs a climb over friction takes, and the proof of a steering at the fine step."""


@dataclass(frozen=True)
class Effort:
    """How much is run.

    Attributes:
        members: test cars, unseen by the law.
        training: cars that the law is trained on beside the stated one.
        laws, generations, finalists: see `LawSearch`.
        runs: of each search for an amplitude.
        seed: of the split into training and test cars, and of the laws.
    """

    members: int = 8
    training: int = 4
    laws: int = 6
    generations: int = 15
    finalists: int = 5
    runs: int = 9
    seed: int = 1

    @property
    def pieces(self) -> int:
        """About how many runs of the full car and pieces of training there will be, for the time left."""
        learning, judging, contestants = 1 + self.training, 1 + self.members, len(WORDS)
        families = (CONSTANT_RATE, TRAINED)
        screened = sum(
            1 + (self.generations + 1) * math.ceil(self.laws * len(family.ranges) / CHUNK) for family in families
        )
        trained = (1 + len(families) * self.finalists) * learning * self.runs
        judged = contestants * judging * (self.runs + PROOF)
        return screened + trained + judged + CLIMB * (learning + judging + contestants - 2)


QUICK = Effort(members=2, training=1, laws=3, generations=2, finalists=2, runs=5)
"""A first answer in minutes."""


@dataclass(frozen=True)
class OwnCar:
    """What a study came to.

    Attributes:
        plan: of the corner study.
        corner: of all cars; the stated one is `STATED`.
        at_full_lock: critical friction on the stated car by contestant, in order; None: clean on no floor.
        law: the contestant that was trained.
        published_is_best: no law did better than the published one on the training cars.
        data: content of the scenario file of the stated car.
        test, training: cars.
    """

    plan: CornerPlan
    corner: Corner
    at_full_lock: tuple[float | None, ...]
    law: Contestant
    published_is_best: bool
    data: dict[str, Any]
    test: tuple[Member, ...]
    training: tuple[Member, ...]

    @property
    def speed(self) -> float:
        """m/s."""
        return self.plan.speeds[0]

    @property
    def own(self) -> pd.DataFrame:
        """Rows of the stated car by contestant, in order."""
        return self.corner.cases[self.corner.cases["car"] == STATED]

    @property
    def unseen(self) -> Corner:
        """Of the test cars alone."""
        return replace(self.corner, cases=self.corner.cases[self.corner.cases["car"] != STATED])

    def furthest(self) -> tuple[int, int]:
        """On how many unseen cars the law turns further than all others, and of how many."""
        course = self.unseen.cases.pivot(index="car", columns="contestant", values="course_change_rad").fillna(0.0)
        others = course.drop(columns=self.law.name).max(axis=1)
        return int((course[self.law.name] > others).sum()), len(course)

    def grip_words(self, grip: float | None, digits: int) -> str:
        """A critical friction; where the car is clean on no floor, that it is below the least that was tried."""
        return f"below {self.plan.friction.low:.{digits}f}" if grip is None else f"{grip:.{digits}f}"

    def sentence(self) -> str:
        """The result."""
        courses = [math.degrees(course) for course in self.own["course_change_rad"]]
        turned = ", ".join(
            f"{who} {'no turn' if course != course else f'{course:.0f}'}"
            for who, course in zip(WORDS.values(), courses, strict=True)
        )
        same = " (the published law: none better was found)" if self.published_is_best else ""
        number, cars = self.furthest()
        grips = " / ".join(self.grip_words(grip, 2) for grip in self.at_full_lock)
        return (
            f"course in {PULSE:g} s, each with its best steering: {turned} degrees{same}; furthest on {number} of "
            f"{cars} unseen cars; critical friction at full lock {grips}"
        )


def study_own_car(
    out: Path,
    scenario: str,
    settings: Sequence[str],
    effort: Effort,
    engine: RunEngine,
    *,
    floor: float = 1.3,
    ensemble: str = "car",
    force: bool = False,
    progress: ProgressLine = silent,
) -> OwnCar:
    """Trains a law for a car and judges it; what the folder holds already is not run again.

    Args:
        out: folder of the runs and of the car's scenario.
        scenario: name or file of the car and its turn; `settings` override it.
        effort: how much is run.
        engine: where.
        floor: friction over the critical one of the published swing at full lock, on each car.
        ensemble: of the training and test cars.
        force: drop the runs that are there.
        progress: told lines.

    Raises:
        UserError: a scenario that is none, or states all that the cars of the ensemble differ in; fewer cars than
            asked for; the folder is in use or holds other runs; the car is clean on no floor.
    """
    data = stated_data(scenario, settings)
    test, training = possible_cars(data, ensemble, effort)
    with open_runs(out, force=force) as store:
        write_atomically(out / CAR, yaml.safe_dump(data, sort_keys=False, width=110), True, SweepError)
        plan = _plan(str((out / CAR).resolve()), floor, effort)
        remembering = RememberingEngine(engine, store, progress)
        remembering.expect(effort.pieces)
        stated = stated_car()
        with saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs"):
            corner = CornerRuns(plan, remembering).measure(
                contestants_of(list(WORDS)), [], [stated, *test], [stated, *training]
            )
            if any(name.startswith(STATED) for name in corner.without_floor):
                raise SweepError(f"{scenario}: the published swing at full lock is clean on no floor")
            remembering.stage = "critical friction"
            asked = [(who, stated, plan.speeds[0]) for who in corner.contestants]
            grips = tuple(critical_frictions(plan, asked, remembering))
        progress(f"{remembering.ran} runs made, the others were there")
    published = corner.laws.groupby("family")["worth"].idxmax()[TRAINED.name]
    best_is_published = str(corner.laws["law"][published]) == "published"
    return OwnCar(plan, corner, grips, corner.contestants[-1], best_is_published, data, test, training)


def stated_car() -> Member:
    """The car of the scenario file, as a member that differs in nothing."""
    return Member(STATED, 0.0, {})


def stated_data(scenario: str, settings: Sequence[str]) -> dict[str, Any]:
    """Content of a scenario file with overrides.

    Raises:
        UserError: as `load_scenario`; or it has no turn.
    """
    if (kind := load_scenario(scenario, settings).manoeuvre.kind) != "turn":
        raise SweepError(f"{scenario}: manoeuvre.kind {kind}; allowed: turn")
    data = read_yaml(find_file(scenario, Scenario.folder, "scenario"))
    for setting in settings:
        Scenario.apply_setting(data, setting)
    return data


def stated_numbers(data: Mapping[str, Any]) -> dict[str, Any]:
    """`section.key` and value of all that a scenario file has in sections."""
    sections = {name: values for name, values in data.items() if isinstance(values, dict)}
    return {f"{name}.{key}": value for name, values in sections.items() for key, value in values.items()}


def possible_cars(
    data: Mapping[str, Any], ensemble: str, effort: Effort
) -> tuple[tuple[Member, ...], tuple[Member, ...]]:
    """Test and training cars: members of the ensemble in which everything that is stated is as stated.

    Raises:
        UserError: the ensemble has fewer cars, or nothing is left in which they differ.
    """
    stated = stated_numbers(data)
    split = load_ensemble(ensemble).split(effort.seed)
    parts = []
    for option, asked, part in (("members", effort.members, split.test), ("training", effort.training, split.training)):
        if not 1 <= asked <= len(part):
            raise SweepError(f"--{option} {asked}: the ensemble has {len(part)} such cars; allowed: 1 to {len(part)}")
        free = [{key: value for key, value in car.values.items() if key not in stated} for car in part[:asked]]
        if not all(free):
            raise SweepError(
                f"the scenario states all {len(part[0].values)} numbers in which the cars of {ensemble} differ; "
                "allowed: a file with what is known of the car alone"
            )
        parts.append(tuple(Member(c.name, c.weight, values) for c, values in zip(part[:asked], free, strict=True)))
    return parts[0], parts[1]


def _plan(car: str, floor: float, effort: Effort) -> CornerPlan:
    turn = load_scenario(car)
    high = min(SteeringSearch().high, turn.servo.limit)
    return CornerPlan(
        car,
        (turn.manoeuvre.speed,),
        (floor,),
        search=SteeringSearch(high=high, runs=effort.runs),
        training=LawSearch(effort.laws, effort.generations, effort.finalists, effort.seed),
    )
