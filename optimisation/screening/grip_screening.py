"""Critical friction of many cars with their laws, on reduced cars: which of them the full car should drive."""

from __future__ import annotations

from collections.abc import Sequence

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.rollover_threshold import FRICTION_SEARCH, Search, Start, Threshold, search_rows
from aerodima.workbench.config.scenario import Scenario


def screened_friction(
    scenarios: Sequence[Scenario], search: Search = FRICTION_SEARCH, start: Start = "bisect"
) -> list[Threshold]:
    """The threshold of clean runs of every scenario, all of them driven at once.

    Args:
        scenarios: turns; their own friction does not matter.
        search: range and grid of friction.
        start: how each search begins, as for the full car (`rollover_threshold`).

    Raises:
        UserError: what `Vehicles.of` refuses.
    """
    cars, plans = Vehicles.of(scenarios), TurnPlans.of(scenarios)

    def run(wanted: Sequence[tuple[int, float]]) -> list[bool]:
        places, frictions = [place for place, _ in wanted], [value for _, value in wanted]
        turns = drive_turns(cars.take(places).with_friction(frictions), plans.take(places))
        return [bool(clean) for clean in turns.clean]

    return search_rows(search, [start] * len(scenarios), run, bool)
