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


def _of_its_module(name: str) -> Factory:
    def make(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
        module = import_module(f"aerodima.optimisation.studies.{name}_study")
        return getattr(module, f"{name}_study")(settings, ensemble, members), getattr(module, f"read_{name}")

    return make


def _shapes(
    settings: Sequence[str], ensemble: str | None, members: int | None, goals: Path | None = None
) -> tuple[Study, Reader]:
    """goals: table of CFD goals (CSV); None: that of the thesis."""
    from aerodima.optimisation.studies.shape_goals import load_goals, published_goals
    from aerodima.optimisation.studies.shape_study import read_shapes, shapes_study

    table = published_goals() if goals is None else load_goals(goals)
    return shapes_study(table, settings, ensemble, members), partial(read_shapes, table)


def _monte_carlo(
    settings: Sequence[str], ensemble: str | None, members: int | None, samples: int = 32, seed: int = 1
) -> tuple[Study, Reader]:
    """samples: per tail mode."""
    from aerodima.optimisation.studies.monte_carlo_study import monte_carlo_study, read_monte_carlo

    return monte_carlo_study(samples, seed, settings, ensemble, members), read_monte_carlo


STUDIES: dict[str, Factory] = {
    **{name: _of_its_module(name) for name in ("turn", "tail", "mount", "trigger")},
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
