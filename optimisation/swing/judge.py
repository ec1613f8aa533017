"""Who turns the car further: floor and speed are given, every candidate has the steering that is best for it.

A case is a car, a speed and a floor: a multiple of the critical friction of the published swing at full lock there.
Each candidate steers a pulse, or pulses of several lengths, with the amplitude that turns the course furthest among
the runs that count (`counts`): found at the ordinary step, proved at the fine one, and lowered by a stated share until
it counts there too.
The time to a course is measured likewise, in runs of their own that are steered until they reach it. The steering is
found on the car that is judged, as a driver would; laws are trained (`law_training`) on training cars alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.candidates import THESIS, Candidate, refuse_twice
from aerodima.optimisation.studies.corner_floors import find_floors, turn_settings
from aerodima.optimisation.studies.corner_plan import (
    MOST_BACK,
    MOST_ROLL,
    MOST_SIDESLIP,
    ONE_LEVEL,
    SHOWN,
    STEP_BACK,
    Aim,
    CornerPlan,
    Floor,
    PulsedTurn,
    Run,
    Steered,
    Steering,
    Turn,
    counts,
)
from aerodima.optimisation.studies.corner_result import Corner
from aerodima.optimisation.studies.disturbed_turns import drive_disturbed
from aerodima.optimisation.studies.law_training import (
    CHUNK,
    SOON_OVER,
    LawFamily,
    Screening,
    run_screenings,
    score,
    screened_finalists,
)
from aerodima.optimisation.studies.steering_search import best_place, search_steering
from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunTask, scenario_content
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario


class CornerRuns:
    """Runs what a plan asks for; everything that it runs goes through an engine that remembers."""

    def __init__(self, plan: CornerPlan, engine: RememberingEngine) -> None:
        self._plan, self._engine = plan, engine
        self._without_floor: dict[str, None] = {}

    def measure(
        self, chosen: Mapping[str, Candidate | LawFamily], laws: Sequence[Candidate], test: Sequence[Member],
        training: Sequence[Member],
    ) -> Corner:  # fmt: skip
        """The table.

        Args:
            chosen: of `candidates_of`.
            laws: further candidates.
            test: cars that are judged on.
            training: cars that laws are looked for on.

        Raises:
            UserError: two candidates of one name; none has a floor.
        """
        refuse_twice([who.name for who in (*chosen.values(), *laws)], "candidate")
        trained = {who.name: self.trained(who, training) for who in chosen.values() if isinstance(who, LawFamily)}
        tables = [table for _, table in trained.values()]
        candidates = [trained[who.name][0] if isinstance(who, LawFamily) else who for who in chosen.values()]
        candidates += laws
        floors = self.floors(test)
        cases = self.cases(candidates, floors, self.floors(training) if self._plan.fixed else ())
        table = pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()
        disturbed = pd.DataFrame()
        if self._plan.disturbed:
            self._engine.stage = "disturbed runs"
            disturbed = drive_disturbed(self._plan, cases, candidates, test, self.task, self._engine)
        return Corner(cases, table, tuple(candidates), tuple(self._without_floor), disturbed)

    def cases(
        self, candidates: Sequence[Candidate], floors: Sequence[Floor], training: Sequence[Floor] = ()
    ) -> pd.DataFrame:
        """A row per pulse, floor and candidate; steering is fixed, if it is, by the floors for `training`."""
        turns, learning = ([(who, floor) for floor in part for who in candidates] for part in (floors, training))
        courses = {aim: self._steered(aim, turns, self._plan.shapes) for aim in map(Aim, self._plan.courses)}
        if self._plan.reduced:
            return make_frame(self._reduced([(pulse, *turn) for pulse in self._plan.pulses for turn in turns]))
        return make_frame([row for pulse in self._plan.pulses for row in self._pulsed(pulse, turns, courses, learning)])

    def _pulsed(
        self, pulse: float, turns: Sequence[Turn], courses: Mapping[Aim, Sequence[Steered]], learning: Sequence[Turn]
    ) -> list[dict[str, Any]]:
        """Rows of the turns by a pulse; `courses` are the times to courses, `learning` the turns for fixed steering."""
        aim = Aim(pulse=pulse)
        measured = {aim: self._steered(aim, turns, self._plan.shapes), **courses}
        rows = [
            self._row(who, floor, {aim: steered[place] for aim, steered in measured.items()})
            for place, (who, floor) in enumerate(turns)
        ]
        if self._plan.fixed:
            for row, fixed in zip(rows, self._fixed(aim, turns, self._fixed_places(aim, learning)), strict=True):
                row |= fixed
        return rows

    def _reduced(self, turns: Sequence[PulsedTurn]) -> list[dict[str, Any]]:
        """Rows of reduced cars: the course alone."""
        parts = [self._screening(turns[k : k + CHUNK]) for k in range(0, len(turns), CHUNK)]
        courses = [course for (found,) in run_screenings(self._engine, parts) for course in found]
        rows = [self._row(who, floor, {Aim(pulse=pulse): Steered(None)}) for pulse, who, floor in turns]
        return [row | {"course_change_rad": course or math.nan} for row, course in zip(rows, courses, strict=True)]

    def floors(self, members: Sequence[Member]) -> list[Floor]:
        """Of cars, speeds and shares; SweepError when none has a floor."""
        self._engine.stage = "critical friction"
        floors, without = find_floors(self._plan, members, self._engine)
        self._without_floor |= dict.fromkeys(without)
        return floors

    def trained(self, family: LawFamily, training: Sequence[Member]) -> tuple[Candidate, pd.DataFrame]:
        """The law of a family for each speed that is best on the training cars, and a table of the finalists."""
        chosen, rows = {}, []
        family = family.for_pulse(self._plan.pulses[0])
        for speed in self._plan.speeds:
            floors = [floor for floor in self.floors(training) if floor.speed == speed]
            cases = self.reduced_cases(floors)
            found = screened_finalists(family, self._plan.training, cases, self._engine)
            laws = [family.published_law, *found.finalists]
            self._engine.stage = family.name
            courses = self.courses([Candidate("", family.settings(law)) for law in laws], floors)
            worth = score(courses, courses[0], cases.cars)
            chosen[speed] = laws[int(np.argmax(worth))]
            for place, law in enumerate(laws):
                row = {"family": family.name, "speed_m_per_s": speed, "law": place or "published", **law}
                rows.append(row | {"worth": worth[place], "median_course_rad": np.median(courses[place])})
        return family.candidate(chosen), pd.DataFrame(rows)

    def reduced_cases(self, floors: Sequence[Floor]) -> Screening:
        """The floors for reduced cars, with the published law."""
        plan = self._plan
        cases = self._screening([(plan.pulses[0], THESIS, floor) for floor in floors])
        return replace(cases, steering=replace(plan.search, runs=plan.training.steering_runs))

    def _screening(self, turns: Sequence[PulsedTurn]) -> Screening:
        """Turns as cases for reduced cars."""
        plan, settings = self._plan, []
        for hold, who, floor in turns:
            own = turn_settings(plan.scenario, who, floor.member, floor.speed, plan.step)
            settings.append((*own, f"{FRICTION}={floor.friction!r}", f"manoeuvre.turn_hold={hold!r}"))
        cars, longest = tuple(floor.member.name for *_, floor in turns), max(pulse for pulse, *_ in turns)
        numbers = (plan.search, MOST_ROLL, MOST_SIDESLIP)
        content = content_key([scenario_content(plan.scenario, own) for own in settings])
        return Screening(plan.scenario, tuple(settings), cars, *numbers, duration=longest + SOON_OVER, content=content)

    def courses(self, drivers: Sequence[Candidate], floors: Sequence[Floor]) -> FloatArray:
        """Course at 2 ms (drivers, floors), rad, with the best steering of one level; 0 where no turn counts."""
        turns = [(who, floor) for who in drivers for floor in floors]
        aim = Aim(pulse=self._plan.pulses[0])
        best = [one.worth if one else 0.0 for one in self._search(aim, turns, self._plan.shapes[:1])]
        return np.array(best).reshape(len(drivers), len(floors))

    def task(self, run: Run, step: float, times: tuple[float, float]) -> RunTask:
        """A turn with a step of the plant (s), steered, and going on after that, for these times (s)."""
        who, floor, place, (ratio, first) = run
        hold, after = times
        end = load_scenario(self._plan.scenario).manoeuvre.turn_start + hold + after
        angle = self._plan.search.angle(place)
        steered = [f"manoeuvre.steer_angle={angle!r}", f"manoeuvre.turn_hold={hold!r}", f"manoeuvre.duration={end:.9g}"]
        if first:
            level = min(ratio * angle, self._plan.search.high)
            steered += [f"manoeuvre.first_angle={level!r}", f"manoeuvre.first_hold={min(first, hold)!r}"]
        settings = (
            *turn_settings(self._plan.scenario, who, floor.member, floor.speed, step),
            f"{FRICTION}={floor.friction!r}",
            *steered,
        )
        return RunTask(f"{who.name} {floor.member.name} {floor.speed:g}", self._plan.scenario, settings)

    def _runs(self, aim: Aim, wanted: Sequence[Run]) -> list[dict[str, Any]]:
        return self._engine.rows([self.task(run, self._plan.step, aim.searching) for run in wanted])

    def _search(self, aim: Aim, turns: Sequence[Turn], shapes: Sequence[tuple[float, float]]) -> list[Steering | None]:
        """The best steering of each turn, of all shapes."""
        searches = [(*turn, shape) for turn in turns for shape in shapes]

        def run(wanted: Sequence[tuple[int, int]]) -> list[float | None]:
            runs = [(who, floor, place, shape) for (who, floor, shape), place in ((searches[k], p) for k, p in wanted)]
            return [aim.worth(row) for row in self._runs(aim, runs)]

        found: list[list[Steering]] = [[] for _ in turns]
        for number, tried in enumerate(search_steering(self._plan.search, len(searches), run)):
            if (place := best_place(tried)) is not None:
                worth = cast(float, tried[place])
                found[number // len(shapes)].append(Steering(place, searches[number][-1], worth))
        return [max(one, key=lambda steering: steering.worth, default=None) for one in found]

    def _steered(self, aim: Aim, turns: Sequence[Turn], shapes: Sequence[tuple[float, float]]) -> list[Steered]:
        """The best steering of each turn, proved at the fine step."""
        self._engine.stage = aim.words
        results = [Steered(found) for found in self._search(aim, turns, shapes)]
        self._engine.stage = f"{aim.words}, fine step"
        trying = {which: (*turns[which], *one.found[:2]) for which, one in enumerate(results) if one.found is not None}
        for _ in range(MOST_BACK + 1):
            coarse = dict(zip(trying, self._runs(aim, list(trying.values())), strict=True))
            tasks = {
                which: self.task(trying[which], self._plan.fine_step, aim.proving(row))
                for which, row in coarse.items()
                if aim.worth(row) is not None
            }
            for which, row in zip(tasks, self._engine.rows(list(tasks.values())), strict=True):
                if aim.proved(row):
                    results[which] = replace(results[which], proved=trying.pop(which)[2], row=row)
            trying = {k: (*run[:2], run[2] - STEP_BACK, run[3]) for k, run in trying.items() if run[2] >= STEP_BACK}
        return results

    def _fixed_places(self, aim: Aim, turns: Sequence[Turn]) -> dict[tuple[str, float, float], int]:
        """Least of the best amplitudes by candidate, speed and share, as places on the grid."""
        least: dict[tuple[str, float, float], int] = {}
        for (who, floor), one in zip(turns, self._steered(aim, turns, [ONE_LEVEL]), strict=True):
            key = (who.name, floor.speed, floor.share)
            if one.proved is not None:
                least[key] = min(one.proved, least.get(key, one.proved))
        return least

    def _fixed(
        self, aim: Aim, turns: Sequence[Turn], trained: Mapping[tuple[str, float, float], int]
    ) -> list[dict[str, float]]:
        """Columns of the runs with that steering at the fine step."""
        self._engine.stage = "fixed steering, fine step"
        places = [trained.get((who.name, floor.speed, floor.share)) for who, floor in turns]
        known = [(*turn, place, ONE_LEVEL) for turn, place in zip(turns, places, strict=True) if place is not None]
        rows = iter(self._engine.rows([self.task(run, self._plan.fine_step, aim.searching) for run in known]))
        columns = []
        for place in places:
            row = {} if place is None else next(rows)
            columns.append(
                {
                    "fixed_steering_deg": math.nan if place is None else self._degrees(place),
                    "fixed_course_change_rad": float(row["course_change_rad"]) if row and counts(row) else math.nan,
                }
            )
        return columns

    def _row(self, who: Candidate, floor: Floor, measured: Mapping[Aim, Steered]) -> dict[str, Any]:
        row: dict[str, Any] = {"candidate": who.name, "car": floor.member.name, "speed_m_per_s": floor.speed}
        row |= {"pulse_s": next(aim.pulse for aim in measured if aim.degrees is None)}
        row |= {"floor": floor.share, "critical_friction": floor.critical, "friction": floor.friction}
        for aim, steered in measured.items():
            suffix = "" if aim.degrees is None else f"_to_{aim.degrees}_deg"
            found, proved = steered.found, steered.proved
            row |= {
                f"steering_found{suffix}_deg": math.nan if found is None else self._degrees(found.place),
                f"steering{suffix}_deg": math.nan if proved is None else self._degrees(proved),
            }
            if len(self._plan.shapes) > 1:
                ratio, first = (math.nan, math.nan) if found is None else found.shape
                row |= {f"first_level{suffix}": ratio, f"first_level_time{suffix}_s": first}
            names = SHOWN if aim.degrees is None else (f"time_to_{aim.degrees}_deg_s",)
            row |= {name: _number(steered.row.get(name)) for name in names}
        return row

    def _degrees(self, place: int) -> float:
        return math.degrees(self._plan.search.angle(place))


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
