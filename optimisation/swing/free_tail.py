"""Numbers of a tail that a bound searches together with its motion: the best tail for a swerve."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.scenario.scenario import Scenario


@dataclass(frozen=True)
class FreeTail:
    """Numbers of the tail that are searched together with its motion, the same for all cars.

    Attributes:
        ranges: least and largest value of each number, by its name.
        build: function of a car's scenario and the numbers, in the order of `ranges`, that returns
            the scenario of the car with this tail.
    """

    ranges: Mapping[str, Pair]
    build: Callable[..., Scenario]

    def check(self, scenarios: Sequence[Scenario]) -> None:
        """Builds the tail of each car at the lower and at the upper ends of all ranges.

        Raises:
            UserError: a range without extent; a tail that cannot exist.
        """
        for name, (least, largest) in self.ranges.items():
            if not -math.inf < least < largest < math.inf:
                raise SwingError(
                    f"free number {name}: {least:g} to {largest:g}; must go from a number to a "
                    "larger one"
                )
        for numbers in zip(*self.ranges.values(), strict=True):
            for scenario in scenarios:
                self.build(scenario, *numbers)
