"""How often the intervals of `fit car` hold the truth, over emulated drives of other cars (`identify.car_truth`).

    python -m tests.optimisation.car_coverage [LOGS [FOLDER]]

fits that many logs (100, about half a minute each on one core) and ends with status 1 where an unknown is held by less
than 90 % of its intervals. Finished logs are kept in the folder, if one is named. A test of the suite fits a few.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.car_fit import fit_car
from aerodima.optimisation.identify.car_log import car_drive
from aerodima.optimisation.identify.fit_batch import fit_logs
from aerodima.optimisation.identify.fit_pipeline import FitResult
from tests.optimisation.identify.car_truth import drawn, emulated

UNKNOWNS = ("tyre_friction", "tyre_slip_angle", "com_height", "delay", "gyro_bias_z")


def fit_drawn(number: str) -> FitResult:
    """The fit of a drive by its number, with the truth in its facts."""
    truth = drawn(int(number))
    found = fit_car(car_drive(emulated(truth)))
    return replace(found, facts={**found.facts, "truth": truth.values})


def study(count: int, out: Path) -> pd.DataFrame:
    """The fits of the first drives, those that `out` has already among them.

    Returns:
        A row per unknown: logs, determined, held (intervals that hold the truth), percent of all logs, score_deviation
        of (value - truth) / standard deviation, and median_width of the intervals.
    """
    found = fit_logs(fit_drawn, [str(number) for number in range(count)], out, settings={"study": "car"})
    assert not found.failed, found.failed
    rows = []
    for name in UNKNOWNS:
        pairs = [(result[name], result.facts["truth"][name]) for result in found.results]
        known = [(e, truth) for e, truth in pairs if e.identifiable]
        held = sum(e.holds(truth) for e, truth in pairs)
        scores = [(e.value - truth) / e.standard_deviation for e, truth in known]
        width = np.median([e.upper - e.lower for e, _ in known])
        rows.append((name, count, len(known), held, 100.0 * held / count, np.std(scores), width))
    names = ["name", "logs", "determined", "held", "percent", "score_deviation", "median_width"]
    return pd.DataFrame(rows, columns=names)


def main() -> None:
    """Runs the study and prints its table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp())
    begin = time.perf_counter()
    table = study(count, folder)
    print(table.to_string(index=False, float_format="%.4g"), f"\n{time.perf_counter() - begin:.0f} s", flush=True)
    sys.exit(int((table.percent < 90.0).any()))


if __name__ == "__main__":
    main()
