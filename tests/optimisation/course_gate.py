"""Whether reduced cars put cars and laws in the order of the full car by how far they turn; not run by pytest.

The measure of the corner study: course after a pulse of 0.5 s with the best steering of each. The folder is that of a
corner study with the designed tail (`aerodima corner --scenario turn_designed`): its `cases.csv` has the full car's
courses of the candidates at each speed, `laws.csv` the trained laws. Then over a number of drawn laws on one car,
whose runs are kept in the folder, so that a second call goes on with what is missing.

    python -m tests.optimisation.course_gate out/corner_designed 30
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import qmc, spearmanr

from aerodima.optimisation.studies.candidates import HELD, NO_TAIL, THESIS, Candidate
from aerodima.optimisation.studies.corner_plan import CornerPlan, Floor
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.law_training import TRAINED, screened_courses
from aerodima.optimisation.studies.study_store import open_runs
from aerodima.optimisation.sweep.study_engine import RememberingEngine, open_run_engine
from aerodima.workbench import load_ensemble
from aerodima.workbench.batch.worker_record import on_stderr
from aerodima.workbench.config.array_types import FloatArray

BEST = 0.1
"""Share of the drawn laws that would go to the full car."""


def words(full: FloatArray, reduced: FloatArray) -> str:
    """Rank correlation, median and largest difference of courses (n), rad, where both count; how often they agree."""
    both = (full > 0.0) & (reduced > 0.0)
    off = np.degrees(np.abs(full - reduced)[both])
    rank = float(spearmanr(full[both], reduced[both])[0])
    span = np.degrees([full[both].min(), full[both].max()])
    alike = 100.0 * np.mean((full > 0.0) == (reduced > 0.0))
    return (
        f"Spearman {rank:6.3f}  off by {np.median(off):5.2f} (most {off.max():5.2f}) of {span[0]:.1f} to {span[1]:.1f}"
        f" deg  n {both.sum()}  alike {alike:.0f} %"
    )


def main() -> None:
    """Prints the table of the gate."""
    folder, number = Path(sys.argv[1]), int(sys.argv[2])
    ensemble = load_ensemble()
    with open_runs(folder) as store, open_run_engine(1) as workers:
        runs = CornerRuns(CornerPlan("turn_designed"), RememberingEngine(workers, store, on_stderr))
        members = {member.name: member for member in ensemble.members}
        table = pd.read_csv(folder / "cases.csv")
        laws = pd.read_csv(folder / "laws.csv").query("law != 'published'").sort_values("worth")
        trained = laws.groupby("speed_m_per_s").last()[list(TRAINED.ranges)]
        for who in (NO_TAIL, HELD, THESIS, None):
            name = "trained" if who is None else who.name
            for speed, cases in table[table.candidate == name].groupby("speed_m_per_s"):
                floors = [
                    Floor(members[row.car], row.speed_m_per_s, row.floor, row.critical_friction)
                    for row in cases.itertuples()
                ]
                settings = TRAINED.settings(trained.loc[speed].to_dict()) if who is None else who.settings
                reduced = np.array(screened_courses(replace(runs.reduced_cases(floors), fixed=settings))[0])
                full = np.nan_to_num(cases.course_change_rad.to_numpy())
                print(f"{name:16s} {speed:g} m/s: {words(full, reduced)}", flush=True)
        if number:
            laws = TRAINED.laws(qmc.LatinHypercube(len(TRAINED.ranges), rng=5).random(number))
            floor = runs.floors(ensemble.split(1).training[:1])
            full = runs.courses([Candidate("", TRAINED.settings(law)) for law in laws], floor)[:, 0]
            cases = replace(runs.reduced_cases(floor), laws=tuple(laws), fixed=TRAINED.fixed)
            reduced = np.array(screened_courses(cases))[:, 0]
            print(f"{number} drawn laws on {floor[0].member.name}: {words(full, reduced)}")
            place = 1 + int((reduced > reduced[np.argmax(full)]).sum())
            print(f"the best is number {place} on the reduced car; {round(BEST * number)} would go to the full one")


if __name__ == "__main__":
    main()
