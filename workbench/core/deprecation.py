"""Old names of functions that were renamed, kept for one version."""

import warnings
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

REMOVED_IN = "0.5"
"""Version without the old names."""
P = ParamSpec("P")
R = TypeVar("R")


def warn_renamed(old: str, new: str) -> None:
    """Warns the caller of the caller that a name has changed."""
    text = f"{old} is now {new}; the old name goes with version {REMOVED_IN}"
    warnings.warn(text, DeprecationWarning, stacklevel=3)


def renamed(old: str, function: Callable[P, R]) -> Callable[P, R]:
    """Makes a function under its old name; a call warns and says the new one."""

    @wraps(function)
    def alias(*args: P.args, **kwargs: P.kwargs) -> R:
        warn_renamed(old, function.__name__)
        return function(*args, **kwargs)

    return alias
