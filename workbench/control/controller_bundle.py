"""A scenario in one JSON file that needs no other: resolved, with its swing inside."""

from collections.abc import Sequence
from pathlib import Path

from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.swing_library import SWING, swing_facts
from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.file_reading import Json, read_json
from aerodima.workbench.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from aerodima.workbench.scenario.swing_file import swing_from_dict


def make_bundle(scenario: Scenario) -> Json:
    """Returns the scenario as plain data, with the swing that it names, if any, under `swing`.

    Raises:
        SwingFileError: the swing is missing or malformed.
    """
    return scenario.resolved() | swing_facts(scenario)


def load_drive(name_or_path: str, settings: Sequence[str] = ()) -> tuple[Scenario, TailLaw]:
    """Returns the scenario and tail law of a bundle (`.json`), a scenario file or the name of one
    that ships.

    Args:
        name_or_path: scenario as `load_scenario` takes it, or path of a bundle.
        settings: overrides such as `manoeuvre.speed=3`; not for a bundle, which is what was
            exported.

    Raises:
        UserError: wrong scenario, swing or bundle; names the file and what is allowed.
    """
    path = Path(name_or_path)
    if path.suffix != ".json":
        scenario = load_scenario(name_or_path, settings)
        return scenario, law_of_scenario(scenario)
    if settings:
        raise ScenarioError(
            f"--set {' '.join(settings)}: {path} is a bundle; allowed: set it before the export"
        )
    data = read_json(path, ScenarioError)
    if not isinstance(data, dict):
        raise ScenarioError(
            f"{path}: holds a {type(data).__name__}; allowed is a bundle of `aerodima models "
            "export`"
        )
    swing = data.pop(SWING, None)
    scenario = scenario_from_dict(data, str(path))
    if swing is None:
        return scenario, law_of_scenario(scenario)
    return scenario, SwingPlayer.from_scenario(swing_from_dict(swing, f"{path}: {SWING}"), scenario)
