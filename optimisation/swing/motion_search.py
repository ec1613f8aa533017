"""Search of a motion: the bound of training cars as a swing file, with the steering with which the
full car's swerve still counts, compared with the other candidates on the full car.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from aerodima.optimisation.studies.runs import FINE_STEP, CachedRunner
from aerodima.optimisation.swerve.suite import (
    BOUND,
    SUITE,
    candidate_settings,
    ensemble_cases,
    select_candidates,
)
from aerodima.optimisation.swing.bound import BoundEffort
from aerodima.optimisation.swing.comparison import BoundItem, compare_swerves
from aerodima.optimisation.swing.solution import AIM_VALUE
from aerodima.optimisation.swing.verification import verify_swing
from aerodima.workbench.scenario.swing_file import swing_from_dict, write_swing

DEFAULT_SPEED = 6.0
"""Speed of a motion unless another is asked for, m/s."""
NOT_COMPARED = ("bound", "rollover-control", "feedback-rollover-control")
"""Candidates of the suite that a motion is not compared with: itself, and drivers at full lock."""
FOLDER = "motions"
"""Folder of the motion that is not verified yet, beside the swing file."""
SWING_KEY = "controller.swing_file="
"""Beginning of the setting of a swing file."""


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
) -> tuple[pd.DataFrame, list[str]]:
    """Searches one motion for the first training cars of an ensemble, and writes it.

    The file claims what `verify_swing` accepts on the first car; that of a motion that is refused
    claims nothing, and names the complaints. No file is written if no full run counts.

    Args:
        path: path of the swing file.
        aim: name of the aim, or function of a file, `mine.py:my_aim`.
        limits: limits of the motion, such as `roll=0.3`, see `LIMITS`.
        cars: number of training cars.
        runs: runner of the searches and of the full car's runs.
        effort: budget of the search.
        ensemble, tail, floors, speeds: as in `judge`; one motion serves all cars on all of them.
        step: step of the plant of the full car, s.

    Returns:
        A row per candidate, see `compare_swerves`; what is wrong with the motion: complaints of its
        verification, or that it is not above every other candidate on the first car.

    Raises:
        UserError: no motion keeps all limits.
    """
    cases = ensemble_cases(ensemble, "training", cars, tail, floors, effort.seed)
    (case, speed), *more = [(case, speed) for case in cases for speed in speeds]
    others = tuple(candidate_settings(BOUND, *place)[0] for place in more)
    chosen = select_candidates([name for name in SUITE.default if name not in NOT_COMPARED])
    bound = BoundItem(effort=effort, others=others, limits=tuple(limits))
    table = compare_swerves(
        [*chosen, BOUND],
        [case],
        [speed],
        [aim],
        runs,
        path.parent / FOLDER,
        bound=bound,
        step=step,
    )
    *_, row = table.to_dict("records")  # a bound is searched after all others
    if not row["settings"]:
        return table, ["the full car stays upright with no share of the steering"]
    runs.say("verification ...")
    complaints = write_verified(path, json.loads(row["settings"]))
    if not complaints and table["value"][:-1].max() >= row["value"]:
        complaints = ["the motion is not better than every other candidate"]
    return table, complaints


def write_verified(path: Path, settings: Sequence[str]) -> list[str]:
    """Verifies the motion of a full run and writes it, with the value of its aim if it is accepted.

    Args:
        path: path of the swing file that is written.
        settings: settings of the run on `swerve`, with its swing file and step.

    Returns:
        Complaints; the file also holds them, and then claims nothing.
    """
    (tried,) = (one.partition("=")[2] for one in settings if one.startswith(SWING_KEY))
    own = [one for one in settings if not one.startswith((SWING_KEY, "simulation."))]
    result = verify_swing(tried, settings=own)
    complaints = result.complaints
    (value,) = (one.value for one in result.checks if one.name.startswith("aim "))
    data = result.swing.plain()
    data["provenance"]["settings"] = own
    data["provenance"]["found"] |= (
        {"refused": "; ".join(complaints)} if complaints else {AIM_VALUE: value}
    )
    write_swing(swing_from_dict(data | {"name": path.stem}, path.stem), path, force=True)
    return complaints
