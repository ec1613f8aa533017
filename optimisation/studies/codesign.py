"""Tail and law designed together, within a budget of mass, and what that gains over the tail of the thesis.

Searched on reduced training cars (`tail_family`, `law_training`), one budget after the other from the lightest on, each
search with the finds of those before; the finalists of all of them turn the full training cars, and for each budget the
best one that it allows is the design. Judged as in the corner study: nominal car and unseen ones, every contestant with
its own best steering, at the fine step, on floors that the published swing of the thesis' tail sets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.calibration.identifiability import sobol_table
from aerodima.optimisation.studies.contestants import NO_TAIL, THESIS, Contestant, raised_gearbox
from aerodima.optimisation.studies.corner_floors import critical_frictions
from aerodima.optimisation.studies.corner_plan import CornerPlan, Floor
from aerodima.optimisation.studies.corner_result import Corner
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.law_search import APART
from aerodima.optimisation.studies.law_training import TRAINED, Screening, course_table, score, screened_finalists
from aerodima.optimisation.studies.tail_family import (
    TailFamily,
    areal_mass,
    family_of,
    limits_broken,
    scenario_with,
)
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine
from aerodima.optimisation.swing.tail_design import swing_demand
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError
from aerodima.workbench.plants.tail import tail_geometry
from aerodima.workbench.plants.tail_geometry import TailGeometry

OWN_LAW = "thesis' tail, trained law"
GEARBOX = "no tail, gearbox moved as for"
MOUNTS = (-0.10, -0.05, 0.0, 0.065, 0.13, 0.195, 0.26)
"""Of the tail's joints ahead of the rear axle, m: from before the anti-ramp board to the front axle."""
MOST_REDUCED = math.radians(12.0)
"""Largest amplitude that reduced cars try, about twice what any contestant has been found to steer best with."""
BOARD_MARGIN = 0.005
"""Over the ground, m, of a reduced car's anti-ramp board in a turn that counts: on other cars it may come lower."""
AROUND = 0.1
"""Sensitivities: every number moves by this share of its range to either side of the design's."""


@dataclass(frozen=True)
class CodesignPlan:
    """How much is done.

    Attributes:
        corner: scenario with the thesis' tail, speed, floors of the training cars, search.
        budgets: masses of rod and sail, kg; infinite: what the motors bear.
        judged: floors of the nominal and the unseen cars.
        samples: of the Sobol indices, a power of two; 0 leaves them out.
        mounts: places of the tail's joints that are compared, m; none leaves them out.
        first: tails with their laws, by `TailFamily` numbers, that every search begins with.

    Raises:
        UserError: no budget, one that nothing fits, or as heavy as the car; more than one speed; a mount off the car.
    """

    corner: CornerPlan
    budgets: tuple[float, ...] = (0.15, 0.3, math.inf)
    judged: tuple[float, ...] = (1.1, 1.3)
    samples: int = 64
    mounts: tuple[float, ...] = MOUNTS
    first: tuple[Mapping[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not self.budgets or len(self.corner.speeds) != 1:
            given = f"{len(self.budgets)} budgets, {len(self.corner.speeds)} speeds"
            raise SweepError(f"co-design: {given}; allowed: at least one budget and one speed")
        replace(self.corner, floors=self.judged)  # refuses what the judging would
        if self.samples and (self.samples < 2 or self.samples & (self.samples - 1)):
            raise SweepError(f"{self.samples} samples: allowed: 0, or a power of two from 2 on")
        car = load_scenario(self.corner.scenario).car
        for budget in self.budgets:
            family_of("", self.corner.scenario, budget)
            if car.mass <= budget < math.inf:
                raise SweepError(f"budget {budget:g} kg: allowed: less than the car, {car.mass:g} kg, or free")
        for mount in self.mounts:
            if not abs(mount) <= (most := 2.0 * car.wheelbase):
                raise SweepError(f"mount {mount:g} m ahead of the rear axle: allowed: {-most:g} to {most:g} m")


@dataclass(frozen=True)
class Design:
    """One tail with its law.

    Attributes:
        name: of its budget.
        law: numbers by name.
        contestant: that has them.
        geometry: on the nominal car.
        settings: of a turn of the nominal car with them.
    """

    name: str
    law: Mapping[str, float]
    contestant: Contestant
    geometry: TailGeometry
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Codesign:
    """What was found.

    Attributes:
        designs: of each budget, from the lightest on.
        tried: a row per tail on the reduced training cars: mass and what it is worth, with its numbers.
        finalists: a row per tail on the full training cars.
        corner: contestants on the nominal car, which is the first, and the unseen ones.
        critical: critical friction at full lock on the nominal car, by contestant.
        mounts: a row per tail and place of its joints; empty without.
        sensitivities: Sobol indices of the course (`sobol_table`); empty without.
        tail_of_thesis: that of the scenario.
        law_of_thesis: the trained law of the thesis' tail, by `LawFamily` numbers, on the training cars.
    """

    designs: tuple[Design, ...]
    tried: pd.DataFrame
    finalists: pd.DataFrame
    corner: Corner
    critical: pd.DataFrame
    mounts: pd.DataFrame
    sensitivities: pd.DataFrame
    tail_of_thesis: TailGeometry
    law_of_thesis: pd.DataFrame


def measure_codesign(
    plan: CodesignPlan, nominal: Member, test: Sequence[Member], training: Sequence[Member], engine: RememberingEngine
) -> Codesign:
    """Searches, judges, and asks what the mount and each number are worth.

    Args:
        nominal: car whose scenario says what a tail may be.
        test: unseen cars.
        training: cars that tails and laws are looked for on.

    Raises:
        UserError: no tail of a budget keeps the limits; no car has a floor.
    """
    runs = CornerRuns(plan.corner, engine)
    floors = runs.floors(training)
    designs, tried, finalists = find_designs(plan, runs, floors, engine)
    thesis, laws = runs.trained(replace(TRAINED, name=OWN_LAW), training)
    last = designs[-2:][0]
    height = partial(raised_gearbox, mount_height=last.law["tail.mount_height"])
    lowered = Contestant(f"{GEARBOX} {last.name}", NO_TAIL.settings, ballast=height)
    judging = CornerRuns(replace(plan.corner, floors=plan.judged), engine)
    chosen: dict[str, Contestant] = {"none": NO_TAIL, "published": THESIS}
    own = [thesis, *(design.contestant for design in designs), lowered]
    corner = judging.measure(chosen, own, [nominal, *test], training)
    speed = plan.corner.speeds[0]
    engine.stage = "critical friction"
    found = critical_frictions(plan.corner, [(who, nominal, speed) for who in corner.contestants], engine)
    names = [who.name for who in corner.contestants]
    own_floor = judging.floors([nominal])[-1]
    return Codesign(
        designs,
        tried,
        finalists,
        corner,
        pd.DataFrame({"contestant": names, "critical_friction": np.array(found, float)}),
        _mounts(plan, judging, own_floor, [THESIS, thesis, last.contestant], engine),
        _sensitivities(plan, _reduced(judging, [own_floor]), last.law, engine),
        tail_geometry(load_scenario(plan.corner.scenario).tail),
        laws,
    )


def find_designs(
    plan: CodesignPlan, runs: CornerRuns, floors: Sequence[Floor], engine: RememberingEngine
) -> tuple[tuple[Design, ...], pd.DataFrame, pd.DataFrame]:
    """Designs, and the tables `tried` and `finalists` of `Codesign`."""
    scenario, cases = plan.corner.scenario, _reduced(runs, floors)
    tried: list[dict[str, Any]] = []
    finals: list[tuple[str, Mapping[str, float]]] = []
    for budget in sorted(set(plan.budgets)):
        name = budget_name(budget)
        family = replace(family_of(name, scenario, budget), first=(*plan.first, *(law for _, law in finals)))
        found = screened_finalists(family, plan.corner.training, cases, engine)
        tried += [
            {"budget": name, "worth": worth, **law} for law, worth in zip(found.laws, found.worth.tolist(), strict=True)
        ]
        finals += [(name, law) for law in found.finalists if _differs(family, law, [other for _, other in finals])]
        if not finals:
            raise SweepError(
                f"{name}: none of the tails tried keeps the limits of its car; allowed: more mass, more candidates"
            )
    free = family_of("", scenario)
    engine.stage = "finalists"
    courses = runs.courses([THESIS, *(free.contender(name, law) for name, law in finals)], floors)
    worth = score(courses[1:], courses[0], cases.cars)
    masses = np.array([law["tail.mass"] for _, law in finals])
    designs: list[Design] = []
    winners: dict[int, list[str]] = {}
    for budget in sorted(set(plan.budgets)):
        best = int(np.argmax(np.where(masses <= budget, worth, -np.inf)))
        winners.setdefault(best, []).append(budget_name(budget))
        designs.append(_design(f"design {budget_name(budget)}", scenario, free, finals[best][1]))
    rows = [
        {"searched_for": name, "chosen_for": ", ".join(winners.get(place, [])), "worth": worth[place]}
        | {"median_course_rad": float(np.median(courses[place + 1])), **_facts(plan, law)}
        for place, (name, law) in enumerate(finals)
    ]
    return tuple(designs), make_frame(tried), make_frame(rows)


def _reduced(runs: CornerRuns, floors: Sequence[Floor]) -> Screening:
    cases = runs.reduced_cases(floors)
    return replace(cases, steering=replace(cases.steering, high=MOST_REDUCED), board_margin=BOARD_MARGIN)


def _design(name: str, scenario: str, family: TailFamily, law: Mapping[str, float]) -> Design:
    own = family.settings(law)
    own += raised_gearbox(load_scenario(scenario, own), law["tail.mount_height"])
    geometry = tail_geometry(load_scenario(scenario, own).tail)
    return Design(name, law, family.contender(name, law), geometry, own)


def budget_name(budget: float) -> str:
    """`300 g`, or `free`."""
    return f"{1000.0 * budget:g} g" if math.isfinite(budget) else "free"


def _differs(family: TailFamily, law: Mapping[str, float], others: Sequence[Mapping[str, float]]) -> bool:
    own = family.shares(law)
    return all(np.max(np.abs(own - family.shares(other))) >= APART for other in others)


def _facts(plan: CodesignPlan, law: Mapping[str, float]) -> dict[str, float]:
    """Numbers of a tail with its law, and what it asks on the nominal car; SI units."""
    scenario = plan.corner.scenario
    made = scenario_with(scenario, family_of("", scenario).settings(law), law["tail.mount_height"])
    demand = swing_demand(made, tail_geometry(made.tail))
    names = ("inertia", "weight_torque", "peak_torque", "rms_torque", "overload")
    area = law["tail.sail_length"] * law["tail.sail_width"]
    return {**law, "area": area, "areal_mass": areal_mass(law), **{name: getattr(demand, name) for name in names}}


def _mounts(
    plan: CodesignPlan, runs: CornerRuns, floor: Floor, drivers: Sequence[Contestant], engine: RememberingEngine
) -> pd.DataFrame:
    """Course, heading, yaw impulses and critical friction of tails over the place of their joints, at 2 ms."""
    keys = [(who, x) for who in drivers for x in plan.mounts]
    placed = [
        replace(who, name=f"{who.name} at {x:+g} m", settings=(*who.settings, f"tail.mount_x={x!r}")) for who, x in keys
    ]
    rows = runs.best_runs([(who, floor) for who in placed], "mount")
    critical = critical_frictions(plan.corner, [(who, floor.member, floor.speed) for who in placed], engine)
    own = floor.member.settings_on(plan.corner.scenario)
    table = []
    for (who, x), moved, row, friction in zip(keys, placed, rows, critical, strict=True):
        settings = (*own, *moved.at(floor.speed))
        height = () if who.ballast is None else who.ballast(load_scenario(plan.corner.scenario, own))
        broken = limits_broken(load_scenario(plan.corner.scenario, (*settings, *height)))
        table.append(
            {"tail": who.name, "mount_x_m": x, "critical_friction": friction, "not_allowed": "; ".join(broken)}
            | {name: row.get(name) for name in MOUNT_COLUMNS}
        )
    return make_frame(table) if table else pd.DataFrame()


MOUNT_COLUMNS = (
    *("course_change_rad", "exit_heading_change_rad", "peak_roll_rad", "exit_time_s"),
    *("aerodynamic_yaw_impulse_window_n_m_s", "inertial_yaw_impulse_window_n_m_s"),
)
"""Of a turn with its best steering."""


def _sensitivities(
    plan: CodesignPlan, cases: Screening, law: Mapping[str, float], engine: RememberingEngine
) -> pd.DataFrame:
    """Sobol indices of the course of a reduced car, with its best steering, around a tail with its law."""
    if not plan.samples:
        return pd.DataFrame()
    family = family_of("sensitivities", plan.corner.scenario)
    middle = np.clip(family.shares(law), AROUND, 1.0 - AROUND)
    own = replace(cases, fixed=family.fixed)
    engine.say(f"sensitivities: {plan.samples * (len(middle) + 2)} tails on reduced cars")

    def courses(points: FloatArray) -> FloatArray:
        laws = family.laws((middle[:, None] + AROUND * (2.0 * points - 1.0)).T)
        return course_table(own, laws, engine).T

    return sobol_table(courses, ["course"], list(family.ranges), plan.samples, plan.corner.training.seed)
