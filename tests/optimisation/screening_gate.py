"""Whether reduced cars put cars and laws in the order of the full car; not run by pytest.

Over cars of the ensemble, with the designed tail: critical friction at full lock, and heading at a
given steering and floor, for four controllers; within some of the cars critical friction over drawn
laws.
Nothing of the model is fitted; its equations were completed while looking at the first twelve cars,
which are left out here. Before that searches: 60 drawn laws on a car, and whether the full car's
best of them is in the reduced car's best tenth. The folder keeps the full car's runs, so that a
second call goes on with what is missing. Arguments: folder, cars, cars
with 30 laws each, searches, workers.

    python -m tests.optimisation.screening_gate out/screening 60 3 40 2
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from aerodima.optimisation.calibrate.calibration_plan import FRICTION
from aerodima.optimisation.studies.limit_search import Bracket, LimitSearch, run_rounds
from aerodima.optimisation.studies.runs import CachedRunner, RunTask, is_clean, open_run_engine
from aerodima.workbench import load_ensemble, load_scenario
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.car.reduced.parameters import VehicleParams, take
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import drive_turns

SCENARIO, SPEED = "turn_designed", ("manoeuvre.speed=4.5",)
SEARCH = LimitSearch(0.3, 1.2, 0.1, 0.0125)
GRID = np.round(np.arange(0.3, 1.2 + 1e-9, SEARCH.tolerance), 4)
"""Of the values that `SEARCH` evaluates."""
MIDDLE = 0.75
SWING = ("tail.mode=swing", "controller.swing_file=none")
CONTROLLERS = {
    "none": ("tail.mode=none",),
    "held": ("tail.mode=held",),
    "published, 8 rad/s": (*SWING, "controller.swing_speed=8.0"),
    "7 rad/s": (*SWING, "controller.swing_speed=7.0"),
}
LAWS, CANDIDATES = 30, 60
"""Drawn on a car: where the limit of each is driven for; in a search, where only the best counts.
"""
BEST = 0.1
"""Share of the laws of a search that would go to the full car."""
TUNED = 12
"""Cars drawn that the equations were completed with."""
STEERING = ("manoeuvre.steer_angle=0.3",)
FLOOR = f"{FRICTION}=0.4"
"""On which headings are compared: all cars survive there with any controller."""


def agreement(full, reduced):
    """Rank correlation, median and largest difference, and number of pairs.

    Args:
        full, reduced: figures of the two cars (n), NaN where a run was not clean.
    """
    both = np.isfinite(full) & np.isfinite(reduced)
    rank = spearmanr(full[both], reduced[both])[0]
    off = np.abs(reduced - full)[both]
    return f"{rank:8.3f} {np.median(off):8.4f} {off.max():8.4f} {both.sum():5d}"


def drawn_laws(number, seed=5):
    """Settings of constant-rate swings: rate, release, gains, travel, braking, pitch."""
    g = np.random.default_rng(seed)
    ranges = {
        "swing_speed": (3.0, 13.0),
        "trigger_yaw_rate": (0.2, 2.0),
        "swing_kd": (1.0, 5.0),
        "travel": (1.2, 3.1),
        "settle_kp": (2.0, 20.0),
        "settle_kd": (0.5, 5.0),
        "pitch_angle": (-0.4, 0.4),
    }
    return [
        (*SWING, *(f"controller.{k}={g.uniform(*ends):.2f}" for k, ends in ranges.items()))
        for _ in range(number)
    ]


def clean_limits(number, run, search=SEARCH):
    """The highest value at which each of so many candidates is clean (n), -inf where none is; `run`
    says of (candidate, value) which are.
    """
    verdicts = [{} for _ in range(number)]
    run_rounds(
        range(number),
        lambda index: search.next_values(MIDDLE, verdicts[index]),
        run,
        lambda index: verdicts[index],
    )
    return np.array([Bracket.from_verdicts(known).held for known in verdicts])


def screened_friction(scenarios, search):
    """The highest friction at which every scenario is clean, all of them driven at once.

    Args:
        scenarios: turns; their own friction does not matter.
        search: range and grid of friction.

    Raises:
        UserError: what `VehicleParams.of` refuses.
    """
    cars = VehicleParams.from_scenarios(scenarios)
    plans = TurnPlans.from_scenarios(scenarios)

    def run(wanted):
        places = [place for place, _ in wanted]
        frictions = [value for _, value in wanted]
        turns = drive_turns(
            replace(take(cars, places), friction=np.array(frictions)), take(plans, places)
        )
        return turns.clean.tolist()

    return clean_limits(len(scenarios), run, search)


def compared_friction(engine, cases):
    """Agreement of the critical friction of every case."""

    def run(wanted):
        tasks = [
            RunTask(f"{place}", SCENARIO, (*cases[place], f"{FRICTION}={value!r}"))
            for place, value in wanted
        ]
        return [is_clean(row) for row in engine.rows(tasks)]

    full = clean_limits(len(cases), run)
    reduced = screened_friction([load_scenario(SCENARIO, case) for case in cases], SEARCH)
    return agreement(full, reduced)


def compared_heading(engine, cases):
    """Agreement of the heading change of every case where it is clean, degrees."""
    rows = engine.rows([RunTask(str(place), SCENARIO, case) for place, case in enumerate(cases)])
    scenarios = [load_scenario(SCENARIO, case) for case in cases]
    turns = drive_turns(
        VehicleParams.from_scenarios(scenarios), TurnPlans.from_scenarios(scenarios)
    )
    clean = np.array([is_clean(row) for row in rows])
    full = np.degrees([row["heading_change_rad"] for row in rows])
    return agreement(
        np.where(clean, full, np.nan), np.where(turns.clean, np.degrees(turns.heading), np.nan)
    )


def best_ranks(engine, car, seed):
    """Ranks from 1 that the reduced car gives to the laws that stay clean longest on the full car.

    The laws are not each driven to their limit.

    The limit of the law that the reduced car puts first is searched for; all others are driven one
    step of the grid beyond it, those that are clean there another step further, until none is. A
    law that is not clean a step beyond has its row of clean runs broken there at the latest, so
    that it is not better.
    """
    laws = [(*car, *law) for law in drawn_laws(CANDIDATES, seed)]
    screened = screened_friction([load_scenario(SCENARIO, law) for law in laws], SEARCH)
    order = np.argsort(-screened, kind="stable").tolist()

    def clean(places, friction):
        tasks = [
            RunTask(f"{place}", SCENARIO, (*laws[place], f"{FRICTION}={friction!r}"))
            for place in places
        ]
        return [
            place for place, row in zip(places, engine.rows(tasks), strict=True) if is_clean(row)
        ]

    def run(wanted):
        return [bool(clean([order[0]], friction)) for _, friction in wanted]

    (limit,) = clean_limits(1, run)
    best = order[:1]
    left = order[1:]
    for friction in GRID[limit < GRID]:
        left = clean(left, float(friction))
        if not left:
            break
        best = left
    return [order.index(law) + 1 for law in best]


def main():
    """Prints the table of the gate."""
    folder = Path(sys.argv[1])
    (number, with_laws, searches, cores) = map(int, sys.argv[2:])
    ensemble = load_ensemble()
    tuned = {member.name for member in ensemble.resample(TUNED)}
    others = [m for m in ensemble.resample(len(ensemble.members)) if m.name not in tuned]
    cars = [(*m.settings_on(SCENARIO), *SPEED) for m in others[:number]]
    with (
        RowStore(folder / "runs.jsonl", {"schema": "screening gate"}) as store,
        open_run_engine(cores) as workers,
    ):
        engine = CachedRunner(workers, store)
        for place, member in enumerate(
            others[:: max(1, len(others) // max(1, searches))][:searches]
        ):
            ranks = best_ranks(engine, (*member.settings_on(SCENARIO), *SPEED), seed=100 + place)
            found = "in" if min(ranks) <= BEST * CANDIDATES else "NOT in"
            print(f"search {place + 1}: best {found} the best tenth, ranks {ranks}", flush=True)
        print(f"{'':36s} Spearman difference (most) pairs")
        for name, law in CONTROLLERS.items():
            friction = compared_friction(engine, [(*car, *law) for car in cars])
            print(f"{name:18s} critical friction {friction}", flush=True)
            heading = compared_heading(engine, [(*car, *law, *STEERING, FLOOR) for car in cars])
            print(f"{name:18s} heading           {heading}", flush=True)
        laws = drawn_laws(LAWS)
        for place in range(0, number, 4)[:with_laws]:
            friction = compared_friction(engine, [(*cars[place], *law) for law in laws])
            print(f"laws of car {place:<6d} critical friction {friction}", flush=True)


def reduced_seconds(scenarios, count=768):
    """CPU time of one run among many, s."""
    places = np.arange(count) % len(scenarios)
    vehicles = take(VehicleParams.from_scenarios(scenarios), places)
    plans = take(TurnPlans.from_scenarios(scenarios), places)
    begin = time.process_time()
    drive_turns(vehicles, plans)
    return (time.process_time() - begin) / count


if __name__ == "__main__":
    main()
