"""Numbers of a tail that a bound searches together with its motion: which tail for this swerve?"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.scenario.scenario import Scenario

MARGIN = 1e-3
"""Share of a range by which a search stays inside it at either end: more than differences and the
tolerance of the solver need."""
FIXED = {"mode", "roll_limit", "pitch_limit"}
"""Parameters of the tail that a search reads from the scenarios as they are."""


@dataclass(frozen=True)
class FreeTail:
    """Numbers of the tail that are searched together with its motion, the same for all cars.

    Attributes:
        ranges: least and largest value of each number, by its name.
        build: function of a car's scenario and the numbers, in the order of `ranges`, that returns
            the scenario of the car with this tail. It changes the tail alone, but none of `FIXED`.
    """

    ranges: Mapping[str, Pair]
    build: Callable[..., Scenario]

    @property
    def bounds(self) -> tuple[Pair, ...]:
        """Ends of the ranges of a search, inside `ranges` by `MARGIN`."""
        insets = [(low, high, MARGIN * (high - low)) for low, high in self.ranges.values()]
        return tuple((low + inset, high - inset) for low, high, inset in insets)

    def check(self, scenarios: Sequence[Scenario]) -> None:
        """Builds the tail of each car at all corners of the ranges.

        Raises:
            UserError: a range without extent; a tail that cannot exist; a `build` that changes more
                than it may.
        """
        for name, (least, largest) in self.ranges.items():
            if not -math.inf < least < largest < math.inf:
                raise SwingError(
                    f"free number {name}: {least:g} to {largest:g}; must go from a number to a "
                    "larger one"
                )
        for numbers in product(*self.ranges.values()):
            for scenario in scenarios:
                built = self.build(scenario, *numbers)
                tail = built.tail.model_dump(exclude=FIXED)
                if built.resolved() != scenario.varied(tail=tail).resolved():
                    raise SwingError(
                        f"FreeTail.build: {scenario.name} differs in more than its tail, or in one "
                        f"of {', '.join(sorted(FIXED))}; these must stay as they are"
                    )
