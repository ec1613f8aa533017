"""The bound of a swerve: the best steering and motion of the tail, both known beforehand and chosen
together, on reduced cars.

The nonlinear program (`swerve_nlp`) starts from the best of a differential evolution over all its
variables, from the best of its first generation, and from motions and steerings of candidates with
the same tail, so that the bound does not fall below a candidate whose motion its variables contain.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from aerodima.optimisation.swerve.aims import Aim, as_aim, score
from aerodima.optimisation.swerve.evolution import evolve
from aerodima.optimisation.swerve.steering import (
    STEERING_KEYS,
    draw_steering,
    possible_steering,
)
from aerodima.optimisation.swing.free_tail import FreeTail
from aerodima.optimisation.swing.swerve_nlp import (
    FEASIBILITY_TOL,
    Solver,
    SwerveNlp,
    SwerveSolution,
)
from aerodima.optimisation.swing.swerve_shooting import (
    KNOTS,
    Limit,
    SwerveShooting,
    SwerveVariables,
    within_reach,
)
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, Row, no_progress
from aerodima.workbench.car.reduced.swerves import STEERING
from aerodima.workbench.car.swerve import Measure
from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.scenario.scenario import Scenario

MAX_DRAWN_ROLL = 1.5
"""Largest roll of the tail in the first generation, rad."""
DRAWN_PITCHES = (-1.1, -0.6, 0.0, 0.0)
"""Pitches of the tail in the first generation, rad."""
WAITS = (-0.4, -0.8, -1.2)
"""Rolls at which the tail waits in the further starts of an announced turn, rad: to the inside."""
STILL_SHARE = 4
"""One in every `STILL_SHARE` tails of the first generation does not roll."""


@dataclass(frozen=True)
class BoundEffort:
    """Budget of a bound.

    Attributes:
        members: number of points in a generation of the first search.
        generations: number of generations after the first one.
        starts: number of starts of the program from the first search.
        iterations: largest number of major iterations in each of the two solves from a start.
        solver: solver of the program.
        seed: seed of every random draw.
    """

    members: int = 150
    generations: int = 40
    starts: int = 4
    iterations: int = 20
    solver: Solver = "snopt"
    seed: int = 1


@dataclass(frozen=True)
class Bound:
    """The best steering and motion that were found.

    Attributes:
        scenarios: scenarios of the cars, with the tail that was found where its numbers are free;
            they do not hold the steering and swing that were found.
        program: program that was solved.
        solution: best solution of all starts.
        wall_time: duration of the search, s.
    """

    scenarios: tuple[Scenario, ...]
    program: SwerveNlp
    solution: SwerveSolution
    wall_time: float

    def steering(self, member: int = 0) -> FloatArray:
        """Returns the steering (`STEERING`,) of one car, rad and s, with its trim if announced."""
        variables = self.program.shooting.variables
        return (self.solution.x * variables.units)[variables.own(member)[variables.tail :]]

    @property
    def result(self) -> Row:
        """Aim and steering of the first car, as `best_steering` returns them."""
        aim = float(self.solution.aims[0])
        return {"score": aim, "steering": self.steering().tolist(), "variant": 0}

    @property
    def table(self) -> pd.DataFrame:
        """Table with a row per car: aim, steering (rad and s), free numbers of the tail, violation
        of the limits, and cost of the search.
        """
        solution = self.solution
        steerings = [self.steering(member) for member in range(len(self.scenarios))]
        return pd.DataFrame(
            {
                "car": [scenario.name for scenario in self.scenarios],
                "speed_m_per_s": [scenario.manoeuvre.speed for scenario in self.scenarios],
                "aim": solution.aims,
                **dict(zip(STEERING_KEYS, np.transpose(steerings), strict=False)),
                **self.program.shooting.free_numbers(solution.x),
                "violation": solution.violation,
                "worst": solution.worst,
                "evaluations": solution.evaluations,
                "wall_time_s": self.wall_time,
            }
        )


def find_bound(
    scenarios: Sequence[Scenario],
    aim: Aim | Measure | str = "aside-0.5",
    limits: Sequence[Limit] = (),
    effort: BoundEffort | None = None,
    candidates: Sequence[ArrayPair] = (),
    extend: Callable[[SwerveNlp], None] | None = None,
    progress: ProgressLine = no_progress,
    *,
    announced: bool = False,
    free: FreeTail | None = None,
) -> Bound:
    """Searches the best steering and motion of the tail for one car, or one motion for many cars.

    Args:
        scenarios: scenarios of kind `levels` of cars with a tail; each has its own steering.
        aim: aim that is maximised: its name, or a function of a `Swerve` that returns the aim of
            each car (n,).
        limits: limits beside those of every swerve.
        effort: budget of the search; by default `BoundEffort()`.
        candidates: further starts: pitch of the tail and its rolls at the knots after the first
            (`KNOTS`,), rad, with a steering (`STEERING`,).
        extend: function that adds costs and constraints to the program before it is solved.
        progress: function that receives a line after the first search and after each start.
        announced: whether the tail knows of the turn and may wait at a side while the driver keeps
            the car straight; the last candidate is then also started from the rolls `WAITS`.
        free: numbers of the tail that the program also chooses, from the middle of their ranges, so
            that the bound may fall below a candidate whose tail is not there;
            `extend` finds them under `program.numbers`.

    Raises:
        UserError: no swerve keeps all limits; as `SwerveShooting.from_scenarios`.
    """
    begin = time.monotonic()
    effort = effort or BoundEffort()
    chosen = as_aim(aim)
    shooting = SwerveShooting.from_scenarios(scenarios, chosen, limits, announced, free)
    program = SwerveNlp(shooting, chosen.size)
    if extend is not None:
        extend(program)
    points = []
    for (pitch, *rolls), steering in candidates:
        kept = within_reach(np.array([rolls]), shooting.variables.max_roll)[0]
        points.append(np.concatenate([steering, [pitch], kept]))
    waits = WAITS if announced else ()
    bar = ProgressBar(progress, 1 + len(points) + effort.starts + len(waits))
    points += _first_search(shooting, effort)
    bar.advance("first search")
    solutions = []
    starts = [*_with_one_steering(shooting.variables, np.array(points))]
    last = starts[len(candidates) - 1]
    starts += [np.concatenate([last[:1], [wait], last[2:]]) for wait in waits]
    for start in starts:
        solutions.append(program.solve(start, effort.iterations, effort.solver))
        bar.advance("starts of the program")
    best = _best_of(solutions)
    found = shooting.scenarios_at(best.x)
    return Bound(found, program, best, time.monotonic() - begin)


def _best_of(solutions: Sequence[SwerveSolution]) -> SwerveSolution:
    """Returns the solution of least cost that keeps all limits; SwingError if none does."""
    kept = [one for one in solutions if one.violation <= FEASIBILITY_TOL]
    if not kept:
        nearest = min(solutions, key=lambda one: one.violation)
        raise SwingError(
            f"no start reached a swerve that keeps its limits; nearest: {nearest.worst}"
        )
    return min(kept, key=lambda one: one.cost)


def _with_one_steering(variables: SwerveVariables, points: FloatArray) -> FloatArray:
    """Returns the scaled variables (n, size) of points (n, `STEERING` + knots).

    A point is one steering for all cars, rad and s, without trim, and a motion of the tail from the
    middle, rad. Free numbers are in the middle of their ranges.
    """
    steering, tail = np.split(points, [STEERING], axis=1)
    if variables.announced:
        steering = np.insert(steering, STEERING, 0.0, axis=1)
        tail = np.insert(tail, 1, 0.0, axis=1)
    free = np.tile([0.5 * sum(ends) for ends in variables.free], (len(points), 1))
    steerings = [steering] * variables.members
    return np.concatenate([tail, free, *steerings], axis=1) / variables.units


def _first_search(shooting: SwerveShooting, effort: BoundEffort) -> list[FloatArray]:
    """Returns points for `_with_one_steering`: the best one of a differential evolution, then the
    best ones of its first generation.
    """
    variables = shooting.variables
    generator = np.random.default_rng(effort.seed)
    members = effort.members
    tails = _draw_tails(generator, members)
    first = np.concatenate([draw_steering(generator, members, variables.max_angle), tails], axis=1)

    def possible(points: FloatArray) -> FloatArray:
        result = possible_steering(points, variables.max_angle)
        tail = result[:, STEERING:]
        tail[:, 0] = np.clip(tail[:, 0], *variables.pitches)
        tail[:, 1:] = within_reach(tail[:, 1:], variables.max_roll)
        return result

    upper = np.array([limit.upper / limit.size for limit in shooting.row_limits])[:, None]

    def evaluate(points: FloatArray) -> FloatArray:
        columns = _with_one_steering(variables, points).T
        total = np.zeros(len(points))
        for member in range(variables.members):
            swerve = shooting.drive(columns[variables.own(member)], np.full(len(points), member))
            behind = np.maximum(shooting.rows(swerve) - upper, 0.0).max(axis=0)
            total += score(swerve, shooting.aim) - np.where(behind > 0.0, 1e2 + behind, 0.0)
        return total / variables.members

    first = possible(first)
    best_first = first[np.argsort(-evaluate(first), kind="stable")[: effort.starts - 1]]
    alone = variables._replace(members=1, announced=False, free=())
    low, high = (np.roll(ends, STEERING) for ends in alone.ranges)

    def cost(points: FloatArray) -> FloatArray:
        return -evaluate(possible(points))

    _, point = evolve(cost, first, (low, high), effort.generations, effort.seed)
    return [*possible(point[None]), *best_first]


def _draw_tails(generator: np.random.Generator, members: int) -> FloatArray:
    """Draws pitches and rolls (members, knots) of tails that move from one roll to another."""
    pitch = generator.choice(DRAWN_PITCHES, (members, 1))
    first, last = generator.uniform(-MAX_DRAWN_ROLL, MAX_DRAWN_ROLL, (2, members, 1))
    begin = generator.uniform(0.0, 1.0, (members, 1))
    length = generator.uniform(0.05, 1.0, (members, 1))
    share = np.array(KNOTS)[None, 1:] / KNOTS[-1]
    rolls = first + (last - first) * np.clip((share - begin) / length, 0.0, 1.0)
    rolls[::STILL_SHARE] = 0.0
    return np.concatenate([pitch, rolls], axis=1)
