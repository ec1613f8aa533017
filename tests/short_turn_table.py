"""Measures the candidates of models/short_turn again: `python -m tests.short_turn_table`."""

from __future__ import annotations

from pathlib import Path

from aerodima.optimisation.studies.candidates import Candidate
from aerodima.optimisation.studies.corner_plan import CornerPlan
from aerodima.optimisation.studies.corner_study import CornerRuns
from aerodima.optimisation.studies.study_store import open_runs
from aerodima.optimisation.sweep.study_engine import RememberingEngine, open_run_engine
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.report.short_turn import CASES, load_entries
from aerodima.workbench.resources import model_path


def main(out: Path = Path("out/short_turn")) -> None:
    """Runs what the folder does not hold yet, and writes the table."""
    asked = load_entries()
    who = [Candidate(one.name, tuple(one.settings)) for one in asked.candidates]
    plan = CornerPlan(asked.scenario, tuple(asked.speeds_m_per_s), tuple(asked.floors))
    test = load_ensemble(asked.ensemble).split(asked.seed).test[: asked.test_cars]
    with open_runs(out) as store, open_run_engine(2, progress=print) as engine:
        corner = CornerRuns(plan, RememberingEngine(engine, store, print)).measure({}, who, test, ())
    corner.cases.to_csv(model_path(CASES), index=False)


if __name__ == "__main__":
    main()
