"""The studies that are built in, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
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


def _turn(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
    """Speed x tail mode x tail speed: 20 runs without tail, 48 with it (thesis Figures 7.8 and 7.10 to 7.13)."""
    from aerodima.optimisation.studies.turn_study import read_turn, turn_study

    return turn_study(settings, ensemble, members), read_turn


def _tail(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
    """What tail is worth building: critical friction over its length, width, mass and C_N; inertial tails beside."""
    from aerodima.optimisation.studies.grip_study import read_tail, tail_study

    return tail_study(settings, ensemble, members), read_tail


def _mount(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
    """Yaw penalty of a swing and its remedies: place of the tail, ballast in front, longer steering (Figure 7.9)."""
    from aerodima.optimisation.studies.mount_study import mount_study, read_mount

    return mount_study(settings, ensemble, members), read_mount


def _trigger(settings: Sequence[str], ensemble: str | None, members: int | None) -> tuple[Study, Reader]:
    """When the swing should begin: yaw rate, lateral acceleration or delayed steering; delay and travel (6.3.4)."""
    from aerodima.optimisation.studies.grip_study import read_trigger, trigger_study

    return trigger_study(settings, ensemble, members), read_trigger


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
    "turn": _turn,
    "tail": _tail,
    "mount": _mount,
    "trigger": _trigger,
    "shapes": _shapes,
    "monte-carlo": _monte_carlo,
}
"""Name -> what makes the study, and what reads its table. Its text is the help of `aerodima sweep NAME`, unless that
has options of its own (`aerodima.optimisation.commands.study_commands`)."""


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
