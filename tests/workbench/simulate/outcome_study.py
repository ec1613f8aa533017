"""Outcome trials against full runs on separate systems, near the limit; not run by pytest, but for two cars.

Cars of drawn speed, direction and tail, each at frictions within 5 % of that which just flips it. Seeds tell drawn
lists apart, so that two processes share the work.

    python -m tests.workbench.simulate.outcome_study 100 1
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np

from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.simulate.simulation import simulate

NEAR = 0.05
"""Largest distance from the critical friction, as a share of it."""
PER_CAR = 5
"""Frictions of each car."""
HALVINGS = 4
"""Of the range of friction in which the critical one is looked for."""


def scenarios(seed: int, cars: int) -> Iterator[Scenario]:
    """Scenarios near the limit of drawn cars."""
    rng = np.random.default_rng(seed)
    for _ in range(cars):
        mode = str(rng.choice(["none", "held", "swing"]))
        settings = [
            f"manoeuvre.speed={rng.uniform(3.0, 4.5):.3f}",
            f"manoeuvre.direction={rng.choice(['left', 'right'])}",
            f"seed={rng.integers(1, 1000)}",
        ]
        if mode != "none":
            settings.append(f"tail.sail={rng.choice(['facing', 'locked', 'free'])}")

        def at(friction: float, mode: str = mode, settings: list[str] = settings) -> Scenario:
            return load_scenario(f"turn_{mode}", [*settings, f"car.tyre_friction={friction:.6f}"])

        low, high = 0.45, 0.95
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            survived = metrics_of(simulate(at(middle), record="outcome")).outcome.result == "survived"
            low, high = (middle, high) if survived else (low, middle)
        critical = 0.5 * (low + high)
        yield from (at(critical * (1.0 + NEAR * share)) for share in rng.uniform(-1.0, 1.0, PER_CAR))


def differences(scenario: Scenario) -> tuple[list[str], bool]:
    """What an outcome trial says otherwise than the full run on separate systems; whether the car flipped.

    A flipped car ends its trial early, and so roll and heading are compared as far as the trial goes. A free sail
    flutters, and rounding grows with it.
    """
    found = simulate(scenario, record="outcome")
    whole = simulate(scenario)
    trial, run = summarise(found, scenario.name), summarise(whole, scenario.name)
    same = {
        "outcome": (trial.metrics.outcome.result, run.metrics.outcome.result),
        "clean": (trial.metrics.outcome.clean, run.metrics.outcome.clean),
        "trigger": (trial.trigger_time, run.trigger_time),
    }
    wrong = [f"{name} {one} instead of {other}" for name, (one, other) in same.items() if one != other]
    flipped = run.metrics.outcome.result == "flipped"
    rows = len(found.table)
    tolerance = 0.02 if scenario.tail.sail == "free" else 1e-6
    for name in ("roll_truth_rad", "yaw_truth_rad"):
        apart = float(np.abs(found.signal(name) - whole.signal(name)[:rows]).max())
        if not apart <= tolerance:
            wrong.append(f"{name} {apart:.2g} rad apart")
    if not flipped and rows != len(whole.table):
        wrong.append(f"{rows} rows instead of {len(whole.table)}")
    return wrong, flipped


def main() -> None:
    """Arguments: cars, seed."""
    cars, seed = (int(text) for text in (*sys.argv[1:], "100", "1")[:2])
    count = flips = wrong = 0
    for scenario in scenarios(seed, cars):
        apart, flipped = differences(scenario)
        count, flips, wrong = count + 1, flips + flipped, wrong + bool(apart)
        for line in apart:
            print(f"{scenario.name} {scenario.car.tyre_friction:g} {scenario.manoeuvre.speed:g}: {line}", flush=True)
        if count % PER_CAR == 0:
            print(f"{count} runs, {flips} flipped, {wrong} differ, {time.process_time():.0f} s of CPU", flush=True)


if __name__ == "__main__":
    main()
