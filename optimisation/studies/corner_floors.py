"""Floors of the corner study: multiples of the critical friction of the published swing at full lock, car by car."""

from __future__ import annotations

from collections.abc import Sequence

from aerodima.optimisation.studies.candidates import THESIS, Candidate
from aerodima.optimisation.studies.corner_plan import CornerPlan, Floor
from aerodima.optimisation.sweep.rollover_threshold import SPEED, Case, find_thresholds
from aerodima.optimisation.sweep.study_engine import RunEngine
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError


def find_floors(plan: CornerPlan, members: Sequence[Member], engine: RunEngine) -> tuple[list[Floor], list[str]]:
    """Floors of cars, speeds and shares, and the cars and speeds that have none.

    Raises:
        UserError: none has a floor.
    """
    keys = [(member, speed) for member in members for speed in plan.speeds]
    floors, without = [], []
    for (member, speed), critical in zip(
        keys, critical_frictions(plan, [(THESIS, *key) for key in keys], engine), strict=True
    ):
        if critical is None:
            without.append(f"{member.name} at {speed:g} m/s")
        else:
            floors += [Floor(member, speed, share, critical) for share in plan.floors]
    if members and not floors:
        raise SweepError(f"{', '.join(without)}: the published swing at full lock is clean on no floor")
    return floors, without


def critical_frictions(
    plan: CornerPlan, wanted: Sequence[tuple[Candidate, Member, float]], engine: RunEngine
) -> list[float | None]:
    """Critical friction at full lock of candidates, cars and speeds (m/s); None: the car is clean on no floor."""
    cases = [Case(who.name, plan.scenario, turn_settings(plan.scenario, who, m, v, plan.step)) for who, m, v in wanted]
    starts = [load_scenario(plan.scenario, m.settings_on(plan.scenario)).car.tyre_friction for _, m, _ in wanted]
    return [one.survived for one in find_thresholds(cases, plan.friction, engine, starts=starts)]


def turn_settings(scenario: str, who: Candidate, member: Member, speed: float, step: float) -> tuple[str, ...]:
    """Settings of a candidate's turns with a car at a speed (m/s) and a step of the plant (s), but for the floor."""
    own = member.settings_on(scenario)
    ballast = () if who.ballast is None else who.ballast(load_scenario(scenario, own))
    numerics = (f"simulation.step={step!r}", f"simulation.log_rate={min(500.0, 1.0 / step):g}")
    return (*own, *numerics, *who.at(speed), *ballast, f"{SPEED}={speed!r}")
