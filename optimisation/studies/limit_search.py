"""Search of a limit: the highest value of a factor that holds, and the first one that is lost.

The verdicts are not monotone (design section 7): beyond the first loss there may be islands that
hold again. A limit is therefore the end of an unbroken row from below. It is searched by a climb,
for one candidate or many: a climb begins where the candidate is expected to hold, goes up in
strides until a value is lost (down first, if the first one is), and halves the last stride
(`Bracket.next_value`).

The values that are evaluated depend on their verdicts alone, so the limits do not depend on the
number of workers; rows that are kept are not made again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

Candidate = TypeVar("Candidate")


@dataclass(frozen=True)
class Bracket:
    """Highest value that holds below the first loss, and that loss; numbers, or arrays (n).

    Attributes:
        held: highest value that holds below the first loss; -inf while no value holds.
        lost: lowest value that is lost; inf while no value is lost.
    """

    held: Any = -math.inf
    lost: Any = math.inf

    @classmethod
    def from_verdicts(cls, verdicts: Mapping[float, bool | None]) -> Bracket:
        """Makes the bracket of values and their verdicts; a value without verdict is ignored."""
        losses = (value for value, holds in verdicts.items() if holds is False)
        lost = min(losses, default=math.inf)
        held = (value for value, holds in verdicts.items() if holds and value < lost)
        return cls(max(held, default=-math.inf), lost)

    def updated(self, value: Any, holds: Any) -> Bracket:
        """Narrows the bracket by the verdict on a value between its ends."""
        return Bracket(np.where(holds, value, self.held), np.where(holds, self.lost, value))

    def next_value(self, start: Any, stride: Any) -> Any:
        """Returns the start, then a stride beyond the only end, then the middle of both ends."""
        has_held = np.isfinite(self.held)
        has_lost = np.isfinite(self.lost)
        held = np.where(has_held, self.held, 0.0)
        lost = np.where(has_lost, self.lost, 0.0)
        outside = np.where(has_held, held + stride, np.where(has_lost, lost - stride, start))
        return np.where(has_held & has_lost, 0.5 * (held + lost), outside)


def run_rounds(
    candidates: Sequence[Candidate],
    next_values: Callable[[Candidate], Iterable[float]],
    run: Callable[[Sequence[tuple[Candidate, float]]], Sequence[Any]],
    results: Callable[[Candidate], dict[float, Any]],
) -> None:
    """Searches for several candidates at once, so that all workers are busy.

    Args:
        candidates: candidates whose limits are searched.
        next_values: function that returns the values that a candidate needs next; none at its end.
        run: function that evaluates pairs of candidate and value, in order.
        results: function that returns the results of a candidate by value, to which each new result
            is added.
    """
    while True:
        wanted = [
            (candidate, value) for candidate in candidates for value in next_values(candidate)
        ]
        if not wanted:
            return
        for (candidate, value), result in zip(wanted, run(wanted), strict=True):
            results(candidate)[value] = result


@dataclass(frozen=True)
class LimitSearch:
    """Range and steps of a search.

    Attributes:
        low: lowest value; the grid of a climb begins here.
        high: highest value.
        stride: first stride of a climb; at least the tolerance.
        tolerance: largest distance between the highest value held and the first lost; spacing of
            the grid of a climb.
    """

    low: float
    high: float
    stride: float
    tolerance: float

    def next_values(self, start: float, verdicts: Mapping[float, bool | None]) -> list[float]:
        """Returns the value that is needed next; none at the end.

        Args:
            start: value at which the climb begins.
            verdicts: verdict on each value that was evaluated so far, whether it holds, by value.
        """
        stride = self.tolerance * max(1, round(self.stride / self.tolerance))
        wanted = Bracket.from_verdicts(verdicts).next_value(start, stride)
        index = math.floor((wanted - self.low) / self.tolerance + 1e-9)
        last = round((self.high - self.low) / self.tolerance)
        value = rounded(self.low + min(max(index, 0), last) * self.tolerance)
        # A value that is known already ends a climb.
        return [] if value in verdicts else [value]


def rounded(value: float) -> float:
    """Drops the last bits of a division, so that tables and settings read well."""
    return float(f"{value:.9g}")
