"""A user's own code: a law or a diagram that a flag names, and its errors in words."""

import importlib.util
import sys
import traceback
from pathlib import Path
from typing import Any

from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import Scenario

_MEMBERS = ("rate", "memory_size", "start", "step")
"""Members that every tail law has."""
_OURS = ("aerodima", "importlib", "pydrake")
"""Packages that are never taken for a user's file, which is run as a module of its own."""


def load_law(place: str, scenario: Scenario) -> TailLaw:
    """Makes the law that a flag names: a class in a Python file, `my_law.py:MyLaw`.

    The class is made by its `from_scenario` where it has one, without arguments
    otherwise.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no `TailLaw`; names
            the place.
    """
    maker = load_named("--law", place, "class", "my_law.py:MyLaw")
    name = place.rpartition(":")[2]
    try:
        law: Any
        if hasattr(maker, "from_scenario"):
            law = maker.from_scenario(scenario)
        else:
            law = maker()
    except (Exception, SystemExit) as error:
        raise UserError(f"--law {place}: {name}() failed: {in_words(error)}") from error
    missing = [member for member in _MEMBERS if not hasattr(law, member)]
    if missing:
        raise UserError(
            f"--law {place}: {name} has no {', '.join(missing)}; a tail law has "
            f"{', '.join(_MEMBERS)}"
        )
    return law


def load_build(place: str) -> Any:
    """Returns the function that a flag names, `my_diagram.py:build`, which adds the systems that
    drive a car to its diagram.

    Raises:
        UserError: no such file or function, the file fails; names the place.
    """
    return load_named("--diagram", place, "function", "my_diagram.py:build")


def load_named(flag: str, place: str, kind: str, example: str) -> Any:
    """Returns a class or function of a Python file, which is run, as a script would be."""
    path, _, name = place.rpartition(":")
    if not path or not name.isidentifier():
        raise UserError(
            f"{flag} {place}: allowed: a Python file and a {kind} in it, such as {example}"
        )
    member = getattr(_run_file(flag, Path(path)), name, None)
    if not (isinstance(member, type) if kind == "class" else callable(member)):
        raise UserError(f"{flag} {place}: {path} has no {kind} {name}")
    return member


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
    except (Exception, SystemExit) as error:
        raise UserError(
            f"{flag} {path}: running it failed: {traceback_and_reason(error)[1]}"
        ) from error
    return module


def traceback_and_reason(error: BaseException) -> tuple[str, str]:
    """Returns the traceback of an error from the user's first line on, or its last line; and the
    error in one line.
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
    """Returns the kind and message of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
