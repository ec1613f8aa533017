"""The best steering of a candidate on a reduced car: three angles and two times, found by
differential evolution with the same budget for all.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.swerve.aims import score
from aerodima.optimisation.swerve.evolution import evolve
from aerodima.workbench.car.reduced.swerves import LEVELS, STEERING
from aerodima.workbench.car.swerve import Measure, Swerve
from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.ranges import NO_UNIT, check_range

MIN_FIRST_LEVEL = 0.012
"""Least first angle, rad: it begins the swerve, and is above what counts as steering."""
MIN_DRAWN_LEVEL = 0.015
"""Least angle of the first generation, rad."""
TRIMS = (-0.05, 0.009)
"""Least and largest trim, rad: into the turn it stays below what releases a swing."""
FIRST_ENDS = (0.02, 0.6)
"""Range of the end of the first level, s."""
SECOND_ENDS = (0.04, 1.2)
"""Range of the end of the second level, s."""
CONSTANT_ENDS = (0.2, 0.6)
"""Ends of the first two levels of a steering that is constant, s."""
TICK = 0.01
"""Tick of the driver, s; levels end at whole ticks."""
STEERING_KEYS = ("level_1", "level_2", "level_3", "level_1_end", "level_2_end", "trim_angle")
"""Keys of section `manoeuvre` that make up a steering, in the order of its array; the array has no
trim where the car needs none."""
MIN_MEMBERS = 8
"""Least number of members in a generation."""


@dataclass(frozen=True)
class SearchEffort:
    """Budget of a search of a steering.

    Attributes:
        members: number of steerings in a generation.
        generations: number of generations after the first one.
        searches: number of searches, each with its own seed; the best result is taken.
        seed: seed of the first search; the others use the seeds that follow it.
    """

    members: int = 60
    generations: int = 30
    searches: int = 2
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (("members", MIN_MEMBERS), ("generations", 0), ("searches", 1)):
            check_range(name, getattr(self, name), low, math.inf, NO_UNIT, error=SweepError)


def search_steering(
    drive: Callable[[FloatArray], Swerve],
    aim: Measure,
    limit: float,
    effort: SearchEffort,
) -> tuple[float, FloatArray]:
    """Searches the steering with the best score.

    Args:
        drive: function that drives a batch of steerings (`STEERING`, members).
        aim: function of a `Swerve` that is maximised; returns one value per member (members,).
        limit: largest angle to either side, rad.
        effort: budget of the search.

    Returns:
        The best score, see `aims.score`, and its steering (`STEERING`,).
    """

    def cost(points: FloatArray) -> FloatArray:
        return -score(drive(possible_steering(points, limit).T), aim)

    ranges = steering_ranges(limit)
    results = []
    for seed in range(effort.seed, effort.seed + effort.searches):
        drawn = draw_steering(np.random.default_rng(seed), effort.members, limit)
        results.append(evolve(cost, drawn, ranges, effort.generations, seed))
    least, point = min(results, key=lambda result: result[0])
    return -least, possible_steering(point[None], limit)[0]


def steering_ranges(limit: float) -> ArrayPair:
    """Returns the least and the largest steering (`STEERING`,) within a limit of the angles,
    rad.
    """
    low = [MIN_FIRST_LEVEL, -limit, -limit, FIRST_ENDS[0], SECOND_ENDS[0]]
    high = [limit, limit, limit, FIRST_ENDS[1], SECOND_ENDS[1]]
    return np.array(low), np.array(high)


def draw_steering(generator: np.random.Generator, members: int, limit: float) -> FloatArray:
    """Draws steerings (members, `STEERING`): half with one constant angle, half with any three."""
    constant = members // 2
    low, high = math.log(MIN_DRAWN_LEVEL), math.log(limit)
    angles = np.exp(generator.uniform(low, high, (members, LEVELS)))
    angles[:constant] = np.exp(np.linspace(low, high, constant))[:, None]
    first = generator.uniform(0.04, 0.5, (members, 1))
    return np.concatenate([angles, first, generator.uniform(0.1, 1.0, (members, 1))], axis=1)


def possible_steering(points: FloatArray, limit: float) -> FloatArray:
    """Returns the nearest steerings that are possible (members, `STEERING` or more)."""
    result = points.copy()
    result[:, :LEVELS] = np.clip(points[:, :LEVELS], -limit, limit)
    result[:, 0] = np.maximum(result[:, 0], MIN_FIRST_LEVEL)
    ends = TICK * np.rint(points[:, LEVELS:STEERING] / TICK)
    first = np.clip(ends[:, 0], *FIRST_ENDS)
    result[:, LEVELS] = first
    result[:, LEVELS + 1] = np.clip(np.maximum(ends[:, 1], first), *SECOND_ENDS)
    return result


def scaled_steering(steering: FloatArray, share: float, limit: float = math.inf) -> FloatArray:
    """Returns a steering (`STEERING`,), or one with a trim, whose three angles are multiplied by a
    share and clipped to a limit, rad.
    """
    angles = np.clip(share * steering[:LEVELS], -limit, limit)
    return np.concatenate([angles, steering[LEVELS:]])


def steering_settings(steering: FloatArray) -> Settings:
    """Returns the settings of a steering (`STEERING`,), or of one with a trim."""
    numbers = zip(STEERING_KEYS[: len(steering)], steering, strict=True)
    return tuple(f"manoeuvre.{key}={float(f'{value:.9g}')!r}" for key, value in numbers)


def constant_steering(angle: float, count: int) -> FloatArray:
    """Returns the steering (`STEERING`, count) of drivers who hold one angle, rad; at full lock it
    is `servo.limit`.
    """
    return np.repeat(np.array([*[angle] * LEVELS, *CONSTANT_ENDS])[:, None], count, axis=1)
