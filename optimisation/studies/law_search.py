"""Search among laws: generations of them, of which the best that differ are the finalists.

Differential evolution (Storn and Price 1997, doi 10.1023/A:1008202821328; `scipy.optimize.differential_evolution`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from aerodima.workbench.batch.row_store import ProgressBar
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import SweepError

LATEST, GAIN = 3, 0.005
"""A search gains if its last so many generations brought that much: of the course of the published law."""
APART = 0.05
"""Least share of a range by which finalists differ in one number at least."""


@dataclass(frozen=True)
class LawSearch:
    """How much is searched.

    Attributes:
        laws: of a generation, for each free number of the family.
        generations: beside the first one.
        finalists: laws that go to the full car.
        seed: of the first generation and of all later draws.
        steering_runs: of each search for an amplitude on a reduced car.

    Raises:
        UserError: fewer than 3 laws, or no finalist.
    """

    laws: int = 6
    generations: int = 15
    finalists: int = 5
    seed: int = 1
    steering_runs: int = 7

    def __post_init__(self) -> None:
        if self.laws < 3:
            raise SweepError(f"{self.laws} laws for each number: allowed: at least 3")
        if self.finalists < 1:
            raise SweepError(f"{self.finalists} finalists: allowed: at least 1")


class LawsFound(NamedTuple):
    """What a search came to: `finalists`, the best first; all `laws` that were driven, with what they are `worth`."""

    finalists: list[dict[str, float]]
    laws: list[dict[str, float]]
    worth: FloatArray


class Searched(Protocol):
    """What is searched: a family of laws (`law_training.LawFamily`)."""

    @property
    def name(self) -> str:
        """Of the family."""

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest value by name."""

    @property
    def starts(self) -> Sequence[Mapping[str, float]]:
        """Laws that the first generation has, beside those that are drawn."""

    def laws(self, shares: FloatArray) -> list[dict[str, float]]:
        """Laws at shares (n, ranges) of the ranges."""

    def shares(self, law: Mapping[str, float]) -> FloatArray:
        """Where a law lies in the ranges (ranges,)."""


def search_laws(
    family: Searched,
    search: LawSearch,
    worth: Callable[[Sequence[Mapping[str, float]]], FloatArray],
    told: Callable[[str], None],
) -> LawsFound:
    """The best laws of a family, and all that were tried; finalists differ by `APART`.

    Args:
        family: among them.
        search: how.
        worth: scores (n,) of laws; those that are not above 0 are no finalists.
        told: of the progress.
    """
    seen: list[tuple[float, FloatArray]] = []
    bar = ProgressBar(told, search.generations + 1)

    def cost(shares: FloatArray) -> FloatArray:
        scores = worth(family.laws(shares.T))
        seen.extend(zip(scores.tolist(), shares.T.copy(), strict=True))
        best = max(seen, key=_first)[0]
        said = "none allowed yet" if best <= 0.0 else f"the best {best - 1.0:+.1%}"
        bar.one_more(f"{family.name}: {len(seen)} laws tried on reduced cars, {said}")
        return -scores

    numbers = len(family.ranges)
    first = qmc.LatinHypercube(numbers, rng=search.seed).random(search.laws * numbers)
    for place, law in enumerate(family.starts[: len(first)]):
        first[place] = family.shares(law)
    differential_evolution(
        cost,
        [(0.0, 1.0)] * numbers,
        init=first,
        maxiter=search.generations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=search.seed,
    )
    if is_gaining([value for value, _ in seen], search.laws * numbers):
        told(f"{family.name}: stopped at {search.generations} generations while it still gained")
    allowed = sorted((pair for pair in seen if pair[0] > 0.0), key=_first, reverse=True)
    chosen: list[FloatArray] = []
    for _, shares in allowed:
        if all(np.max(np.abs(shares - other)) >= APART for other in chosen):
            chosen.append(shares)
    everything = np.array([shares for _, shares in allowed]).reshape(-1, numbers)
    finalists = np.array(chosen[: search.finalists]).reshape(-1, numbers)
    return LawsFound(family.laws(finalists), family.laws(everything), np.array([value for value, _ in allowed]))


def is_gaining(worths: Sequence[float], generation: int) -> bool:
    """Whether one of the last `LATEST` generations, of that many laws, gained at least `GAIN` over those before it."""
    before = worths[: -LATEST * generation]
    return bool(before) and max(worths) >= max(before) + GAIN


def _first(pair: tuple[float, Any]) -> float:
    return pair[0]
