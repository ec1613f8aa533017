"""Search of an entry speed, as a function of what failed at each speed.

The lateral acceleration is small at low speeds, so that every climb begins below the limit. Too low
a value is therefore a failure only above a speed at which the manoeuvre was completed; below that
the climb passes it, as neither completed nor failed.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from aerodima.optimisation.judge.entry_rule import ERROR, LATERAL
from aerodima.optimisation.studies.limit_search import Bracket, LimitSearch, rounded
from aerodima.optimisation.studies.rollover_threshold import SPEED
from aerodima.workbench.core.errors import SweepError

MAX_STEP_BACKS = 8
"""How often a speed that is not confirmed at the fine step is lowered at most."""
Failures = Mapping[float, str]
"""Speed, m/s -> rule that failed there (`failed_rule`); empty where the manoeuvre was completed."""


@dataclass(frozen=True)
class EntrySearch:
    """Speeds of a climb, m/s, all of them multiples of `fine`.

    Attributes:
        start: first speed of a climb.
        step: between two speeds on the way.
        fine: grid on which the entry speed is found.
        ceiling: highest speed that is tried.
        lowest: that is tried.

    Raises:
        SweepError: a speed that is no multiple, or speeds out of order.
    """

    start: float = 2.0
    step: float = 0.1
    fine: float = 0.05
    ceiling: float = 8.0
    lowest: float = 1.0

    def __post_init__(self) -> None:
        fine = self.fine
        if not 0.0 < fine <= self.step or not 0.0 < self.lowest <= self.start <= self.ceiling:
            raise SweepError(
                f"start {self.start:g}, step {self.step:g}, ceiling {self.ceiling:g} m/s: must be: "
                f"step from {fine:g} m/s on, and {self.lowest:g} <= start <= ceiling"
            )
        for name in ("start", "step", "ceiling", "lowest"):
            value = getattr(self, name)
            if not math.isclose(value, rounded(fine * round(value / fine)), rel_tol=1e-9):
                raise SweepError(
                    f"entry speed: {name} {value:g}; must be a multiple of fine, {fine:g}"
                )

    def next_speeds(self, failures: Failures) -> list[float]:
        """Returns the next speed of a climb, m/s; none at its end."""
        search = LimitSearch(SPEED, self.lowest, self.ceiling, self.step, self.fine)
        return search.next_values(self.start, _passes(failures))

    def entry_speed(self, failures: Failures) -> float | None:
        """Returns the entry speed of a climb that has ended, m/s; None if completed at no speed."""
        held = Bracket.from_verdicts(_passes(failures)).held
        return held if failures.get(held) == "" else None

    def ended_by(self, failures: Failures) -> str:
        """Returns the rule that ended a climb; `lateral` where the lateral acceleration was always
        too low, empty at the ceiling.
        """
        bracket = Bracket.from_verdicts(_passes(failures))
        failed = failures.get(bracket.lost, "")
        if failures.get(bracket.held) and not failed.startswith(ERROR):
            return LATERAL
        return failed

    def next_confirmations(self, entry: float | None, failures: Failures) -> list[float]:
        """Returns the next speed that is tried at the fine step, m/s; none at the end.

        Args:
            entry: that the climb found, m/s, if any.
            failures: at the fine step.
        """
        if entry is None or len(failures) > MAX_STEP_BACKS or "" in failures.values():
            return []
        speed = rounded(entry - self.fine * len(failures))
        return [speed] if speed >= self.lowest else []


def _passes(failures: Failures) -> dict[float, bool | None]:
    """Returns which speeds a climb passes: completed ones, and below them those with too little
    lateral acceleration.
    """
    passes: dict[float, bool | None] = {}
    completed = False
    for speed in sorted(failures):
        failed = failures[speed]
        completed = completed or not failed
        passes[speed] = not failed or (failed == LATERAL and not completed)
    return passes
