"""Trajectory search: tail motion and steering that turn the training cars of a task furthest on
their floors.

The tail's motion is one for all cars, the steering each car's own. What it gains is a bound for
laws that release and swing by what they sense: the steering and the swing know of each other here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from aerodima.optimisation.judge.candidate import HELD
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swing.task import RUN_OUT_TIME, Task, TaskSurface, find_surfaces
from aerodima.optimisation.swing.turn_nlp import (
    FEASIBILITY_TOL,
    TurnNlp,
    TurnSolution,
    best_of,
)
from aerodima.optimisation.swing.turn_shooting import (
    FOLLOW_GAINS,
    HOLD_GAINS,
    RELEASE_STEERING,
    TurnShooting,
)
from aerodima.workbench.batch.row_store import ProgressLine, no_progress
from aerodima.workbench.car.laws import torque_speed_limits
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.deprecation import renamed
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.swing_file import SCHEMA, SwingFile, swing_from_dict

MAX_STEP = 0.005
"""Largest step of the reduced cars, s; the controller's ticks must be whole steps."""
KNOT_ROUNDING = 1e-2
"""How far the curve between two knots on a stop may bulge beyond it, rad: the tail then lies on
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
SCENARIO_CAR = Member("car", 1.0, {})
"""The car of the scenario, for a task without training cars."""


@dataclass(frozen=True)
class MotionSearch:
    """Effort of the search of a motion.

    Attributes:
        starts: random ones; `seed` of them.
        knots: of the tail's rate, the first and the last included; `length` of the motion, s.
        iterations: largest number of major iterations of the solver from a start.
    """

    starts: int = 7
    seed: int = 1
    knots: int = 11
    length: float = 0.8
    iterations: int = 30

    def __post_init__(self) -> None:
        for name, low, high in (
            ("starts", 1, math.inf),
            ("knots", 4, 41),
            ("length", 0.2, 1.2),
            ("iterations", 1, math.inf),
        ):
            check_range(name, getattr(self, name), low, high, NO_UNIT, error=SwingError)


def search_motion(
    name: str,
    task: Task,
    search: MotionSearch,
    runs: CachedRunner,
    *,
    progress: ProgressLine = no_progress,
) -> SwingFile:
    """Searches the swing with which the training cars of a task turn furthest, each with its own
    steering.

    Args:
        name: of the swing.
        task: its training cars (the scenario's own car without any), speeds and floors.
        search: how it is searched.
        runs: where the full car is driven for its critical friction.
        progress: receives lines of progress.

    Raises:
        UserError: what the reduced car does not know, no floor, no turn that keeps all limits.
    """
    surfaces, without = find_surfaces(task, task.training_cars or (SCENARIO_CAR,), runs)
    for words in without:
        progress(f"{words}: no floor; left out")
    turns = [turn_on(task, surface) for surface in surfaces]
    program = make_turn_nlp(turns, search, task)
    solutions = []
    for number in range(search.starts):
        generator = np.random.default_rng([search.seed, number])
        start = program.shooting.random_start(generator)
        solution = program.solve(start, search.iterations)
        solutions.append(solution)
        progress(_line(number, solution))
    best = best_of(solutions)
    if best.violation > FEASIBILITY_TOL:
        raise SwingError(f"no start reached a turn that keeps its limits; nearest: {best.worst}")
    return swing_of(name, task, list(zip(surfaces, turns, strict=True)), program, solutions, search)


def make_turn_nlp(
    turns: Sequence[Scenario], search: MotionSearch | None = None, task: Task | None = None
) -> TurnNlp:
    """Makes the nonlinear program of turns, not solved yet: costs and constraints may be added to
    its `prog` over its `x`.

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
        raise SwingError("tail.mode: none; must be a tail that can swing")
    rate = turns[0].controller.rate
    steps = math.ceil(1.0 / (rate * MAX_STEP) - 1e-9)
    length = 1.0 / (rate * steps)
    interval = search.length / (search.knots - 1)
    shooting = TurnShooting.from_scenarios(turns, search.knots - 2, interval, task, length)
    return TurnNlp(shooting)


def turn_on(task: Task, surface: TaskSurface) -> Scenario:
    """Returns the turn of a task's car on its surface, with the tail of the scenario."""
    settings = task.settings(HELD, surface.car, surface.speed)
    turn = load_scenario(task.scenario, (*settings, surface.setting))
    duration = turn.manoeuvre.turn_start + task.pulse + RUN_OUT_TIME
    return turn.varied(manoeuvre={"turn_hold": task.pulse, "duration": duration})


turn_programme = renamed("turn_programme", make_turn_nlp)
"""Old name of `make_turn_nlp`."""


def swing_of(
    name: str,
    task: Task,
    turns: Sequence[tuple[TaskSurface, Scenario]],
    program: TurnNlp,
    solutions: list[TurnSolution],
    search: MotionSearch,
) -> SwingFile:
    """Returns the best solution as a swing file: steering of the first car as settings, all in
    `found`.
    """
    best = best_of(solutions)
    shooting = program.shooting
    facts: Json = {
        "starts_converged": sum(one.converged for one in solutions),
        "starts": len(solutions),
        "evaluations": sum(one.evaluations for one in solutions),
        "wall_time_s": round(sum(one.wall_time for one in solutions), 1),
        "course_rad": float(np.mean(best.course)),
    }
    for member, (surface, _) in enumerate(turns):
        prefix = f"{surface.car.name}_{surface.speed:g}_{surface.share:g}"
        for key, value in steering_of(shooting, best.x, member).items():
            unit = "s" if key.endswith("hold") else "rad"
            facts[f"{prefix}_{key}_{unit}"] = value
        facts[f"{prefix}_friction"] = surface.friction
        facts[f"{prefix}_course_rad"] = float(best.course[member])
    surface, turn = turns[0]
    steering = steering_of(shooting, best.x, 0)
    steering |= {"turn_hold": task.pulse, "speed": surface.speed}
    settings = [*surface.car.settings_on(task.scenario), surface.setting]
    settings += [f"manoeuvre.{key}={value!r}" for key, value in steering.items()]
    members = ", ".join(dict.fromkeys(one.car.name for one, _ in turns))
    provenance = {
        "source": "aerodima swing search",
        "scenario": task.scenario,
        "seed": search.seed,
        "settings": tuple(settings),
        "options": {**asdict(search), "members": members},
        "found": facts,
    }
    motion = shooting.variables.motion(best.x)
    return steered_swing(name, turn, *motion, provenance=provenance)


def steering_of(shooting: TurnShooting, x: FloatArray, member: int) -> dict[str, float]:
    """Returns the settings of section `manoeuvre` that are one car's steering, in rad and s."""
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
    provenance: Json,
) -> SwingFile:
    """Makes a swing that the steering releases; pitch stays at the angle of the wait, no torques.

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
            "gains": {
                "hold": HOLD_GAINS,
                "phases": [{"start_s": 0.0, "roll": FOLLOW_GAINS, "pitch": FOLLOW_GAINS}],
            },
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


def _line(number: int, solution: TurnSolution) -> str:
    course = ", ".join(f"{math.degrees(value):.1f}" for value in solution.course)
    state = "stopped"
    if solution.converged:
        state = "converged"
    elif solution.violation > FEASIBILITY_TOL:
        state = f"violates {solution.worst}"
    return (
        f"start {number + 1}: course {course} deg, {state}, {solution.evaluations} batches in "
        f"{solution.wall_time:.0f} s"
    )
