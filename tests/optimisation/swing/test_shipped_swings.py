"""Every optimised swing that ships can be made again from its own provenance."""

from __future__ import annotations

import numpy as np
import pytest

from optimisation.swing.optimise import Options, optimise_swing
from workbench.resources import models_dir
from workbench.scenario import load_scenario
from workbench.swing_file import SwingFile, car_mismatches, read_swing

SWINGS = [
    swing
    for swing in map(read_swing, sorted((models_dir() / "swings").glob("*.yaml")))
    if swing.provenance.source == "aerodima optimise swing"
]
NAMES = [swing.name for swing in SWINGS]


def test_one_ships() -> None:
    assert SWINGS


@pytest.mark.parametrize("swing", SWINGS, ids=NAMES)
def test_it_fits_the_car_that_it_was_made_for_and_states_its_error(swing: SwingFile) -> None:
    made_from = swing.provenance
    assert made_from.scenario is not None
    assert not car_mismatches(swing, load_scenario(made_from.scenario, list(made_from.settings)).resolved())
    assert float(made_from.found["collocation_error_rad"]) <= float(made_from.options["bound"])


@pytest.mark.slow
@pytest.mark.parametrize("swing", SWINGS, ids=NAMES)
def test_it_is_found_again_from_its_provenance(swing: SwingFile) -> None:
    made_from = swing.provenance
    assert made_from.scenario is not None
    options = Options(**made_from.options)  # type: ignore[arg-type]
    again = optimise_swing(load_scenario(made_from.scenario, list(made_from.settings)), options, name=swing.name)
    for joint in ("roll", "pitch"):
        before, after = swing.knots.states(joint), again.knots.states(joint)  # type: ignore[arg-type]
        assert np.allclose(after[0], before[0], atol=1e-3)
        assert np.allclose(after[1], before[1], atol=1e-2)
    assert again.provenance.found["survived_friction"] == made_from.found["survived_friction"]
