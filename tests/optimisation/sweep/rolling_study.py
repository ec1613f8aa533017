"""Runs of a search that begin rolling against runs from rest, near the limit; not run by pytest.

Drawn cars of `outcome_study`, frictions within 5 % of the critical one. What is done is kept in the folder and not done
again; arguments: cars, frictions, seed, folder.

    python -m tests.optimisation.sweep.rolling_study 20 5 1 out/rolling_study
"""

from __future__ import annotations

import sys
import time
from itertools import islice
from pathlib import Path
from typing import Any

from aerodima.optimisation.sweep.study_engine import nearest_start
from aerodima.workbench.batch.row_store import RowStore, content_key
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.logs.schema import RunLog, software_versions
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.simulate.simulation import simulate
from tests.workbench.simulate.outcome_study import DrawnCar, drawn_cars

HEADER = ("friction", "rolled at", "from rest", "rolling", "peak roll +", "heading +", "CPU s rest", "CPU s rolling")


def compared(scenario: Scenario) -> dict[str, Any]:
    """A run from rest and one of a search, with the CPU time of each, s."""
    begun = time.process_time()
    start = nearest_start(scenario)
    straight, begun = time.process_time() - begun, time.process_time()
    rest = simulate(scenario, record="outcome")
    between = time.process_time()
    rolled = simulate(scenario, record="outcome", start=start)
    ended = time.process_time()
    one, other = (summarise(run, "").metrics for run in (rest, rolled))
    return {
        "friction": scenario.car.tyre_friction,
        "rolled_at": None if start is None else start.friction,
        "rest": outcome(rest),
        "rolling": outcome(rolled),
        "peak_roll": other.peak_roll_rad - one.peak_roll_rad,
        "heading": other.heading_change_rad - one.heading_change_rad,
        "straights_cpu": straight,
        "rest_cpu": between - begun,
        "rolling_cpu": ended - between,
    }


def outcome(run: RunLog) -> str:
    """Outcome, and whether it is clean."""
    found = summarise(run, "").metrics.outcome
    return "clean" if found.clean else found.result


def report(car: DrawnCar, runs: list[dict[str, Any]]) -> str:
    """Lines of one car."""
    straights = sum(run["straights_cpu"] for run in runs)
    lines = [f"{car.mode} {' '.join(car.settings)}: both straights {straights:.2f} s of CPU"]
    for run in runs:
        rolled_at = "rest" if run["rolled_at"] is None else f"{run['rolled_at']:.2f}"
        roll, heading = run["peak_roll"], run["heading"]
        cells = (f"{run['friction']:.4f}", rolled_at, run["rest"], run["rolling"], f"{roll:+.4f}", f"{heading:+.4f}")
        lines.append(_line((*cells, f"{run['rest_cpu']:.2f}", f"{run['rolling_cpu']:.2f}")))
    return "\n".join(lines)


def _line(cells: tuple[str, ...]) -> str:
    return "  ".join(cell.rjust(len(name)) for name, cell in zip(HEADER, cells, strict=True))


def main() -> None:
    """Prints the table; angles in rad."""
    arguments = (*sys.argv[1:], *("20", "5", "1", "out/rolling_study")[len(sys.argv) - 1 :])
    cars, frictions, seed = (int(text) for text in arguments[:3])
    identity = {"study": "rolling", "seed": seed, "versions": software_versions()}
    everything: list[dict[str, Any]] = []
    print(_line(HEADER))
    with RowStore(Path(arguments[3]) / f"seed_{seed}.jsonl", identity) as store:
        for car in drawn_cars(seed, cars):
            key = content_key(car.mode, car.settings, car.shares, frictions)
            if key not in store.rows:
                store.add(key, {"runs": [compared(at) for at in islice(car.scenarios(), frictions)]})
            runs = store.rows[key]["runs"]
            everything += runs
            print(report(car, runs), flush=True)
    total = {name: sum(run[f"{name}_cpu"] for run in everything) for name in ("straights", "rest", "rolling")}
    differ = sum(run["rest"] != run["rolling"] for run in everything)
    print(
        f"{len(everything)} runs, {differ} come to something else; CPU: from rest {total['rest']:.1f} s, rolling "
        f"{total['rolling']:.1f} s and {total['straights']:.1f} s for straights"
    )


if __name__ == "__main__":
    main()
