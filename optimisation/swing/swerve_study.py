"""Comparisons (`judge`) and training (`train_law`) of laws by name; results are data frames."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd

from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    CachedRunner,
    cached_runs,
    open_run_engine,
)
from aerodima.optimisation.swerve.candidate import write_candidate
from aerodima.optimisation.swerve.reduced_swerves import check_aims
from aerodima.optimisation.swerve.steering import SearchEffort
from aerodima.optimisation.swerve.suite import SUITE, ensemble_cases, select_candidates
from aerodima.optimisation.swing.bound import BoundEffort
from aerodima.optimisation.swing.comparison import BoundItem, compare_swerves
from aerodima.optimisation.swing.control_training import train_rollover_control
from aerodima.optimisation.swing.feedback_training import LawSearch, train_feedback
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.key_errors import nearest

DEFAULT_AIMS = ("aside-0.5",)
"""Aims of a comparison unless others are asked for."""
DEFAULT_FOLDER = Path("out/judge")
"""Folder of a comparison unless another is asked for."""
TRAINED = "candidates.yaml"
"""Name of the file of a trained law."""
TRAINABLE = ("feedback", "rollover-control", "feedback-rollover-control")
"""Names of the candidates whose numbers can be searched."""
TRAINING_AIMS = ("aside-0.5", "aside-1.0")
"""Aims of a training unless others are asked for."""


def judge(
    candidates: Sequence[str] = SUITE.default,
    *,
    laws: Sequence[str] = (),
    ensemble: str = "physical",
    cars: int = 4,
    tail: str = "built",
    floors: Sequence[float] = (1.0,),
    speeds: Sequence[float] = SUITE.speeds,
    aims: Sequence[str] = DEFAULT_AIMS,
    seed: int = 1,
    folder: Path = DEFAULT_FOLDER,
    runs: CachedRunner | None = None,
    steering_effort: SearchEffort | None = None,
    bound_effort: BoundEffort | None = None,
    step: float | None = FINE_STEP,
    further: int = 0,
    conditions: Sequence[str] = (),
) -> pd.DataFrame:
    """Compares candidates in swerves on test cars, each with its own best steering.

    Args:
        candidates: names of the suite, swings, or files of candidates.
        laws: laws of the user, `mine.py:MyLaw`.
        ensemble: name or path of the ensemble.
        cars: number of its test cars that are driven.
        tail: name of a tail of the suite.
        floors: friction of each floor, as a multiple of the car's.
        speeds: speeds of the swerves, m/s.
        aims: names of the aims, see `compare_swerves`.
        seed: seed of the split of the ensemble, which makes its test cars.
        folder: folder of runs and swings; the same call continues there.
        runs: runner of the searches and full runs; by default two workers that keep them in the
            folder.
        steering_effort: budget of each search of a steering.
        bound_effort: budget of each search of a bound.
        step: step of the plant of the full car, s; a claim needs the fine one. None compares
            reduced cars alone.
        further: number of full runs with which each candidate is searched on.
        conditions: settings of the drive, the same for all candidates, such as `imu.delay=0.024`.

    Returns:
        The table of `compare_swerves`; `summarise_swerves` makes medians and intervals of it.
    """
    cases = ensemble_cases(ensemble, "test", cars, tail, floors, seed, tuple(conditions))
    chosen = select_candidates(candidates, laws)
    with _runs_in(folder, runs) as runner:
        return compare_swerves(
            chosen,
            cases,
            speeds,
            aims,
            runner,
            folder / "swings",
            steering_effort=steering_effort,
            bound=BoundItem(effort=bound_effort),
            step=step,
            further=further,
        )


def train_law(
    folder: Path,
    search: LawSearch | None = None,
    *,
    candidate: str = "feedback",
    ensemble: str = "physical",
    cars: int = 6,
    tail: str = "built",
    floors: Sequence[float] = (1.0,),
    speeds: Sequence[float] = SUITE.speeds,
    aims: Sequence[str] | None = None,
    runs: CachedRunner | None = None,
    force: bool = False,
) -> pd.DataFrame:
    """Trains the numbers of a candidate on training cars and writes them as a file of candidates.

    Args:
        folder: folder of that file and of the runs.
        search: budget of the search; by default `LawSearch()`.
        candidate: name in `TRAINABLE`: the feedback law, or the rollover control of a driver at
            full lock, without tail or together with the law.
        ensemble: name or path of the ensemble, which is split by the seed of the search.
        cars: number of its training cars.
        tail, floors, speeds, runs: as in `judge`.
        aims: names of the aims by which numbers are scored, see `find_aim`; by default
            `TRAINING_AIMS`.
        force: whether an existing file is replaced.

    Returns:
        A row per setting of the trained candidate: key and value, as texts.
    """
    if candidate not in TRAINABLE:
        raise SweepError(f"candidate {candidate!r}: {nearest(candidate, TRAINABLE)}")
    aims = aims or TRAINING_AIMS
    check_aims(aims)
    search = search or LawSearch()
    cases = ensemble_cases(ensemble, "training", cars, tail, floors, search.seed)
    with _runs_in(folder, runs) as runner:
        if candidate == "feedback":
            trained = train_feedback(cases, speeds, aims, search, runner)
        else:
            has_tail = candidate.startswith("feedback")
            trained = train_rollover_control(has_tail, cases, speeds, aims, search, runner)
    chosen = (
        f"aerodima swing train --candidate {candidate}: {search}, {cars} training cars of "
        f"{ensemble}, {tail} tail, floors {list(floors)}, speeds {list(speeds)}, aims {list(aims)}"
    )
    write_candidate(folder / TRAINED, trained, chosen, force=force)
    return pd.DataFrame([one.split("=") for one in trained.settings], columns=["key", "value"])


@contextmanager
def _runs_in(folder: Path, runs: CachedRunner | None) -> Iterator[CachedRunner]:
    """Yields a given runner, else one that keeps its runs in a folder."""
    if runs is not None:
        yield runs
        return
    with open_run_engine() as engine, cached_runs(folder, engine) as own:
        yield own
