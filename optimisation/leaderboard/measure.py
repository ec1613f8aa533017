"""What is measured of each controller, and in which runs.

Survival means clean survival throughout: nothing but the wheels touches the ground. Critical friction is the highest
tyre friction so survived at a speed. A gain counts only with a heading change of at least 95 % of the 8 rad/s swing's,
compared at the highest friction that both survive (design section 10).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from optimisation.leaderboard.contestants import (
    FIXED_SPEEDS,
    THESIS,
    Contestant,
    fixed_speed,
    standard_contestants,
    trackings_of,
)
from optimisation.leaderboard.memory import CleanOnly, RememberingEngine
from optimisation.sweep.engine import Engine
from optimisation.sweep.store import make_frame
from optimisation.sweep.task import RunTask
from optimisation.sweep.threshold import FRICTION, SPEED, Case, Search, Threshold, find_thresholds
from optimisation.swing.full_car import LEAST_HEADING
from optimisation.swing.perturbations import perturbations
from workbench.ensemble import Member, weighted_quantiles
from workbench.scenario import load_scenario

SCENARIO = "turn_fast"
"""Its gentle start lets the same turn be driven at every speed."""
Key = tuple[str, str, float]
"""Controller, member, speed (m/s)."""

OUTCOMES = (
    "peak_roll_rad",
    "heading_change_rad",
    "average_yaw_rate_rad_per_s",
    "tail_energy_j",
    "tail_torque_peak_n_m",
)


ROUNDING = 1e-9
"""Of a gain."""
FRICTION_SEARCH = Search(FRICTION, 0.45, 1.15, 0.05, 0.01)
SPEED_SEARCH = Search(SPEED, 2.5, 7.0, 0.25, 0.05)


@dataclass(frozen=True)
class Plan:
    """How much is run.

    Attributes:
        speeds: of the turns, m/s; the middle one is also that of maps and robustness.
        friction: search of the critical friction.
        top_speed: search of the highest speed at the car's own friction.
        map_speeds, map_frictions: nodes of the survival map.
        step: of the plant, s.
        perturbed: whether the robustness is measured.
        fixed: roll rates tried for the best fixed speed, rad/s.
    """

    speeds: tuple[float, ...] = (3.6, 4.5, 6.0)
    friction: Search = FRICTION_SEARCH
    top_speed: Search = SPEED_SEARCH
    map_speeds: tuple[float, ...] = (3.0, 3.6, 4.5, 5.25, 6.0)
    map_frictions: tuple[float, ...] = tuple(round(0.5 + 0.05 * i, 2) for i in range(11))
    step: float = 0.002
    perturbed: bool = True
    fixed: tuple[float, ...] = FIXED_SPEEDS

    @property
    def middle_speed(self) -> float:
        """m/s."""
        return sorted(self.speeds)[len(self.speeds) // 2]


QUICK = Plan(
    speeds=(4.5,),
    friction=Search(FRICTION, 0.5, 1.1, 0.1, 0.035),
    top_speed=Search(SPEED, 3.0, 6.0, 1.0, 0.5),
    map_speeds=(3.6, 4.5, 6.0),
    map_frictions=(0.55, 0.7, 0.85),
    perturbed=False,
    fixed=(6.0,),
)
"""A look in minutes."""


@dataclass(frozen=True)
class Leaderboard:
    """Tables, one row each per controller and whatever else their columns name.

    Attributes:
        summary: one row per controller.
        frictions: critical friction by member and speed, with the heading compared at the common friction.
        runs: at each car's own friction, by member and speed.
        speeds: highest speed by member.
        map: outcome over speed and friction, on the best member.
        robustness: critical friction under perturbations, on the best member at the middle speed.
        contestants: in order.
    """

    summary: pd.DataFrame
    frictions: pd.DataFrame
    runs: pd.DataFrame
    speeds: pd.DataFrame
    map: pd.DataFrame
    robustness: pd.DataFrame
    contestants: tuple[Contestant, ...]


def measure(plan: Plan, swings: Sequence[str], members: Sequence[Member], engine: RememberingEngine) -> Leaderboard:
    """Runs everything.

    Args:
        plan: how much.
        swings: files or names.
        members: of the ensemble, the likeliest first; weights need not sum to 1.
        engine: that remembers.
    """
    board = _Measurer(plan, members, engine)
    contestants = standard_contestants(swings)
    contestants.insert(3, board.best_fixed_speed())
    frictions = board.critical_frictions(contestants)
    runs = board.own_friction(contestants)
    speeds = board.highest_speeds(contestants)
    survival = board.survival_map(contestants)
    players = [*contestants, *(way for swing in swings for way in trackings_of(swing))]
    robustness = board.robustness(players) if plan.perturbed else pd.DataFrame()
    summary = summarise_board(contestants, frictions, runs, speeds, robustness)
    return Leaderboard(summary, frictions, runs, speeds, survival, robustness, tuple(contestants))


class _Turned(NamedTuple):
    """Heading change, rad, and time on two wheels or fewer, s, of a clean run; NaN of another."""

    heading: float
    two_wheels: float


_NO_TURN = _Turned(math.nan, math.nan)


class _Measurer:
    def __init__(self, plan: Plan, members: Sequence[Member], engine: RememberingEngine) -> None:
        self._plan, self._members, self._engine = plan, list(members), engine
        self._clean: Engine = CleanOnly(engine)
        self._numerics = (f"simulation.step={plan.step!r}",)

    def _settings(self, contestant: Contestant, member: Member, speed: float | None = None) -> tuple[str, ...]:
        turn = () if speed is None else (f"{SPEED}={speed!r}",)
        return (*member.settings, *self._numerics, *contestant.settings, *turn)

    def best_fixed_speed(self) -> Contestant:
        """The roll rate with the highest mean critical friction over the speeds, on the best car."""
        self._engine.stage = "best fixed speed"
        rates = [rate for rate in self._plan.fixed for _ in self._plan.speeds]
        cases = [
            Case(f"{rate:g} rad/s", SCENARIO, self._settings(fixed_speed(rate), self._members[0], speed))
            for rate in self._plan.fixed
            for speed in self._plan.speeds
        ]
        found = find_thresholds(cases, self._plan.friction, self._clean)
        values = pd.Series([_survived(threshold) for threshold in found]).groupby(rates).mean()
        best = float(values.index[int(np.argmax(values.to_numpy()))])
        return fixed_speed(best, f"best fixed, {best:g} rad/s")

    def critical_frictions(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """By controller, member and speed, with heading change over the reference's at the common friction."""
        self._engine.stage = "critical friction"
        turns = [(c, m, v) for c in contestants for m in self._members for v in self._plan.speeds]
        keys = [(c.name, m.name, v) for c, m, v in turns]
        cases = [Case(c.name, SCENARIO, self._settings(c, m, v)) for c, m, v in turns]
        found = dict(zip(keys, find_thresholds(cases, self._plan.friction, self._clean), strict=True))
        common = {key: self._common_friction(found[key], found[(THESIS.name, *key[1:])]) for key in keys}
        headings = self._headings([turn for turn, key in zip(turns, keys, strict=True) if common[key]], common)
        rows = []
        for turn, key in zip(turns, keys, strict=True):
            own, reference = headings.get(key, (_NO_TURN, _NO_TURN))
            rows.append(
                _place(*turn)
                | {
                    "critical_friction": _survived(found[key]),
                    "first_not_survived": found[key].flipped,
                    "at_end_of_search": found[key].flipped is None,
                    "heading_ratio": own.heading / reference.heading,
                    "heading_at_friction": common[key],
                    "two_wheel_time_s": own.two_wheels,
                    "two_wheel_time_with_8_rad_per_s_s": reference.two_wheels,
                }
            )
        return make_frame(rows)

    def _headings(
        self, turns: Sequence[tuple[Contestant, Member, float]], frictions: Mapping[Key, float | None]
    ) -> dict[Key, tuple[_Turned, _Turned]]:
        """What the controller and the 8 rad/s swing turn at a friction."""
        self._engine.stage = "heading change"
        tasks = [
            RunTask(c.name, SCENARIO, (*self._settings(c, m, v), f"{FRICTION}={frictions[who.name, m.name, v]!r}"))
            for who, m, v in turns
            for c in (who, THESIS)
        ]
        turned = [
            _Turned(row["heading_change_rad"], row["two_wheel_time_s"]) if row["clean"] else _NO_TURN
            for row in self._engine.rows(tasks)
        ]
        pairs = zip(turned[::2], turned[1::2], strict=True)
        return {(c.name, m.name, v): pair for (c, m, v), pair in zip(turns, pairs, strict=True)}

    @staticmethod
    def _common_friction(one: Threshold, other: Threshold) -> float | None:
        """The highest friction that both were seen to survive."""
        alike = [value for value, outcome in one.outcomes.items() if outcome == "survived"]
        alike = [value for value in alike if other.outcomes.get(value) == "survived"]
        return max(alike, default=None)

    def own_friction(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """Runs at each car's own friction."""
        self._engine.stage = "own friction"
        keys = [(c, m, v) for c in contestants for m in self._members for v in self._plan.speeds]
        tasks = [RunTask(c.name, SCENARIO, self._settings(c, m, v)) for c, m, v in keys]
        rows = self._engine.rows(tasks)
        wanted = ("outcome", "clean", "error", *OUTCOMES)
        return make_frame([_place(*key) | {n: row.get(n) for n in wanted} for key, row in zip(keys, rows, strict=True)])

    def highest_speeds(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """By controller and member, at the car's own friction."""
        self._engine.stage = "highest speed"
        keys = [(c, m) for c in contestants for m in self._members]
        cases = [Case(c.name, SCENARIO, self._settings(c, m)) for c, m in keys]
        found = find_thresholds(cases, self._plan.top_speed, self._clean)
        rows = []
        for (c, m), threshold in zip(keys, found, strict=True):
            rows.append(
                {"controller": c.name, "member": m.name, "weight": m.weight}
                | {"highest_speed_m_per_s": threshold.survived, "at_end_of_search": threshold.flipped is None}
                | {"islands": threshold.as_row()["islands"]}
            )
        return make_frame(rows)

    def survival_map(self, contestants: Sequence[Contestant]) -> pd.DataFrame:
        """Outcome over speed and friction on the best car."""
        self._engine.stage = "survival map"
        best = self._members[0]
        keys = [(c, v, mu) for c in contestants for v in self._plan.map_speeds for mu in self._plan.map_frictions]
        tasks = [RunTask(c.name, SCENARIO, (*self._settings(c, best, v), f"{FRICTION}={mu!r}")) for c, v, mu in keys]
        rows = []
        for (c, v, mu), row in zip(keys, self._engine.rows(tasks), strict=True):
            rows.append(
                {"controller": c.name, "speed_m_per_s": v, "friction": mu, "outcome": row["outcome"]}
                | {"clean": row.get("clean"), "peak_roll_rad": row.get("peak_roll_rad"), "error": row["error"]}
            )
        return make_frame(rows)

    def robustness(self, players: Sequence[Contestant]) -> pd.DataFrame:
        """Critical friction on the best car at the middle speed, as planned and otherwise."""
        self._engine.stage = "robustness"
        best, speed = self._members[0], self._plan.middle_speed
        changes = [
            change
            for change in perturbations(load_scenario(SCENARIO, list(best.settings)))
            if not any(setting.startswith(FRICTION) for setting in change.settings)
        ]
        keys = [(player, change) for player in players for change in changes]
        cases = [Case(p.name, SCENARIO, (*self._settings(p, best, speed), *change.settings)) for p, change in keys]
        found = find_thresholds(cases, self._plan.friction, self._clean)
        return make_frame(
            [
                {"controller": p.name, "change": change.name, "speed_m_per_s": speed}
                | {"critical_friction": _survived(threshold)}
                for (p, change), threshold in zip(keys, found, strict=True)
            ]
        )


def _survived(threshold: Threshold) -> float:
    """Highest friction survived below the first flip; the low end of the search where not even that was."""
    return threshold.search.low if threshold.survived is None else threshold.survived


def _place(contestant: Contestant, member: Member, speed: float) -> dict[str, Any]:
    return {"controller": contestant.name, "member": member.name, "weight": member.weight, "speed_m_per_s": speed}


def summarise_board(
    contestants: Sequence[Contestant],
    frictions: pd.DataFrame,
    runs: pd.DataFrame,
    speeds: pd.DataFrame,
    robustness: pd.DataFrame,
) -> pd.DataFrame:
    """One row per controller: weighted medians over the ensemble, and how often it beats the others."""
    thesis = frictions[frictions["controller"] == THESIS.name]
    reference = dict(
        zip(zip(thesis["member"], thesis["speed_m_per_s"], strict=True), thesis["critical_friction"], strict=True)
    )
    rows = []
    for contestant in contestants:
        name = contestant.name
        own = frictions[frictions["controller"] == name]
        row: dict[str, Any] = {"controller": name}
        for speed, part in own.groupby("speed_m_per_s"):
            row[f"critical_friction_at_{speed:g}_m_per_s"] = _median(part["critical_friction"], part["weight"])
            there = runs[(runs["controller"] == name) & (runs["speed_m_per_s"] == speed)]
            row[f"rollover_probability_at_{speed:g}_m_per_s"] = _share(there["outcome"] == "flipped", there["weight"])
        baseline = [reference[turn] for turn in zip(own["member"], own["speed_m_per_s"], strict=True)]
        gain = own["critical_friction"].to_numpy() / np.array(baseline) - 1.0
        turns = own["heading_ratio"].to_numpy() >= LEAST_HEADING
        row["gain_over_8_rad_per_s"] = _median(gain, own["weight"])
        row["share_no_worse_than_8_rad_per_s"] = _share(gain >= -ROUNDING, own["weight"])
        row["heading_ratio_median"] = _median(own["heading_ratio"], own["weight"])
        row["share_heading_at_least_95_percent"] = _share(turns, own["weight"])
        row["share_faster_turn"] = _share(turns & (gain > ROUNDING), own["weight"])
        top = speeds[speeds["controller"] == name]
        row["highest_speed_m_per_s"] = _median(top["highest_speed_m_per_s"], top["weight"])
        mine = runs[(runs["controller"] == name) & runs["clean"].fillna(False).astype(bool)]
        for column in OUTCOMES:
            row[f"median_{column}"] = _median(mine[column], mine["weight"]) if len(mine) else float("nan")
        if len(robustness):
            found = robustness[robustness["controller"] == name]["critical_friction"]
            row["worst_critical_friction_perturbed"] = float(found.min())
        rows.append(row)
    return make_frame(rows)


def _median(values: Any, weights: Any) -> float:
    return float(weighted_quantiles(np.asarray(values, float), np.asarray(weights, float), [0.5])[0])


def _share(condition: Any, weights: Any) -> float:
    chosen, weight = np.asarray(condition, bool), np.asarray(weights, float)
    return float(weight[chosen].sum() / weight.sum())
