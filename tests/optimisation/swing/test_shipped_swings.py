"""Every optimised swing that ships can be made again from its own provenance."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.swing.full_car import Reference, drive, outcome, varied
from aerodima.optimisation.swing.search_state import SearchOptions
from aerodima.optimisation.swing.swing_construction import changed
from aerodima.optimisation.swing.swing_search import optimise_swing
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile, car_mismatches, read_swing
from aerodima.workbench.controllers.law_of_scenario import find_swing
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.resources import models_dir

SWINGS = [
    swing
    for swing in map(read_swing, sorted((models_dir() / "swings").glob("*.yaml")))
    if swing.provenance.source == "aerodima optimise swing"
]
NAMES = [swing.name for swing in SWINGS]
REFINED = [swing for swing in SWINGS if "polish_changes" in swing.provenance.found]


@pytest.mark.parametrize("swing", SWINGS, ids=NAMES)
def test_it_fits_the_car_that_it_was_made_for_and_states_its_error(swing: SwingFile) -> None:
    made_from = swing.provenance
    assert made_from.scenario is not None
    assert not car_mismatches(swing, load_scenario(made_from.scenario, list(made_from.settings)).resolved())
    assert float(made_from.found["collocation_error_rad"]) <= float(made_from.options["bound"])


@cache
def collocated(scenario: str, settings: tuple[str, ...], options: tuple[tuple[str, Any], ...]) -> SwingFile:
    """The swing before its refinement; swings that differ in nothing else share it."""
    return optimise_swing(load_scenario(scenario, list(settings)), SearchOptions(**dict(options)), name="again")


def made_again(swing: SwingFile) -> SwingFile:
    """The changes of a refinement are taken from the file: searching for them again takes minutes."""
    made_from = swing.provenance
    assert made_from.scenario is not None
    options = {key: value for key, value in made_from.options.items() if key not in ("polish", "feedback")}
    options["rounds"] = made_from.found.get("rounds", options["rounds"])  # those after it brought nothing
    if "warm_start" in options:
        again = find_swing(str(options["warm_start"]))
    else:
        again = collocated(made_from.scenario, made_from.settings, tuple(sorted(options.items())))
    if swing not in REFINED:
        assert again.provenance.found["survived_friction"] == made_from.found["survived_friction"]
        return again
    x = np.array([float(value) for value in str(made_from.found["polish_changes"]).split()])
    return changed(again, x, int(made_from.options["dof"]))


@pytest.mark.slow
@pytest.mark.parametrize("swing", SWINGS, ids=NAMES)
def test_it_is_found_again_from_its_provenance(swing: SwingFile) -> None:
    again = made_again(swing)
    assert again.trigger.threshold_rad_per_s == pytest.approx(swing.trigger.threshold_rad_per_s)
    for joint in ("roll", "pitch"):
        before, after = swing.knots.states(joint), again.knots.states(joint)  # type: ignore[arg-type]
        assert np.allclose(after[0], before[0], atol=1e-3)
        assert np.allclose(after[1], before[1], atol=2e-2)


def turn_of(swing: SwingFile, **changes: Any) -> Scenario:
    made_from, found = swing.provenance, swing.provenance.found
    assert made_from.scenario is not None
    scenario = load_scenario(made_from.scenario, list(made_from.settings))
    return varied(scenario, manoeuvre={"speed": float(found["survived_speed_m_per_s"])}, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("swing", REFINED, ids=[swing.name for swing in REFINED])
def test_a_refined_swing_turns_as_far_as_the_published_one(swing: SwingFile) -> None:
    """At the step of the search, and at the highest friction that the published swing survives at the fine one."""
    scenario, common = turn_of(swing), float(swing.provenance.found["reference_friction"])
    reference, turned = (
        outcome(drive(car, played, common)) for car, played in ((Reference.turn(scenario), None), (scenario, swing))
    )
    assert turned.clean
    assert turned.heading / reference.heading >= LEAST_HEADING
    assert turned.heading / reference.heading == pytest.approx(float(swing.provenance.found["heading_ratio"]), abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("swing", REFINED, ids=[swing.name for swing in REFINED])
def test_it_survives_at_the_fine_step_what_it_says(swing: SwingFile) -> None:
    found = swing.provenance.found
    fine = turn_of(swing, simulation={"step": float(found["fine_step_s"]), "log_rate": 500.0})
    highest = outcome(drive(fine, swing, float(found["survived_friction"])))
    assert float(found["survived_friction"]) > float(found["reference_friction"])
    assert highest.clean
    assert highest.peak_roll <= float(found["peak_roll_rad"]) + 0.01
