"""What is measured of each controller, and in which runs.

Survival means clean survival throughout: nothing but the wheels touches the ground. Critical friction is the highest
tyre friction of an unbroken row that is so survived at a speed (a climb). A gain counts only with a heading change of
at least 95 % of the 8 rad/s swing's, compared at the highest friction that both survive (design section 10). On the
car of the parameter files it is confirmed at the fine step (`claims`); the ensemble is driven at the ordinary one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from aerodima.optimisation.studies.contestants import (
    FIRST_SPEED,
    SWINGING,
    THESIS,
    Contestant,
    Plan,
    best_fixed,
    fixed_law,
    perturbations,
)
from aerodima.optimisation.sweep.rollover_threshold import (
    FRICTION,
    SPEED,
    Case,
    Search,
    Threshold,
    find_thresholds,
    is_clean,
)
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunTask
from aerodima.optimisation.swing.full_car import SPIN
from aerodima.optimisation.swing.verification import both_clean
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING

SCENARIO = "turn_fast"
NOMINAL_CAR = Member("nominal car", 0.0, {})
"""The car of the parameter files, which the swings were made for; not one of the ensemble."""
MOST_LOWER = 4
"""Where headings do not compare at the highest common friction, so many steps of the grid below it are looked at."""
OUTCOMES = (
    "peak_roll_rad",
    "heading_change_rad",
    "average_yaw_rate_rad_per_s",
    "tail_energy_j",
    "tail_torque_peak_n_m",
)


@dataclass(frozen=True)
class Leaderboard:
    """Tables, one row each per controller and whatever else their columns name.

    Attributes:
        claims: on the nominal car at the fine step, by speed: what may be claimed.
        frictions: critical friction by member and speed, with the heading compared at the common friction.
        runs: at each car's own friction, by member and speed.
        speeds: highest speed on the nominal car.
        map: outcome over speed and friction, on the nominal car.
        robustness: critical friction under perturbations, on the nominal car at the middle speed, of the best swing in
            every way that it can be tracked.
        contestants: in order.
    """

    claims: pd.DataFrame
    frictions: pd.DataFrame
    runs: pd.DataFrame
    speeds: pd.DataFrame
    map: pd.DataFrame
    robustness: pd.DataFrame
    contestants: tuple[Contestant, ...]


class Measurer:
    """Runs what the plan asks for, table by table."""

    def __init__(self, plan: Plan, members: Sequence[Member], engine: RememberingEngine) -> None:
        self._plan, self._members, self._engine = plan, [NOMINAL_CAR, *members], engine

    def _settings(
        self, contestant: Contestant, member: Member, speed: float, step: float | None = None
    ) -> tuple[str, ...]:
        step = step or self._plan.step
        numerics = (f"simulation.step={step!r}", f"simulation.log_rate={min(500.0, 1.0 / step):g}")
        return (*member.settings, *numerics, *contestant.at(speed), f"{SPEED}={speed!r}")

    def _own_friction(self, member: Member) -> float:
        return load_scenario(SCENARIO, member.settings).car.tyre_friction

    def best_fixed_speed(self) -> Contestant:
        """By speed the roll rate and release of the highest critical friction that keep to the heading rule."""
        self._engine.stage = "best fixed speed"
        plan, chosen = self._plan, {}
        reference = self._climbs([(THESIS, NOMINAL_CAR, speed) for speed in plan.speeds])
        for speed, reached in zip(plan.speeds, reference, strict=True):
            common = reached.survived
            choices = [(rate, release) for rate in plan.fixed for release in plan.releases]
            laws = [Contestant("", (*SWINGING, *fixed_law(*choice))) for choice in choices]
            if common is None:
                chosen[speed] = choices[0]
                continue
            first = self._runs([(law, NOMINAL_CAR, speed, common) for law in laws], plan.step)
            least = LEAST_HEADING * reached.rows[common]["heading_change_rad"]
            turning = [k for k, row in enumerate(first) if is_clean(row) and row["heading_change_rad"] >= least]
            starts = [common] * len(turning)
            found = self._climbs([(laws[k], NOMINAL_CAR, speed) for k in turning], starts)
            values = {choices[k]: one.survived or 0.0 for k, one in zip(turning, found, strict=True)}
            chosen[speed] = max(values, key=lambda choice: values[choice], default=(8.0, 1.0))
        return best_fixed(chosen)

    def claims(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """By controller and speed on the nominal car at the fine step."""
        self._engine.stage = "claims at the fine step"
        plan = self._plan
        turns = [(c, NOMINAL_CAR, v) for c in contestants for v in plan.speeds if c.made_for(v)]
        coarse = self._climbs(turns)
        at = {(c.name, v): one for (c, _, v), one in zip(turns, coarse, strict=True)}
        thesis = [(THESIS, NOMINAL_CAR, v) for v in plan.speeds]
        starts = [at[THESIS.name, v].survived or plan.friction.low for v in plan.speeds]
        fine = dict(zip(plan.speeds, self._climbs(thesis, starts, plan.near), strict=True))
        found: dict[int, Threshold] = {}
        for how in (plan.near, plan.fine):
            places, begin = [], []
            for place, ((_, _, v), one) in enumerate(zip(turns, coarse, strict=True)):
                reference, here = fine[v].survived or plan.friction.low, one.survived or plan.friction.low
                beyond = here > reference + plan.friction.tolerance
                if beyond == (how is plan.fine):
                    places.append(place)
                    begin.append(reference if beyond else here)
            found |= dict(zip(places, self._climbs([turns[k] for k in places], begin, how), strict=True))
        rows = self._compared(turns, [found[place] for place in range(len(turns))], plan.fine_step)
        for row, one, (_, _, speed) in zip(rows, coarse, turns, strict=True):
            row["critical_friction_at_the_ordinary_step"] = _number(one.survived)
            row["step_s"] = plan.fine_step
            row["gain_over_8_rad_per_s"] = _gain(row["critical_friction"], fine[speed].survived)
        return make_frame(rows)

    def critical_frictions(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """By controller, member and speed, with heading change over the reference's at the common friction."""
        self._engine.stage = "critical friction"
        speeds = self._plan.speeds
        turns = [(c, m, v) for m in self._members for v in speeds for c in contestants if c.made_for(v)]
        return make_frame(self._compared(turns, self._climbs(turns), self._plan.step))

    def _climbs(
        self,
        turns: Sequence[tuple[Contestant, Member, float]],
        starts: Sequence[float] | None = None,
        fine: Search | None = None,
    ) -> list[Threshold]:
        """At the ordinary step from each car's own friction on; `fine` is a climb at the fine step."""
        plan = self._plan
        step, how = (plan.step, plan.friction) if fine is None else (plan.fine_step, fine)
        cases = [Case(c.name, SCENARIO, self._settings(c, m, v, step)) for c, m, v in turns]
        begin = [self._own_friction(m) for _, m, _ in turns] if starts is None else starts
        return find_thresholds(cases, how, self._engine, starts=begin)

    def _runs(self, turns: Sequence[tuple[Contestant, Member, float, float]], step: float) -> list[dict[str, Any]]:
        """Rows of runs at frictions."""
        tasks = [
            RunTask(c.name, SCENARIO, (*self._settings(c, m, v, step), f"{FRICTION}={mu!r}")) for c, m, v, mu in turns
        ]
        return self._engine.rows(tasks)

    def _compared(
        self, turns: Sequence[tuple[Contestant, Member, float]], found: Sequence[Threshold], step: float
    ) -> list[dict[str, Any]]:
        """Rows of a table of critical frictions, with the heading over the reference's."""
        reached = {(c.name, m.name, v): one for (c, m, v), one in zip(turns, found, strict=True)}
        rows = []
        for (c, m, v), one in zip(turns, found, strict=True):
            reference = reached[THESIS.name, m.name, v]
            own, other, friction = self._headings(c, m, v, one, reference, step)
            row = {"controller": c.name, "member": m.name, "weight": m.weight, "speed_m_per_s": v}
            row |= {
                "critical_friction": _number(one.survived),
                "first_not_survived": _number(one.lost),
                "tipped_before_turn": one.tipped > 0,
                "gain_over_8_rad_per_s": _gain(one.survived, reference.survived),
                "heading_ratio": own.get("heading_change_rad", math.nan) / other.get("heading_change_rad", math.nan),
                "heading_at_friction": friction,
                "spins_with_8_rad_per_s": bool(other.get("heading_change_rad", 0.0) > SPIN),
                "two_wheel_time_s": own.get("two_wheel_time_s", math.nan),
                "two_wheel_time_with_8_rad_per_s_s": other.get("two_wheel_time_s", math.nan),
            }
            edge = {} if one.survived is None else one.rows[one.survived]
            row |= {f"{name}_at_critical": edge.get(name, math.nan) for name in OUTCOMES}
            rows.append(row)
        return rows

    def _headings(
        self, contestant: Contestant, member: Member, speed: float, one: Threshold, reference: Threshold, step: float
    ) -> tuple[dict[str, Any], dict[str, Any], float]:
        """Both runs at the highest friction that both survive clean, and that friction; NaN without one."""
        if one.survived is None or reference.survived is None:
            return {}, {}, math.nan
        grid, common = self._plan.friction.tolerance, min(one.survived, reference.survived)
        return both_clean(
            lambda friction: self._runs([(c, member, speed, friction) for c in (contestant, THESIS)], step),
            (float(f"{common - lower * grid:.9g}") for lower in range(MOST_LOWER + 1)),
        )

    def own_friction(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """Runs at each car's own friction."""
        self._engine.stage = "own friction"
        speeds = self._plan.speeds
        keys = [(c, m, v) for m in self._members for c in contestants for v in speeds if c.made_for(v)]
        rows = self._runs([(c, m, v, self._own_friction(m)) for c, m, v in keys], self._plan.step)
        wanted = ("outcome", "clean", "error", *OUTCOMES)
        return make_frame(
            [
                {"controller": c.name, "member": m.name, "weight": m.weight, "speed_m_per_s": v}
                | {name: row.get(name) for name in wanted}
                for (c, m, v), row in zip(keys, rows, strict=True)
            ]
        )

    def highest_speeds(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """By controller on the nominal car, at `grip` times its friction, with the swings for the middle speed."""
        self._engine.stage = "highest speed"
        plan = self._plan
        friction = float(f"{plan.grip * self._own_friction(NOMINAL_CAR):.4g}")
        cases = []
        for c in contestants:
            settings = [s for s in self._settings(c, NOMINAL_CAR, plan.middle_speed) if not s.startswith(f"{SPEED}=")]
            cases.append(Case(c.name, SCENARIO, (*settings, f"{FRICTION}={friction!r}")))
        found = find_thresholds(cases, plan.top_speed, self._engine, starts=[FIRST_SPEED] * len(cases))
        return make_frame(
            [
                {"controller": c.name, "member": NOMINAL_CAR.name, "weight": NOMINAL_CAR.weight, "friction": friction}
                | {"highest_speed_m_per_s": _number(one.survived), "at_end_of_search": one.lost is None}
                for c, one in zip(contestants, found, strict=True)
            ]
        )

    def survival_map(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """Outcome over speed and friction on the nominal car."""
        self._engine.stage = "survival map"
        climbing = self._plan.friction
        first, stride = climbing.index(self._own_friction(NOMINAL_CAR)), round(climbing.scan / climbing.tolerance)
        frictions = [climbing.value(first + count * stride) for count in self._plan.map_strides]
        keys = [(c, NOMINAL_CAR, v, mu) for c in contestants for v in self._plan.map_speeds for mu in frictions]
        wanted = ("outcome", "clean", "peak_roll_rad", "error")
        return make_frame(
            [
                {"controller": c.name, "speed_m_per_s": v, "friction": mu} | {name: row.get(name) for name in wanted}
                for (c, _, v, mu), row in zip(keys, self._runs(keys, self._plan.step), strict=True)
            ]
        )

    def robustness(self, players: Sequence[Contestant]) -> pd.DataFrame:
        """Critical friction on the nominal car at the middle speed, as planned and otherwise."""
        self._engine.stage = "robustness"
        speed = self._plan.middle_speed
        changes = [
            change
            for change in perturbations(load_scenario(SCENARIO))
            if not any(setting.startswith(FRICTION) for setting in change.settings)
        ]
        keys = [(player, change) for player in players for change in changes]
        cases = [
            Case(p.name, SCENARIO, (*self._settings(p, NOMINAL_CAR, speed), *change.settings)) for p, change in keys
        ]
        planned = self._climbs([(player, NOMINAL_CAR, speed) for player in players])
        starts = [one.survived or self._plan.friction.low for one in planned for _ in changes]
        found = find_thresholds(cases, self._plan.robust, self._engine, starts=starts)
        return make_frame(
            [
                {"controller": p.name, "change": change.name, "speed_m_per_s": speed}
                | {"critical_friction": _number(one.survived)}
                for (p, change), one in zip(keys, found, strict=True)
            ]
        )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _gain(value: float | None, reference: float | None) -> float:
    return math.nan if value is None or reference is None else value / reference - 1.0
