"""How far a car gets before it is lost: unbroken rows of clean runs, of many cars at once.

A climb begins where the car is expected to hold, goes up in strides until a run is not clean (down first, if the first
one is not), and narrows the last stride to the grid. So it ends at the first loss from below, which is what a claim
may rest on, since survival is not monotone (design section 7); what is survived beyond does not count. All values lie
on one grid: those of different controllers meet there and can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from aerodima.optimisation.sweep.rollover_threshold import Case
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.optimisation.sweep.study_task import RunTask, tipped_before_turn


@dataclass(frozen=True)
class Climb:
    """How a factor is climbed.

    Attributes:
        factor: number of the scenario.
        low, high: ends of the search.
        stride: first steps.
        grid: distance of neighbouring values; low, high, stride are multiples of it.
    """

    factor: str
    low: float
    high: float
    stride: float
    grid: float

    def index(self, value: float) -> int:
        """Place of a value on the grid, within the ends of the search; the lower one of two."""
        place = math.floor(value / self.grid + 1e-9)
        return min(max(place, round(self.low / self.grid)), round(self.high / self.grid))

    def value(self, index: int) -> float:
        """The value at a place."""
        return float(f"{index * self.grid:.9g}")


@dataclass
class Reached:
    """What a climb came to.

    Attributes:
        survived: highest value of the unbroken row; None when the lowest value was lost already.
        lost: first value above it that was not clean; None at the end of the search.
        rows: of every run, by value.
    """

    survived: float | None = None
    lost: float | None = None
    rows: dict[float, dict[str, Any]] = field(default_factory=dict)

    @property
    def tipped(self) -> bool:
        """Whether a car tipped over before its turn, so that nothing is known of the turn."""
        return any(tipped_before_turn(row) for row in self.rows.values())


def is_clean(row: Mapping[str, Any]) -> bool:
    """Whether a row of a run is that of clean survival."""
    return row["outcome"] == "survived" and bool(row["clean"])


def climb(cases: Sequence[Case], starts: Sequence[float], how: Climb, engine: Engine) -> list[Reached]:
    """Climbs with all cases at once.

    Args:
        cases: cars, turns and controllers.
        starts: where each begins.
        how: see `Climb`.
        engine: where to run.
    """
    found = [Reached() for _ in cases]
    paths = [_path(how.index(start), how) for start in starts]
    wanted = {place: next(path) for place, path in enumerate(paths)}
    while wanted:
        tasks = []
        for place, index in wanted.items():
            case, value = cases[place], how.value(index)
            setting = f"{how.factor}={value!r}"
            tasks.append(RunTask(f"{case.name} {value:g}", case.scenario, (*case.settings, setting)))
        following = {}
        for (place, index), row in zip(wanted.items(), engine.rows(tasks), strict=True):
            found[place].rows[how.value(index)] = row
            try:
                following[place] = paths[place].send(is_clean(row))
            except StopIteration as end:
                held, lost = end.value
                found[place].survived = None if held is None else how.value(held)
                found[place].lost = None if lost is None else how.value(lost)
        wanted = following
    return found


def _path(start: int, how: Climb) -> Generator[int, bool, tuple[int | None, int | None]]:
    """Yields the places to run, is sent whether they are clean; highest clean and first lost place at the end."""
    low, high = how.index(how.low), how.index(how.high)
    stride = max(1, round(how.stride / how.grid))
    held: int | None = None
    lost: int | None = None
    if (yield start):
        held = start
    else:
        lost = start
    while held is None and lost is not None:
        if lost == low:
            return None, lost
        below = max(lost - stride, low)
        if (yield below):
            held = below
        else:
            lost = below
    assert held is not None
    while lost is None:
        if held == high:
            return held, None
        above = min(held + stride, high)
        if (yield above):
            held = above
        else:
            lost = above
    while lost - held > 1:
        middle = (held + lost) // 2
        if (yield middle):
            held = middle
        else:
            lost = middle
    return held, lost
