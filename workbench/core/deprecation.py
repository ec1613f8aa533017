"""Old names of functions that were renamed, kept for one version."""

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

from typing_extensions import deprecated

REMOVED_IN = "0.5"
"""Version in which the old names are removed."""
Function = TypeVar("Function", bound=Callable[..., Any])


def warn_renamed(old: str, new: str) -> None:
    """Warns the caller of the caller that a name has changed."""
    warnings.warn(_say_renamed(old, new), DeprecationWarning, stacklevel=3)


def renamed(old: str, function: Function) -> Function:
    """Returns a function for use under its old name; a call warns and gives the new name."""
    return deprecated(_say_renamed(old, function.__name__))(function)


def _say_renamed(old: str, new: str) -> str:
    return f"{old} is now {new}; the old name goes with version {REMOVED_IN}"
