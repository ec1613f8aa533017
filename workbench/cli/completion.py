"""What the shell offers for a value, `aerodima --install-completion`."""

from __future__ import annotations

from collections.abc import Callable

Completer = Callable[[str], list[str]]


def completer(*values: str) -> Completer:
    """Offers fixed values."""

    def complete(incomplete: str) -> list[str]:
        return [value for value in values if value.startswith(incomplete)]

    return complete


def complete_scenario(incomplete: str) -> list[str]:
    """Offers the scenarios that ship."""
    return _names("scenarios", incomplete)


def complete_swing(incomplete: str) -> list[str]:
    """Offers the swings that ship."""
    return _names("swings", incomplete)


def _names(folder: str, incomplete: str) -> list[str]:
    from aerodima.workbench.resources import models_dir

    return sorted(path.stem for path in (models_dir() / folder).glob(f"{incomplete}*.yaml"))
