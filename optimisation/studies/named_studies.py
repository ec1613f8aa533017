"""The studies that are built in, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerodima.workbench.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.studies.study_report import Findings
    from aerodima.optimisation.sweep.study import Study

    Reader = Callable[[pd.DataFrame], Findings]
    """What a study's table says."""
    Factory = Callable[..., tuple[Study, Reader]]


def _read_from(module: str, name: str) -> Factory:
    def make(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
        found = import_module(f"aerodima.optimisation.studies.{module}")
        return getattr(found, f"{name}_study")(settings, ensemble, members), getattr(found, f"read_{name}")

    return make


def _shapes(
    settings: Sequence[str], ensemble: str | None, members: int | None, goals: Path | None = None
) -> tuple[Study, Reader]:
    """goals: table of CFD goals (CSV); None: that of the thesis."""
    from aerodima.optimisation.studies.shape_study import load_goals, published_goals, read_shapes, shapes_study

    table = published_goals() if goals is None else load_goals(goals)
    return shapes_study(table, settings, ensemble, members), partial(read_shapes, table)


def _monte_carlo(
    settings: Sequence[str], ensemble: str | None, members: int | None, samples: int = 32, seed: int = 1
) -> tuple[Study, Reader]:
    """samples: per tail mode."""
    from aerodima.optimisation.studies.survival_study import monte_carlo_study, read_monte_carlo

    return monte_carlo_study(samples, seed, settings, ensemble, members), read_monte_carlo


STUDIES: dict[str, Factory] = {
    "turn": _read_from("turn_study", "turn"),
    "tail": _read_from("grip_study", "tail"),
    "mount": _read_from("mount_study", "mount"),
    "trigger": _read_from("grip_study", "trigger"),
    "shapes": _shapes,
    "monte-carlo": _monte_carlo,
}
"""Name -> what makes the study, and what reads its table."""


def named_study(
    name: str, settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None, **own: Any
) -> tuple[Study, Reader]:
    """A study and what reads its table.

    Args:
        name: of `STUDIES`.
        settings: overrides of every run.
        ensemble: name or file; every case is run for its members. members: only that many, drawn by weight.
        own: what this study alone has, such as `samples` of `monte-carlo`.

    Raises:
        UserError: unknown name; lists all.
    """
    if name not in STUDIES:
        raise UserError(f"study {name!r}: allowed: {', '.join(STUDIES)}")
    return STUDIES[name](settings, ensemble, members, **own)
