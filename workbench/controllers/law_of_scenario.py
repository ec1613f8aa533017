"""The control law that a scenario names: the thesis' swing, or the tracker of a swing file. Plain Python."""

from pathlib import Path
from typing import Any

from aerodima.workbench.config.checked_files import find_file
from aerodima.workbench.config.swing_file import SwingFile, car_mismatches, read_swing
from aerodima.workbench.controllers.swing_law import SwingLaw, SwingSettings
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.errors import SwingFileError

NO_SWING = "none"


def find_swing(name_or_path: str | Path) -> SwingFile:
    """Reads a swing by path, or by name from `models/swings`.

    Raises:
        SwingFileError: missing or malformed.
    """
    return read_swing(find_file(name_or_path, "swings", "swing", SwingFileError))


def swing_of_scenario(scenario: Any) -> SwingFile | None:
    """The swing that `scenario.controller.swing_file` names; None for the thesis' law, or when no tail swings."""
    name = scenario.controller.swing_file
    return None if name == NO_SWING or scenario.tail.mode != "swing" else find_swing(name)


def swing_facts(scenario: Any) -> dict[str, Any]:
    """The whole swing that a scenario names, for `extra` of a run log, which must suffice to repeat the run."""
    swing = swing_of_scenario(scenario)
    return {} if swing is None else {"swing": swing.model_dump(mode="json", by_alias=True, exclude_none=True)}


def refuse_other_car(scenario: Any) -> None:
    """Raises SwingFileError, naming every parameter that differs, when the scenario's swing is for another car."""
    swing = swing_of_scenario(scenario)
    if swing is None:
        return
    differences = car_mismatches(swing, scenario.resolved())
    if differences:
        raise SwingFileError(
            f"swing {swing.name}: made for another car: {'; '.join(differences)}; allowed: the same car, or --other-car"
        )


def law_of_scenario(scenario: Any) -> TailLaw:
    """The law of `scenario.controller` and `scenario.tail.mode` (any object with these attributes).

    Raises:
        UserError: a setting out of range, a swing file that is missing, malformed or without the gains it needs.
    """
    swing = swing_of_scenario(scenario)
    if swing is None:
        return SwingLaw(SwingSettings.from_scenario(scenario))
    return SwingTracker.from_scenario(swing, scenario)
