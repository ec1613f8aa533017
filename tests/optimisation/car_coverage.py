"""How often the intervals of `fit car` hold the truth, over emulated drives of other cars
(`identify.car_truth`).

    python -m tests.optimisation.car_coverage [LOGS [FOLDER]]

fits that many logs (100, about 20 s each on one core), tells of each as it is done, and ends with
status 1 where an unknown is held by less than 90 % of its 95 % intervals. Finished logs are kept in
the folder, if one is named.
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
NARROWER = 1.645 / 1.960
"""Half a 90 % interval over half a 95 % one."""


def fit_drawn(number: str) -> FitResult:
    """The fit of a drive by its number, with the truth and the CPU time, s, in its facts."""
    truth = drawn(int(number))
    drive = car_drive(emulated(truth))
    begin = time.process_time()
    found = fit_car(drive)
    facts = {"truth": truth.values, "cpu": time.process_time() - begin}
    return replace(found, facts={**found.facts, **facts})


def table_of(results: list[FitResult]) -> pd.DataFrame:
    """A row per unknown: percent of the intervals that hold the truth, median width, root of the
    mean of z^2.
    """
    rows = []
    for name in UNKNOWNS:
        pairs = [(result[name], result.facts["truth"][name]) for result in results]
        z = np.array([(e.value - truth) / e.standard_deviation for e, truth in pairs])
        held = np.array([e.holds(truth) for e, truth in pairs])
        inside = [
            abs(t - e.value) <= NARROWER * max(e.upper - e.value, e.value - e.lower)
            for e, t in pairs
        ]
        width = float(np.median([e.upper - e.lower for e, _ in pairs]))
        told = [100.0 * float(np.mean(values)) for values in (held, inside)]
        rows.append((name, len(pairs), *told, width, float(np.sqrt(np.mean(np.square(z))))))
    names = ["name", "logs", "percent_in_95", "percent_in_90", "median_width", "score_deviation"]
    return pd.DataFrame(rows, columns=names)


def main() -> None:
    """Runs the study and prints its table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp())
    numbers = [str(number) for number in range(count)]
    found = fit_logs(fit_drawn, numbers, folder, settings={"study": "car"}, progress=print)
    assert not found.failed, found.failed
    table = table_of(found.results)
    print(table.to_string(index=False, float_format="%.4g"))
    cpu = [result.facts["cpu"] for result in found.results]
    settled = sum(result.success for result in found.results)
    print(
        f"{settled} of {count} settled; CPU of a fit: median {np.median(cpu):.1f} s, most "
        f"{np.max(cpu):.1f} s"
    )
    sys.exit(int((table.percent_in_95 < 90.0).any()))


if __name__ == "__main__":
    main()
