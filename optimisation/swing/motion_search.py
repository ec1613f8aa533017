"""Trajectory search: tail motion and steering that turn the training cars of a task furthest on
their floors.

The tail's motion is one for all cars, the steering each car's own. What it gains is a bound for
laws that release and swing by what they sense: the steering and the swing know of each other here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from aerodima.optimisation.judge.candidate import HELD
from aerodima.optimisation.studies.runs import Runs
from aerodima.optimisation.swing.task import AFTER, Floor, Task, find_floors
from aerodima.optimisation.swing.turn_nlp import (
    FEASIBLE,
    TurnProgramme,
    TurnSolution,
    best_of,
)
from aerodima.optimisation.swing.turn_shooting import FOLLOW, HOLD, RELEASE_STEERING, TurnShooting
from aerodima.workbench.batch.row_store import ProgressLine, no_progress
from aerodima.workbench.car.ak70 import torque_speed_limits
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.swing_file import SCHEMA, SwingFile, swing_from_dict

FASTEST_TICK = 0.005
"""Longest step of the reduced cars, s; the controller's ticks must be whole steps."""
KNOT_ROUNDING = 1e-2
"""How far the curve between two knots on a stop may bulge beyond it, rad: the tail then rests on
the stop."""

CAR_KEYS = (
    "car.mass",
    "car.com_height",
    "car.com_x",
    "car.gyration_roll",
    "car.wheelbase",
    "car.track",
    "tail.length",
    "tail.mass",
    "tail.sail_length",
    "tail.sail_width",
    "tail.mount_x",
    "tail.mount_height",
    "tail.normal_force_coefficient",
    "tail.roll_limit",
    "tail.pitch_limit",
)
"""Parameters that make it another car for a swing."""
OWN_CAR = Member("car", 1.0, {})
"""The car of the scenario, for a task without training cars."""


@dataclass(frozen=True)
class MotionSearch:
    """How a motion is searched.

    Attributes:
        starts: random ones; `seed` of them.
        knots: of the tail's rate, the first and the last included; `length` of the motion, s.
        iterations: most major iterations of the solver from a start.
    """

    starts: int = 7
    seed: int = 1
    knots: int = 11
    length: float = 0.8
    iterations: int = 30

    def __post_init__(self) -> None:
        allowed = {
            "starts": (self.starts, self.starts >= 1, "at least 1"),
            "knots": (self.knots, 4 <= self.knots <= 41, "4 to 41"),
            "length": (self.length, 0.2 <= self.length <= 1.2, "0.2 to 1.2 s"),
            "iterations": (self.iterations, self.iterations >= 1, "at least 1"),
        }
        for name, (value, good, words) in allowed.items():
            if not good:
                raise SwingError(f"{name}: {value:g}; allowed: {words}")


def search_motion(
    name: str, task: Task, search: MotionSearch, runs: Runs, *, progress: ProgressLine = no_progress
) -> SwingFile:
    """The swing with which the training cars of a task turn furthest, each with its own steering.

    Args:
        name: of the swing.
        task: its training cars (the scenario's own car without any), speeds and floors.
        search: how it is searched.
        runs: where the full car is driven for its critical friction.
        progress: receives lines of progress.

    Raises:
        UserError: what the reduced car does not know, no floor, no turn that keeps all limits.
    """
    floors, without = find_floors(task, task.training_cars or (OWN_CAR,), runs)
    for words in without:
        progress(f"{words}: no floor; left out")
    turns = [turn_on(task, floor) for floor in floors]
    programme = turn_programme(turns, search, task)
    solutions = []
    for number in range(search.starts):
        generator = np.random.default_rng([search.seed, number])
        start = programme.shooting.random_start(generator)
        solution = programme.solve(start, search.iterations)
        solutions.append(solution)
        progress(_line(number, solution))
    best = best_of(solutions)
    if best.violation > FEASIBLE:
        raise SwingError(f"no start came to a turn that keeps its limits; nearest: {best.worst}")
    return swing_of(name, task, list(zip(floors, turns, strict=True)), programme, solutions, search)


def turn_programme(
    turns: Sequence[Scenario], search: MotionSearch | None = None, task: Task | None = None
) -> TurnProgramme:
    """The programme of turns, not solved yet: costs and constraints may be added to its `prog` over
    its `x`.

    Args:
        turns: cars on their floors, with a tail.
        search: knots and length of the motion.
        task: its pulse, range of the steering, and limits of a turn that counts; by default those
            of any task.

    Raises:
        UserError: a car without tail; what the reduced cars do not know.
    """
    search = search or MotionSearch()
    task = task or Task()
    if any(turn.tail.mode == "none" for turn in turns):
        raise SwingError("tail.mode: none; allowed: a tail that can swing")
    rate = turns[0].controller.rate
    steps = math.ceil(1.0 / (rate * FASTEST_TICK) - 1e-9)
    length = 1.0 / (rate * steps)
    interval = search.length / (search.knots - 1)
    shooting = TurnShooting.of(turns, search.knots - 2, interval, task, length)
    return TurnProgramme(shooting)


def turn_on(task: Task, floor: Floor) -> Scenario:
    """The turn of a task's car on its floor, with the tail of the scenario."""
    settings = task.settings(HELD, floor.car, floor.speed)
    turn = load_scenario(task.scenario, (*settings, floor.setting))
    duration = turn.manoeuvre.turn_start + task.pulse + AFTER
    return turn.varied(manoeuvre={"turn_hold": task.pulse, "duration": duration})


def swing_of(
    name: str,
    task: Task,
    turns: Sequence[tuple[Floor, Scenario]],
    programme: TurnProgramme,
    solutions: list[TurnSolution],
    search: MotionSearch,
) -> SwingFile:
    """The best solution as a swing file: steering of the first car as settings, all in `found`."""
    best = best_of(solutions)
    shooting = programme.shooting
    time, roll, rate = shooting.variables.motion(best.x)
    facts: dict[str, Any] = {
        "starts_converged": sum(one.converged for one in solutions),
        "starts": len(solutions),
        "evaluations": sum(one.evaluations for one in solutions),
        "wall_time_s": round(sum(one.wall_time for one in solutions), 1),
        "course_rad": float(np.mean(best.course)),
    }
    for member, ((floor, _), predicted) in enumerate(zip(turns, best.course, strict=True)):
        own = f"{floor.car.name}_{floor.speed:g}_{floor.share:g}"
        steering = steering_of(shooting, best.x, member)
        for key, value in steering.items():
            unit = "s" if key.endswith("hold") else "rad"
            facts[f"{own}_{key}_{unit}"] = value
        facts[f"{own}_friction"] = floor.friction
        facts[f"{own}_course_rad"] = float(predicted)
    floor, turn = turns[0]
    steering = {**steering_of(shooting, best.x, 0), "turn_hold": task.pulse, "speed": floor.speed}
    settings = (*floor.car.settings_on(task.scenario), floor.setting)
    made = {
        "source": "aerodima swing search",
        "scenario": task.scenario,
        "seed": search.seed,
        "settings": (*settings, *(f"manoeuvre.{key}={value!r}" for key, value in steering.items())),
        "options": {
            **asdict(search),
            "members": ", ".join(dict.fromkeys(one.car.name for one, _ in turns)),
        },
        "found": facts,
    }
    return steered_swing(name, turn, time, roll, rate, provenance=made)


def steering_of(shooting: TurnShooting, x: FloatArray, member: int) -> dict[str, float]:
    """Settings of section `manoeuvre` that are one car's steering, in rad and s."""
    steered = shooting.variables.steered(x[shooting.variables.own(member)])
    angle, first, hold = (float(f"{float(value):.9g}") for value in steered)
    return {"steer_angle": angle, "first_angle": first, "first_hold": hold}


def steered_swing(
    name: str,
    scenario: Scenario,
    time: FloatArray,
    roll: FloatArray,
    rate: FloatArray,
    *,
    provenance: dict[str, Any],
) -> SwingFile:
    """A swing that the steering releases; pitch stays at the angle of the wait, no torques.

    Args:
        name: of the swing.
        scenario: car, turn and controller.
        time, roll, rate: of the tail at the knots in a turn to the left, s since the steering
            command, rad and rad/s.
        provenance: fields of `Provenance`.
    """
    stall, no_load = torque_speed_limits(scenario.tail_motor)
    torque = scenario.tail_motor.torque_limit
    angle = scenario.tail.roll_limit
    still = np.zeros(len(time))
    side = 1.0 if scenario.manoeuvre.direction == "left" else -1.0
    resolved = scenario.resolved()

    def row(values: FloatArray) -> tuple[float, ...]:
        return tuple(float(value) for value in np.round(values, 9) + 0.0)

    knots = {
        "time_s": row(time),
        "roll_position_rad": row(side * np.clip(roll, -angle, angle)),
        "roll_velocity_rad_per_s": row(side * rate),
        "pitch_position_rad": row(still + scenario.controller.pitch_angle),
        "pitch_velocity_rad_per_s": row(still),
    }
    return swing_from_dict(
        {
            "schema": SCHEMA,
            "name": name,
            "direction": scenario.manoeuvre.direction,
            "trigger": {"kind": "steering", "threshold_rad": RELEASE_STEERING},
            "knots": knots,
            "gains": {"hold": HOLD, "phases": [{"start_s": 0.0, "roll": FOLLOW, "pitch": FOLLOW}]},
            "limits": {
                "roll_position_rad": angle + KNOT_ROUNDING,
                "pitch_position_rad": scenario.tail.pitch_limit + KNOT_ROUNDING,
                "velocity_rad_per_s": no_load * (1.0 - torque / stall),
                "torque_n_m": torque,
            },
            "provenance": {**provenance, "versions": software_versions()},
            "car": {key: float(resolved[key.split(".")[0]][key.split(".")[1]]) for key in CAR_KEYS},
        },
        name,
    )


def _line(number: int, found: TurnSolution) -> str:
    course = ", ".join(f"{math.degrees(value):.1f}" for value in found.course)
    if found.converged:
        state = "converged"
    elif found.violation > FEASIBLE:
        state = f"violates {found.worst}"
    else:
        state = "stopped"
    return (
        f"start {number + 1}: course {course} deg, {state}, {found.evaluations} batches in "
        f"{found.wall_time:.0f} s"
    )
