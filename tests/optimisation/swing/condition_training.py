"""Margin of a rollover control on cars that differ more from their model than those of
`condition_runs`: how the candidate `feedback-careful-control` was chosen.

`python -m tests.optimisation.swing.condition_training` drives full training cars at full lock with
the numbers of `feedback-rollover-control`, or another `--candidate`, but for one `--number` of the
control, which gets shares of its value; `--set` changes others. It prints for each how many runs
stay upright, and its score: how far a car goes aside in half a second and in a whole one, each over
its usual size, nothing where it tips; half the mean over all runs, half that of the worst fifth.
"""

import argparse
from dataclasses import replace
from itertools import product
from multiprocessing import Pool

import numpy as np

from aerodima.optimisation.swerve.aims import AIMS
from aerodima.optimisation.swerve.suite import NAMED_CANDIDATES
from aerodima.optimisation.swing.control_training import CONTROL_RANGES
from aerodima.optimisation.swing.feedback_training import score
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.optimisation.swing.condition_runs import (
    CANDIDATES,
    CONDITIONS,
    Asked,
    Condition,
    drive,
)

CONTROL_NUMBERS = tuple(key.split(".")[1] for key in CONTROL_RANGES)
"""Numbers of the control that may be varied."""
CARS = ("car013", "car001", "car010", "car036", "car005", "car024")
"""The half of twelve training cars of `physical.yaml` that tip most in these conditions with the
numbers of `feedback-rollover-control`; four more cars tip as often as the second."""
SHARES = (0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
"""Usual shares of the number that is varied."""
STEP = "simulation.step=0.002"
"""Step of these runs; the table has half of it."""
HEAVIER = {"car.mass": 1.1, "car.com_height": 1.07}
"""Factors on the car in every condition, a margin for what no condition has."""
WORST = (
    "as modelled, IMU 24 ms late",
    "IMU 44 ms late",
    "bank of 3 degrees to the inside",
    "wind of 5 m/s to the right",
    "roll motor limp, pitch held",
    "IMU frozen",
    "noise of the IMU x 4",
    "contact approximation similar",
    "contact approximation SAP",
)
"""The car as modelled, and conditions that tip a car more easily."""


def heavier(condition: Condition) -> Condition:
    """A condition of a heavier car."""
    factors = dict(condition.factors)
    for key, factor in HEAVIER.items():
        factors[key] = factor * factors.get(key, 1.0)
    return replace(condition, factors=factors)


def worth_of(runs: FloatArray) -> FloatArray:
    """Worth of runs (n, 3), see `condition_runs.drive`: the mean of both ways aside over their
    usual sizes, 0 where the car tips.
    """
    sizes = [AIMS["aside-0.5"].size, AIMS["aside-1.0"].size]
    return np.where(runs[:, 0] > 0.0, np.mean(runs[:, 1:] / sizes, axis=1), 0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--candidate", default="feedback-rollover-control", choices=CANDIDATES[1:])
    parser.add_argument("--number", default="start", choices=CONTROL_NUMBERS)
    parser.add_argument("--share", type=float, action="append", help="instead of the usual ones")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    numbers = (*NAMED_CANDIDATES[given.candidate].settings, *given.set)
    try:
        control = load_scenario("swerve", numbers).rollover_control
    except UserError as error:
        parser.error(str(error))
    value = getattr(control, given.number)
    conditions = [heavier(CONDITIONS[name]) for name in WORST]
    print(f"| {given.number} | upright | aside | score |\n|---|---|---|---|")
    with Pool(2) as workers:
        for share in given.share or SHARES:
            tried = f"rollover_control.{given.number}={share * value:.4g}"
            asked = Asked(given.candidate, 1.0, (STEP, *given.set, tried))
            items = [(car, condition, asked) for car, condition in product(CARS, conditions)]
            runs = np.array(workers.map(drive, items, chunksize=1))
            (found,) = score(worth_of(runs)[None])
            upright = f"{runs[:, 0].sum():.0f} of {len(items)}"
            metres = f"{np.median(runs[:, 1]):.3f} m"
            print(f"| {share * value:.4g} | {upright} | {metres} | {found:.3f} |", flush=True)


if __name__ == "__main__":
    main()
