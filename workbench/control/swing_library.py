"""Swings by name: the swing of a scenario, the car it is for, the turn it claims to survive."""

from pathlib import Path
from typing import Any

from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import ScenarioError, SwingFileError
from aerodima.workbench.core.file_reading import Json, Settings
from aerodima.workbench.core.yaml_files import find_file
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import (
    SwingFile,
    car_mismatches,
    read_swing,
    swing_at,
)

NO_SWING = "none"
"""Name of a swing file where there is none."""
SWING = "swing"
"""Key of a swing in the metadata of a log and in a bundle."""
DEFAULT_TURN = "turn_swing"
"""Scenario of a swing whose file names none."""
_PLAYED = "tail.mode=swing"
"""Setting of a scenario whose tail plays a swing file."""
_CLAIMS = {
    "survived_speed_m_per_s": ("manoeuvre.speed", "{:g} m/s"),
    "survived_friction": ("car.tyre_friction", "friction {:g}"),
}
"""Claims of a file about what it survives: the key of a scenario and the words for each name under
`provenance.found`."""


def find_swing(name_or_path: str | Path) -> SwingFile:
    """Reads a swing by path, or by name from `models/swings`.

    Raises:
        SwingFileError: missing or malformed.
    """
    return read_swing(find_file(name_or_path, "swings", "swing", SwingFileError))


def swing_of_scenario(scenario: Any) -> SwingFile | None:
    """Returns the swing that `scenario.controller.swing_file` names; None for the thesis' law, or
    when no tail swings.
    """
    name = scenario.controller.swing_file
    mode = scenario.tail.mode
    law = scenario.controller.law
    if name == NO_SWING or (mode, law) != ("swing", "swing"):
        return None
    return find_swing(name)


def resting_tail(scenario: Any) -> Pair:
    """Returns roll and pitch (rad) of the tail at the start of a run: those of the first knot if a
    swing is played, else those at which the law waits.
    """
    swing = swing_of_scenario(scenario)
    if swing is None:
        return scenario.resting_roll, scenario.resting_pitch
    waiting = swing_at(swing, 0.0, scenario.manoeuvre.direction)
    return float(waiting.roll_position), float(waiting.pitch_position)


def swing_facts(scenario: Any) -> Json:
    """Returns the whole swing that a scenario names, for `extra` of a run log, which must suffice
    to repeat the run.
    """
    swing = swing_of_scenario(scenario)
    if swing is None:
        return {}
    return {SWING: swing.plain()}


def refuse_other_car(scenario: Any) -> None:
    """Raises SwingFileError, naming every parameter that differs, when a scenario plays a swing for
    another car than its own.
    """
    swing = swing_of_scenario(scenario)
    if swing is None:
        return
    differences = car_mismatches(swing, scenario.resolved())
    if differences:
        raise SwingFileError(
            f"swing {swing.name}: made for another car: {'; '.join(differences)}; must be the "
            "same car, or with --other-car"
        )


def turn_of_swing(swing: SwingFile, scenario: str | None = None) -> tuple[str, Settings]:
    """Returns the scenario and overrides with which a swing is driven: the car, turn and speed of
    its file, at the grip it claims.

    Args:
        swing: swing file; the scenario is `turn_swing` where the file names none.
        scenario: scenario that is used instead; the only override is then that the tail swings.

    Raises:
        SwingFileError: the scenario that the file names cannot be loaded, or a claim that is no
            number.
    """
    if scenario is not None:
        return scenario, (_PLAYED,)
    made = swing.provenance
    claimed = (f"{key}={value!r}" for key, value in _claims(swing).items())
    name = made.scenario or DEFAULT_TURN
    settings = (*made.settings, *claimed, _PLAYED)
    try:
        load_scenario(name, settings)
    except ScenarioError as error:
        raise SwingFileError(
            f"swing {swing.name}: its own turn: {error}; allowed: another scenario beside it"
        ) from None
    return name, settings


def _claims(swing: SwingFile) -> dict[str, float]:
    """Returns the speed and friction that the file of a swing claims to survive, by their keys."""
    claims: dict[str, float] = {}
    for fact, (key, _) in _CLAIMS.items():
        value = swing.provenance.found.get(fact)
        if isinstance(value, str):
            raise SwingFileError(
                f"swing {swing.name}: provenance.found.{fact}: {value!r}; must be a number"
            )
        if value is not None:
            claims[key] = float(value)
    return claims


def turn_words(swing: SwingFile, scenario: Any) -> str:
    """Returns the speed and friction of a turn in words, beside those with which the file of its
    swing claims to survive.
    """
    here = {
        "manoeuvre.speed": scenario.manoeuvre.speed,
        "car.tyre_friction": scenario.car.tyre_friction,
    }
    claims = _claims(swing)
    claim = f"{_claim_words(here)}; its file claims "
    if not claims:
        return f"{claim}no speed or friction"
    return claim + ("that" if here | claims == here else _claim_words(claims))


def _claim_words(values: dict[str, float]) -> str:
    return ", ".join(words.format(values[key]) for key, words in _CLAIMS.values() if key in values)
