"""Search of a motion: the bound of training cars as a swing file, with the steering that the full
car holds, compared with the other candidates there.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from aerodima.optimisation.studies.runs import FINE_STEP, CachedRunner
from aerodima.optimisation.swerve.suite import BOUND, SUITE, ensemble_cases, select_candidates
from aerodima.optimisation.swing.bound import BoundEffort, find_bound
from aerodima.optimisation.swing.comparison import compare_swerves
from aerodima.optimisation.swing.full_runs import Descent, confirm_best, drive_shares
from aerodima.optimisation.swing.solution import solution_swing
from aerodima.optimisation.swing.swerve_shooting import LIMITS, Limit
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import write_swing

DEFAULT_SPEED = 6.0
"""Speed of a motion unless another is asked for, m/s."""


NOT_COMPARED = ("bound", "rollover-control", "feedback-rollover-control")
"""Candidates of the suite that a motion is not compared with: itself, and drivers at full lock."""


def search_motion(
    path: Path,
    aim: str,
    limits: Sequence[str],
    cars: int,
    runs: CachedRunner,
    effort: BoundEffort,
    *,
    ensemble: str,
    tail: str,
    floors: Sequence[float],
    speeds: Sequence[float] = (DEFAULT_SPEED,),
    step: float = FINE_STEP,
) -> tuple[pd.DataFrame, bool]:
    """Searches one motion for the first training cars of an ensemble, and writes it.

    Args:
        path: of the swing file.
        aim: name, or a function of a file, `mine.py:my_aim`.
        limits: such as `roll=0.3`, see `LIMITS`.
        cars: how many.
        runs: where the full car is driven.
        effort: of the search.
        ensemble, tail, floors, speeds: as of `judge`; the cars on all of them have one motion.
        step: of the plant of the full car, s.

    Returns:
        A row per candidate, car and speed, see `compare_swerves`; whether the motion is above every
        other candidate on the first car.

    Raises:
        UserError: a limit that there is not; no motion that keeps all limits.
    """
    cases = ensemble_cases(ensemble, "training", cars, tail, floors, effort.seed)
    places = [(case, speed) for case in cases for speed in speeds]
    settings = [
        (*case.settings(), *BOUND.settings, f"manoeuvre.speed={speed!r}") for case, speed in places
    ]
    scenarios = [load_scenario("swerve", one) for one in settings]
    bound = find_bound(scenarios, aim, read_limits(limits), effort)
    write_swing(solution_swing(path.stem, settings[0], bound, aim), path, force=True)
    player = (*settings[0], f"controller.swing_file={path.resolve()}")
    descent = Descent(BOUND, *places[0], aim, player, bound.result, step)
    drive_shares([descent], runs)
    confirm_best([descent], runs)
    row = descent.as_row()
    value = row["value"]
    if value is None:
        raise SwingError(f"{path}: the full car stays upright with no share of the steering")
    swing = solution_swing(path.stem, settings[0], bound, aim, value, row["share"])
    write_swing(swing, path, force=True)
    others = select_candidates([name for name in SUITE.default if name not in NOT_COMPARED])
    (case, speed) = places[0]
    table = compare_swerves(others, [case], [speed], [aim], runs, path.parent, step=step)
    best_other = table["value"].max()
    table = pd.concat([pd.DataFrame([row]), table], ignore_index=True)
    return table, not best_other >= value


def read_limits(texts: Sequence[str]) -> list[Limit]:
    """Reads limits such as `roll=0.3`; SwingError for one that there is not."""
    limits = []
    for text in texts:
        name, _, number = text.partition("=")
        if name not in LIMITS:
            raise SwingError(f"limit {text}: {nearest(name, list(LIMITS))}")
        try:
            limits.append(LIMITS[name](float(number)))
        except ValueError:
            raise SwingError(f"limit {text}: must be {name}=NUMBER") from None
    return limits
