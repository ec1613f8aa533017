"""From cars to a swing file: floors from the full car, programme from several starts, and the full car as the judge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from aerodima.optimisation.corner.corner_programme import FEASIBLE, CornerProgramme, JointSolution, best_of
from aerodima.optimisation.corner.turn_shooting import TurnShooting
from aerodima.optimisation.studies.candidates import FRICTION_CLIMB, SWINGING, THESIS, fixed_law
from aerodima.optimisation.studies.corner_plan import AFTER, PULSE
from aerodima.optimisation.studies.steering_search import SteeringSearch
from aerodima.optimisation.sweep.rollover_threshold import Case, find_thresholds
from aerodima.optimisation.sweep.study_engine import RunEngine
from aerodima.optimisation.swing.full_car import FINE_STEP, drive
from aerodima.optimisation.swing.swing_construction import steered_swing
from aerodima.workbench.batch.worker_record import ProgressLine, silent
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.errors import SwingError
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.turn_course import turn_course

FASTEST_TICK = 0.005
"""Longest step of the reduced cars, s; the controller's ticks must be whole steps."""


@dataclass(frozen=True)
class CornerOptions:
    """How a turn is searched.

    Attributes:
        floor: friction of each car's floor over the critical friction of the published swing at full lock there.
        starts: random ones; `seed` of them.
        knots: of the tail's rate, the first and the last included; `length` of the swing, s.
        iterations: most quadratic programmes from a start.
        step: of the full car that judges, s.
    """

    floor: float = 1.3
    starts: int = 7
    seed: int = 1
    knots: int = 11
    length: float = 0.8
    iterations: int = 60
    step: float = FINE_STEP

    def __post_init__(self) -> None:
        allowed = {
            "floor": (self.floor, 0.2 <= self.floor <= 3.0, "0.2 to 3"),
            "starts": (self.starts, self.starts >= 1, "at least 1"),
            "knots": (self.knots, 4 <= self.knots <= 41, "4 to 41"),
            "length": (self.length, 0.2 <= self.length <= 1.2, "0.2 to 1.2 s"),
            "iterations": (self.iterations, self.iterations >= 1, "at least 1"),
        }
        for name, (value, good, words) in allowed.items():
            if not good:
                raise SwingError(f"{name}: {value:g}; allowed: {words}")


@dataclass(frozen=True)
class CarTurn:
    """A car of the programme on its floor.

    Attributes:
        name: of the car.
        settings: overrides that make it.
        scenario: with its floor.
    """

    name: str
    settings: tuple[str, ...]
    scenario: Scenario


def find_turn(
    name: str, scenario: str, cars: Sequence[tuple[str, tuple[str, ...]]], options: CornerOptions, engine: RunEngine,
    *, progress: ProgressLine = silent,
) -> SwingFile:  # fmt: skip
    """The swing with which the cars turn furthest, each with its own steering.

    Args:
        name: of the swing.
        scenario: of the turn, its tail is the one that swings.
        cars: names, and overrides of the scenario that make them; the file is for the first one.
        options: how it is searched.
        engine: where the full car is driven for its critical friction.
        progress: told lines.

    Raises:
        UserError: what the reduced car does not know, no floor, no turn that keeps all limits.
    """
    turns = on_floors(scenario, cars, options, engine)
    progress(", ".join(f"{turn.name}: friction {turn.scenario.car.tyre_friction:g}" for turn in turns))
    shooting = shooting_of([turn.scenario for turn in turns], options)
    solutions = []
    for number in range(options.starts):
        start = shooting.random_start(np.random.default_rng([options.seed, number]))
        solutions.append(CornerProgramme(shooting).solve(start, options.iterations))
        progress(_words(number, solutions[-1]))
    best = best_of(solutions)
    if best.violation > FEASIBLE:
        raise SwingError(f"no start came to a turn that keeps its limits; nearest: {best.worst}")
    return swing_of(name, scenario, turns, shooting, solutions, options)


def shooting_of(turns: Sequence[Scenario], options: CornerOptions) -> TurnShooting:
    """The reduced cars of turns; UserError for what they do not know."""
    search = SteeringSearch()
    _refuse_tailless(turns)
    rate = turns[0].controller.rate
    length = 1.0 / (rate * math.ceil(1.0 / (rate * FASTEST_TICK) - 1e-9))
    high = min(search.high, *(turn.servo.limit for turn in turns))
    interval = options.length / (options.knots - 1)
    return TurnShooting.of(turns, options.knots - 2, interval, (search.low, high), length)


def on_floors(
    scenario: str, cars: Sequence[tuple[str, tuple[str, ...]]], options: CornerOptions, engine: RunEngine
) -> list[CarTurn]:
    """The cars on their floors, which the full car with the published swing at full lock sets.

    Raises:
        SwingError: it is clean on none.
    """
    law = (*SWINGING, *fixed_law(8.0))
    given = [load_scenario(scenario, settings) for _, settings in cars]
    _refuse_tailless(given)
    cases = [Case(THESIS.name, scenario, (*settings, *law)) for _, settings in cars]
    starts = [turn.car.tyre_friction for turn in given]
    turns = []
    found = find_thresholds(cases, FRICTION_CLIMB, engine, starts=starts)
    for (name, settings), turn, one in zip(cars, given, found, strict=True):
        if one.survived is None:
            raise SwingError(
                f"{name}: the published swing at full lock is clean on no floor from {one.search.low:g} on"
            )
        friction = float(f"{options.floor * one.survived:.6g}")
        manoeuvre = {"turn_hold": PULSE, "duration": turn.manoeuvre.turn_start + PULSE + AFTER}
        on_floor = turn.varied(car={"tyre_friction": friction}, manoeuvre=manoeuvre)
        turns.append(CarTurn(name, (*settings, f"car.tyre_friction={friction!r}"), on_floor))
    return turns


def swing_of(
    name: str, scenario: str, turns: Sequence[CarTurn], shooting: TurnShooting, solutions: list[JointSolution],
    options: CornerOptions,
) -> SwingFile:  # fmt: skip
    """The best solution as a swing file: the first car's steering as settings, every car's in `found`."""
    best, variables = best_of(solutions), shooting.variables
    time, roll, rate = variables.motion(best.x)
    facts: dict[str, Any] = {
        "starts_converged": sum(one.converged for one in solutions),
        "starts": len(solutions),
        "evaluations": sum(one.evaluations for one in solutions),
        "wall_time_s": round(sum(one.wall_time for one in solutions), 1),
        "course_rad": float(np.mean(best.course)),
    }
    chosen = [steering_of(shooting, best.x, member) for member in range(len(turns))]
    settings = (*turns[0].settings, *(f"manoeuvre.{key}={value!r}" for key, value in chosen[0].items()))
    for turn, steering, predicted in zip(turns, chosen, best.course, strict=True):
        facts |= {f"{turn.name}_{key}_{'s' if key.endswith('hold') else 'rad'}": steering[key] for key in steering}
        facts |= {f"{turn.name}_friction": turn.scenario.car.tyre_friction, f"{turn.name}_course_rad": float(predicted)}
    made = {
        "source": "aerodima optimise corner", "scenario": scenario, "seed": options.seed, "settings": settings,
        "options": {**asdict(options), "members": ", ".join(turn.name for turn in turns)}, "found": facts,
    }  # fmt: skip
    swing = steered_swing(name, turns[0].scenario, time, roll, rate, provenance=made)
    for turn, steering in zip(turns, chosen, strict=True):
        facts |= {f"{turn.name}_full_car_{key}": value for key, value in judged(turn, steering, swing, options).items()}
    return swing.model_copy(update={"provenance": swing.provenance.model_copy(update={"found": facts})})


def steering_of(shooting: TurnShooting, x: FloatArray, member: int) -> dict[str, float]:
    """Settings of section `manoeuvre` that are one car's steering, in rad and s."""
    steered = shooting.variables.steered(x[shooting.variables.own(member)])
    angle, first, hold = (float(f"{float(value):.9g}") for value in steered)
    return {"steer_angle": angle, "first_angle": first, "first_hold": hold, "turn_hold": PULSE}


def judged(turn: CarTurn, steering: dict[str, float], swing: SwingFile, options: CornerOptions) -> dict[str, Any]:
    """What the full car does with steering and swing: course (rad), peak roll (rad), whether clean (1 or 0)."""
    numerics = {"step": options.step, "log_rate": min(500.0, 1.0 / options.step)}
    run = drive(turn.scenario.varied(simulation=numerics, manoeuvre=steering), swing)
    metrics, course = summarise(run, "").metrics, turn_course(run)
    row = {"clean": int(bool(metrics.outcome.clean)), "peak_roll_rad": metrics.peak_roll_rad}
    if course.course_change_rad is None or course.exit_sideslip_rad is None:
        return row
    return row | {"course_rad": course.course_change_rad, "sideslip_rad": course.exit_sideslip_rad}


def _refuse_tailless(turns: Sequence[Scenario]) -> None:
    if any(turn.tail.mode == "none" for turn in turns):
        raise SwingError("tail.mode: none; allowed: a tail that can swing")


def _words(number: int, found: JointSolution) -> str:
    kept = f"course {math.degrees(float(np.mean(found.course))):.1f} deg"
    if found.violation > FEASIBLE:
        kept = f"not kept: {found.worst}"
    how = "converged" if found.converged else "stopped"
    return f"start {number + 1}: {how}, {kept}, {found.evaluations} batches in {found.wall_time:.0f} s"
