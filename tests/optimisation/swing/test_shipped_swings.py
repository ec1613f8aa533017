"""Every optimised swing that ships can be made again from its own provenance."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from optimisation.swing.candidate import Reference
from optimisation.swing.full_car import LEAST_HEADING, drive, outcome, varied
from optimisation.swing.optimise import Options, optimise_swing
from optimisation.swing.shape import changed
from workbench.controllers.law_of_scenario import find_swing
from workbench.resources import models_dir
from workbench.scenario import load_scenario
from workbench.swing_file import SwingFile, car_mismatches, read_swing

SWINGS = [
    swing
    for swing in map(read_swing, sorted((models_dir() / "swings").glob("*.yaml")))
    if swing.provenance.source == "aerodima optimise swing"
]
NAMES = [swing.name for swing in SWINGS]
POLISHED = [swing for swing in SWINGS if "polish_changes" in swing.provenance.found]


def test_one_ships() -> None:
    assert SWINGS
    assert POLISHED


@pytest.mark.parametrize("swing", SWINGS, ids=NAMES)
def test_it_fits_the_car_that_it_was_made_for_and_states_its_error(swing: SwingFile) -> None:
    made_from = swing.provenance
    assert made_from.scenario is not None
    assert not car_mismatches(swing, load_scenario(made_from.scenario, list(made_from.settings)).resolved())
    assert float(made_from.found["collocation_error_rad"]) <= float(made_from.options["bound"])


@cache
def collocated(scenario: str, settings: tuple[str, ...], options: tuple[tuple[str, Any], ...]) -> SwingFile:
    """The swing before its polish; swings that differ in nothing else share it."""
    return optimise_swing(load_scenario(scenario, list(settings)), Options(**dict(options)), name="again")


def made_again(swing: SwingFile) -> SwingFile:
    """The changes of a polish are taken from the file: searching for them again takes minutes."""
    made_from = swing.provenance
    assert made_from.scenario is not None
    options = {key: value for key, value in made_from.options.items() if key not in ("polish", "feedback")}
    if "warm_start" in options:
        again = find_swing(str(options["warm_start"]))
    else:
        again = collocated(made_from.scenario, made_from.settings, tuple(sorted(options.items())))
    if swing not in POLISHED:
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


@pytest.mark.slow
@pytest.mark.parametrize("swing", POLISHED, ids=[swing.name for swing in POLISHED])
def test_a_polished_swing_turns_as_far_and_survives_what_it_says(swing: SwingFile) -> None:
    made_from, found = swing.provenance, swing.provenance.found
    assert made_from.scenario is not None
    scenario = varied(
        load_scenario(made_from.scenario, list(made_from.settings)),
        manoeuvre={"speed": float(found["survived_speed_m_per_s"])},
    )
    common, limit = float(found["reference_friction"]), float(found["survived_friction"])
    assert limit > common
    reference = outcome(drive(Reference.turn(scenario), None, common))
    turned, highest = outcome(drive(scenario, swing, common)), outcome(drive(scenario, swing, limit))
    assert reference.clean
    assert turned.clean
    assert highest.clean
    assert turned.heading / reference.heading >= LEAST_HEADING
    assert turned.heading / reference.heading == pytest.approx(float(found["heading_ratio"]), abs=0.01)
    assert highest.peak_roll == pytest.approx(float(found["peak_roll_rad"]), abs=0.03)
