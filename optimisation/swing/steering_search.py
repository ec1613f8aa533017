"""The steering with which a car does best, from a fixed number of runs: an amplitude on a geometric grid.

A few amplitudes are spread over the grid first. Then the gap beside the best one that counts is halved again and
again: the gap above it, towards amplitudes that roll the car over or do not count otherwise; where a larger amplitude
counts too and does worse (the tyres scrub), the larger gap of both sides. Runs that count are presumed to end at one
amplitude; a best one beyond an amplitude that does not count is taken all the same. What is run does not depend on the
number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aerodima.optimisation.sweep.rollover_threshold import rounded
from aerodima.workbench.errors import SweepError

Found = dict[int, float | None]
"""Place on the grid -> what the run was worth; None where it does not count."""


@dataclass(frozen=True)
class SteeringSearch:
    """How an amplitude is looked for.

    Attributes:
        low, high: ends of the grid, rad.
        intervals: of the grid; neighbours differ by the same factor, 1.1 % with these numbers.
        runs: of each search.
        spread: of them so many are spread over the grid first.
    """

    low: float = math.radians(2.0)
    high: float = math.radians(30.0)
    intervals: int = 256
    runs: int = 9
    spread: int = 3

    def __post_init__(self) -> None:
        if not 0.0 < self.low < self.high <= math.pi / 2:
            given = f"{math.degrees(self.low):g} to {math.degrees(self.high):g} degrees"
            raise SweepError(
                f"steering {given}: allowed: from above 0 to at most 90 degrees, the first below the second"
            )
        if not 1 <= self.spread <= self.runs:
            raise SweepError(f"{self.runs} runs of a search for steering: allowed: at least {self.spread}")

    def angle(self, place: int) -> float:
        """Amplitude at a place of the grid, rad."""
        return rounded(self.low * (self.high / self.low) ** (place / self.intervals))

    def place(self, angle: float) -> int:
        """Place on the grid that is nearest to an amplitude, rad."""
        return round(self.intervals * math.log(angle / self.low) / math.log(self.high / self.low))

    def following(self, found: Mapping[int, float | None]) -> list[int]:
        """Places that are run next; none at the end."""
        if not found:
            return [self.intervals * number // (self.spread + 1) for number in range(1, self.spread + 1)]
        if len(found) >= self.runs:
            return []
        best = best_place(found)
        if best is None:
            return [min(found) // 2] if min(found) > 0 else []
        below = max((place for place in found if place < best), default=-1)
        above = min((place for place in found if place > best), default=self.intervals + 1)
        middles = [(best + above) // 2, (below + best + 1) // 2]
        if found.get(above) is not None and best - below > above - best:
            middles.reverse()
        return [middle for middle in middles if middle not in found][:1]


def best_place(found: Mapping[int, float | None]) -> int | None:
    """Of the largest value; the smallest amplitude of equal ones, None when nothing counts."""
    values = {place: value for place, value in found.items() if value is not None}
    return max(sorted(values), key=lambda place: values[place], default=None)


def search_steering(
    search: SteeringSearch, number: int, run: Callable[[Sequence[tuple[int, int]]], Sequence[float | None]]
) -> list[Found]:
    """Several searches at once, so that all workers have something to do.

    Args:
        search: the same for all of them.
        number: of searches.
        run: what the runs of (number of the search, place on the grid) are worth, in order.
    """
    found: list[Found] = [{} for _ in range(number)]
    while wanted := [(which, place) for which, tried in enumerate(found) for place in search.following(tried)]:
        for (which, place), value in zip(wanted, run(wanted), strict=True):
            found[which][place] = value
    return found
