"""Which law drives: that of a scenario or bundle (the thesis' swing, or the player of a swing
file), or one's own.

A bundle is a scenario in one JSON file that needs no other: resolved, with its swing inside; the
no-Drake mode drives it. A law of one's own is a class in a Python file, named as `my_law.py:MyLaw`.
No Drake.
"""

import importlib.util
import json
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from aerodima.workbench.control.feedback_law import FeedbackLaw
from aerodima.workbench.control.swing_law import SwingLaw, SwingSettings
from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import ScenarioError, SwingFileError, UserError
from aerodima.workbench.core.yaml_files import find_file
from aerodima.workbench.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from aerodima.workbench.scenario.swing_file import (
    SwingFile,
    car_mismatches,
    read_swing,
    swing_from_dict,
)

NO_SWING = "none"
_SWING = "swing"
DEFAULT_TURN = "turn_swing"
"""Scenario of a swing whose file names none."""
_PLAYED = "tail.mode=swing"
"""Setting of a scenario whose tail plays a swing file."""
_CLAIMS = {
    "survived_speed_m_per_s": ("manoeuvre.speed", "{:g} m/s"),
    "survived_friction": ("car.tyre_friction", "friction {:g}"),
}
"""What a file claims to survive: name under `provenance.found`, the key of a scenario that it is,
and its words."""
_MEMBERS = ("rate", "memory_size", "start", "step")
"""Members that every tail law has."""
_OURS = ("aerodima", "pydrake")
"""Packages that are never taken for a user's file, which is run as a module of its own."""


def find_swing(name_or_path: str | Path) -> SwingFile:
    """Reads a swing by path, or by name from `models/swings`.

    Raises:
        SwingFileError: missing or malformed.
    """
    return read_swing(find_file(name_or_path, "swings", "swing", SwingFileError))


def swing_of_scenario(scenario: Any) -> SwingFile | None:
    """The swing that `scenario.controller.swing_file` names; None for the thesis' law, or when no
    tail swings.
    """
    name = scenario.controller.swing_file
    mode = scenario.tail.mode
    law = scenario.controller.law
    if name == NO_SWING or (mode, law) != ("swing", "swing"):
        return None
    return find_swing(name)


def swing_facts(scenario: Any) -> dict[str, Any]:
    """The whole swing that a scenario names, for `extra` of a run log, which must suffice to repeat
    the run.
    """
    swing = swing_of_scenario(scenario)
    if swing is None:
        return {}
    return {_SWING: swing.model_dump(mode="json", by_alias=True, exclude_none=True)}


def refuse_other_car(
    scenario: Any, swing: SwingFile | None = None, *, way_out: str = ", or --other-car"
) -> None:
    """Raises SwingFileError, naming every parameter that differs, when a swing is for another car
    than the scenario's.

    Args:
        scenario: the car.
        swing: by default the one that the scenario plays; without any nothing is refused.
        way_out: what is allowed beside the same car, where something is.
    """
    swing = swing or swing_of_scenario(scenario)
    if swing is None:
        return
    differences = car_mismatches(swing, scenario.resolved())
    if differences:
        raise SwingFileError(
            f"swing {swing.name}: made for another car: {'; '.join(differences)}; allowed: the "
            f"same car{way_out}"
        )


def own_turn(swing: SwingFile, scenario: str | None = None) -> tuple[str, tuple[str, ...]]:
    """Scenario and overrides with which a swing is driven: the car, turn and speed of its file, at
    the grip it claims.

    Args:
        swing: the file; `turn_swing` where it names no scenario.
        scenario: asked for instead; nothing but that the tail swings is then set.

    Raises:
        SwingFileError: the scenario that the file names cannot be loaded.
    """
    if scenario is not None:
        return scenario, (_PLAYED,)
    made = swing.provenance
    claimed = (
        f"{key}={float(made.found[fact])!r}"
        for fact, (key, _) in _CLAIMS.items()
        if fact in made.found
    )
    name = made.scenario or DEFAULT_TURN
    settings = (*made.settings, *claimed, _PLAYED)
    try:
        load_scenario(name, settings)
    except ScenarioError as error:
        raise SwingFileError(
            f"swing {swing.name}: its own turn: {error}; allowed: another scenario beside it"
        ) from None
    return name, settings


def turn_words(swing: SwingFile, scenario: Any) -> str:
    """Speed and friction of a turn in words, beside those with which the file of its swing claims
    to survive.
    """
    here = {
        "manoeuvre.speed": scenario.manoeuvre.speed,
        "car.tyre_friction": scenario.car.tyre_friction,
    }
    found = swing.provenance.found
    claims = {key: float(found[fact]) for fact, (key, _) in _CLAIMS.items() if fact in found}
    claim = f"{_in_claim_words(here)}; its file claims "
    if not claims:
        return f"{claim}nothing"
    return claim + ("that" if here | claims == here else _in_claim_words(claims))


def _in_claim_words(values: dict[str, float]) -> str:
    return ", ".join(words.format(values[key]) for key, words in _CLAIMS.values() if key in values)


def law_of_scenario(scenario: Any) -> TailLaw:
    """The law of `scenario.controller` and `scenario.tail.mode` (any object with these attributes).

    Raises:
        UserError: a setting out of range, a swing file that is missing or malformed.
    """
    if scenario.controller.law == "feedback" and scenario.tail.mode == "swing":
        if scenario.controller.swing_file != NO_SWING:
            raise UserError(
                f"controller.swing_file: {scenario.controller.swing_file}; allowed with law "
                f"feedback: {NO_SWING}"
            )
        return FeedbackLaw.from_scenario(scenario)
    swing = swing_of_scenario(scenario)
    if swing is None:
        return SwingLaw(SwingSettings.from_scenario(scenario))
    return SwingPlayer.from_scenario(swing, scenario)


def make_bundle(scenario: Scenario) -> dict[str, Any]:
    """The scenario as plain data, with the swing that it names, if any, under `swing`.

    Raises:
        SwingFileError: the swing is missing or malformed.
    """
    return scenario.resolved() | swing_facts(scenario)


def load_drive(name_or_path: str, settings: Sequence[str] = ()) -> tuple[Scenario, TailLaw]:
    """Scenario and tail law of a bundle (`.json`), a scenario file or the name of one that ships.

    Args:
        name_or_path: as `load_scenario` takes it, or a bundle.
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
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ScenarioError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(data, dict):
        raise ScenarioError(
            f"{path}: holds a {type(data).__name__}; allowed is a bundle of `aerodima models "
            "export`"
        )
    swing = data.pop(_SWING, None)
    scenario = scenario_from_dict(data, str(path))
    if swing is None:
        return scenario, law_of_scenario(scenario)
    return scenario, SwingPlayer.from_scenario(
        swing_from_dict(swing, f"{path}: {_SWING}"), scenario
    )


def load_law(place: str, scenario: Scenario) -> TailLaw:
    """Makes the law that a flag names: a class in a Python file, `my_law.py:MyLaw`.

    The class is made by its `from_scenario` where it has one, without arguments
    otherwise.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no `TailLaw`; names
            the place.
    """
    maker = _named("--law", place, "class", "my_law.py:MyLaw")
    name = place.rpartition(":")[2]
    try:
        law: Any
        if hasattr(maker, "from_scenario"):
            law = maker.from_scenario(scenario)
        else:
            law = maker()
    except Exception as error:
        raise UserError(f"--law {place}: {name}() failed: {in_words(error)}") from error
    missing = [member for member in _MEMBERS if not hasattr(law, member)]
    if missing:
        raise UserError(
            f"--law {place}: {name} has no {', '.join(missing)}; a tail law has "
            f"{', '.join(_MEMBERS)}"
        )
    found: TailLaw = law
    return found


def load_build(place: str) -> Any:
    """The function that a flag names, `my_diagram.py:build`, which adds what drives a car to its
    diagram.

    Raises:
        UserError: no such file or function, the file fails; names the place.
    """
    return _named("--diagram", place, "function", "my_diagram.py:build")


def _named(flag: str, place: str, kind: str, example: str) -> Any:
    """A class or function of a Python file, which is run, as a script would be."""
    path, _, name = place.rpartition(":")
    if not path or not name.isidentifier():
        raise UserError(
            f"{flag} {place}: allowed: a Python file and a {kind} in it, such as {example}"
        )
    found = getattr(_run_file(flag, Path(path)), name, None)
    if not (isinstance(found, type) if kind == "class" else callable(found)):
        raise UserError(f"{flag} {place}: {path} has no {kind} {name}")
    return found


def _run_file(flag: str, path: Path) -> Any:
    if path.suffix != ".py" or not path.is_file():
        raise UserError(f"{flag} {path}: no such Python file")
    module_name = f"aerodima_law_{path.stem}"
    specification = importlib.util.spec_from_file_location(module_name, path)
    assert specification is not None  # the ending is .py
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[module_name] = module  # dataclasses look there for the names in annotations
    try:
        specification.loader.exec_module(module)
    except Exception as error:
        raise UserError(f"{flag} {path}: running it failed: {in_words(error)}") from error
    return module


def traceback_and_reason(error: BaseException) -> tuple[str, str]:
    """The traceback of an error from the user's first line on, or its last line; and the error in
    one line.
    """
    frames = list(traceback.walk_tb(error.__traceback__))
    theirs = [
        str(frame.f_globals.get("__name__")).partition(".")[0] not in _OURS for frame, _ in frames
    ]
    summary = traceback.StackSummary.extract(
        iter(frames[theirs.index(True) if any(theirs) else -1 :])
    )
    lines = traceback.format_exception_only(error)
    text = "".join(["Traceback (most recent call last):\n", *summary.format(), *lines]).rstrip()
    last = next(
        (place for place, own in zip(reversed(summary), reversed(theirs), strict=False) if own),
        None,
    )
    return text, in_words(error) + (
        f" ({Path(last.filename).name}, line {last.lineno})" if last else ""
    )


def in_words(error: BaseException) -> str:
    """Kind and message of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
