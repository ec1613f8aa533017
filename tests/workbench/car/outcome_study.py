"""Outcome trials, which end early, against runs of full length, near the limit; not run by pytest,
but for two cars.

Cars of drawn speed, direction and tail, each at frictions within 5 % of that which just flips it.
One trial of each car is compared with a run that records everything, the others with one that does
not end early:

    python -m tests.workbench.car.outcome_study 50 1
"""

import sys
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario

NEAR = 0.05
"""Largest distance from the critical friction, as a share of it."""
PER_CAR = 5
"""Frictions of each car."""
HALVINGS = 4
"""Of the range of friction in which the critical one is looked for."""
HEADING = 1e-4
"""Largest difference of heading changes, rad: wheel loads from the motion may tell a row later that
the car is calm."""


@dataclass(frozen=True)
class DrawnCar:
    """A car and its turn; `shares` of `NEAR` at which its frictions lie from the critical one."""

    mode: str
    settings: tuple[str, ...]
    shares: tuple[float, ...]

    def at(self, friction):
        """Its scenario at a friction."""
        return load_scenario(
            f"turn_{self.mode}", [*self.settings, f"car.tyre_friction={friction:.6f}"]
        )

    def scenarios(self):
        """Its scenarios near the limit."""
        low = 0.45
        high = 0.95
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            survived = (
                metrics_of(simulate(self.at(middle), record="outcome")).outcome.result == "survived"
            )
            low, high = (middle, high) if survived else (low, middle)
        yield from (self.at(0.5 * (low + high) * (1.0 + NEAR * share)) for share in self.shares)


def drawn_cars(seed, count):
    """Of one seed always the same, however many."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        mode = str(rng.choice(["none", "held", "swing"]))
        settings = [
            f"manoeuvre.speed={rng.uniform(3.0, 4.5):.3f}",
            f"manoeuvre.direction={rng.choice(['left', 'right'])}",
            f"seed={rng.integers(1, 1000)}",
        ]
        if mode != "none":
            settings.append(f"tail.sail={rng.choice(['facing', 'locked', 'free'])}")
        yield DrawnCar(mode, tuple(settings), tuple(rng.uniform(-1.0, 1.0, PER_CAR).tolist()))


class Compared(NamedTuple):
    """What a trial says otherwise than the full run; whether the car flipped; share of the run that
    was simulated.
    """

    wrong: list[str]
    flipped: bool
    share: float


def differences(scenario, recorded=True):
    """Compares an outcome trial with a run of full length, `recorded` whole or a trial too that
    does not end early.

    Roll and heading are compared as far as the trial goes, and of a car that survives peak roll and
    heading change.
    """
    found = simulate(scenario, record="outcome")
    whole = (
        simulate(scenario)
        if recorded
        else simulate(scenario, record="outcome", stop_when_certain=False)
    )
    trial = summarise(found, scenario.name)
    run = summarise(whole, scenario.name)
    same = {
        "outcome": (trial.metrics.outcome.result, run.metrics.outcome.result),
        "clean": (trial.metrics.outcome.clean, run.metrics.outcome.clean),
        "trigger": (trial.trigger_time, run.trigger_time),
    }
    wrong = [
        f"{name} {one} instead of {other}" for name, (one, other) in same.items() if one != other
    ]
    flipped = run.metrics.outcome.result == "flipped"
    rows = len(found.table)
    for name in ("roll_truth_rad", "yaw_truth_rad"):
        apart = float(np.abs(found.signal(name) - whole.signal(name)[:rows]).max())
        if not apart <= 1e-6:
            wrong.append(f"{name} {apart:.2g} rad apart")
    if not flipped:
        for name, tolerance in (("peak_roll_rad", 1e-6), ("heading_change_rad", HEADING)):
            apart = abs(getattr(trial.metrics, name) - getattr(run.metrics, name))
            if not apart <= tolerance:
                wrong.append(f"{name} {apart:.2g} rad apart")
    return Compared(wrong, flipped, rows / len(whole.table))


if __name__ == "__main__":
    cars, seed = map(int, sys.argv[1:])
    for car in drawn_cars(seed, cars):
        for place, scenario in enumerate(car.scenarios()):
            print(car.mode, *car.settings, differences(scenario, recorded=place == 0), flush=True)
