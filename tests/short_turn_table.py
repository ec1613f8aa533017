"""Measures the candidates of models/short_turn again: `python -m tests.short_turn_table`."""

from __future__ import annotations

from pathlib import Path

from aerodima.optimisation import Candidate, Task, judge, open_run_engine
from aerodima.workbench.report.short_turn import CASES, load_entries
from aerodima.workbench.resources import model_path


def main(out: Path = Path("out/short_turn")) -> None:
    """Runs what the folder does not hold yet, and writes the table."""
    asked = load_entries()
    who = [Candidate(one.name, tuple(one.settings)) for one in asked.candidates]
    task = Task(
        scenario=asked.scenario,
        ensemble=asked.ensemble,
        seed=asked.seed,
        cars=asked.test_cars,
        speeds=asked.speeds_m_per_s,
        floors=asked.floors,
    )
    with open_run_engine(2, progress=print) as engine:
        found = judge(task, who, out, engine, progress=print)
    found.cases.to_csv(model_path(CASES), index=False)


if __name__ == "__main__":
    main()
