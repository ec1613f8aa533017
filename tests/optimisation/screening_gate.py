"""Whether reduced cars put cars and laws in the order of the full car; not run by pytest.

Over cars of the ensemble, with the designed tail: critical friction at full lock, and heading at a
given steering and floor, for four controllers; within some of the cars the same over drawn laws.
Nothing of the model is fitted; its equations were completed while looking at the first twelve cars,
which are left out here. Before that searches: 60 drawn laws on a car, and whether the full car's
best of them is in the reduced car's best tenth. The folder keeps the full car's runs, so that a
second call goes on with what is missing. Arguments: folder, cars, cars
with 30 laws each, searches, workers.

    python -m tests.optimisation.screening_gate out/screening 60 3 40 2
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from aerodima.optimisation.screening.turn_plans import TurnPlans
from aerodima.optimisation.screening.turns import drive_turns
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.rollover_threshold import (
    FRICTION,
    Search,
    is_clean,
    search_rows,
)
from aerodima.optimisation.sweep.runs import Runs, RunTask, open_run_engine
from aerodima.workbench import load_ensemble, load_scenario
from aerodima.workbench.batch.row_store import RowStore

SCENARIO, SPEED = "turn_designed", ("manoeuvre.speed=4.5",)
SEARCH = Search(FRICTION, 0.3, 1.2, 0.1, 0.0125)
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
"""Share of the laws that would go to the full car."""
TUNED = 12
"""Cars drawn that the equations were completed with."""
STEERING = ("manoeuvre.steer_angle=0.3",)
FLOOR, LAW_FLOOR = f"{FRICTION}=0.4", f"{FRICTION}=0.6"
"""On which headings are compared: of cars, all of which survive with any controller; of laws."""
Settings = tuple[str, ...]


class Pairs(NamedTuple):
    """Figures of the full car and of the reduced one, NaN where a run was not clean; and whether
    they were (n).
    """

    full: np.ndarray
    reduced: np.ndarray
    alike: np.ndarray

    def words(self):
        """Rank correlation, median and largest difference, pairs, cases where both were clean or
        neither.
        """
        both = np.isfinite(self.full) & np.isfinite(self.reduced)
        full = self.full[both]
        reduced = self.reduced[both]
        rank = float(spearmanr(full, reduced)[0])
        off = np.abs(reduced - full)
        return (
            f"{rank:8.3f} {np.median(off):8.4f} {off.max():8.4f} {both.sum():5d} "
            f"{100 * self.alike.mean():6.0f} %"
        )

    def best_is_screened(self):
        """Whether the full car's best is in the share of the reduced one's best."""
        rank = int((self.reduced > self.reduced[np.nanargmax(self.full)]).sum())
        return rank < max(1, round(BEST * len(self.full)))


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


def screened_friction(scenarios, search):
    """The threshold of clean runs of every scenario, all of them driven at once.

    Args:
        scenarios: turns; their own friction does not matter.
        search: range and grid of friction.

    Raises:
        UserError: what `Vehicles.of` refuses.
    """
    cars = Vehicles.of(scenarios)
    plans = TurnPlans.of(scenarios)

    def run(wanted):
        places = [place for place, _ in wanted]
        frictions = [value for _, value in wanted]
        turns = drive_turns(
            replace(cars.take(places), friction=np.array(frictions)), plans.take(places)
        )
        return [bool(clean) for clean in turns.clean]

    return search_rows(search, ["bisect"] * len(scenarios), run, bool)


def compared_friction(engine, cases):
    """Critical friction of every case."""

    def run(wanted):
        return engine.rows(
            [
                RunTask(f"{place}", SCENARIO, (*cases[place], f"{FRICTION}={value!r}"))
                for place, value in wanted
            ]
        )

    full = search_rows(SEARCH, ["bisect"] * len(cases), run, is_clean)
    reduced = screened_friction([load_scenario(SCENARIO, case) for case in cases], SEARCH)
    one, other = (np.array([t.survived for t in found], float) for found in (full, reduced))
    return Pairs(one, other, np.isfinite(one) == np.isfinite(other))


def compared_heading(engine, cases):
    """Heading change of every case where it is clean, degrees."""
    rows = engine.rows([RunTask(str(place), SCENARIO, case) for place, case in enumerate(cases)])
    scenarios = [load_scenario(SCENARIO, case) for case in cases]
    turns = drive_turns(Vehicles.of(scenarios), TurnPlans.of(scenarios))
    clean = np.array([is_clean(row) for row in rows])
    full = np.degrees([row["heading_change_rad"] for row in rows])
    return Pairs(
        np.where(clean, full, np.nan),
        np.where(turns.clean, np.degrees(turns.heading), np.nan),
        clean == turns.clean,
    )


class Searched(NamedTuple):
    """A search among drawn laws on one car.

    Attributes:
        ranks: from 1, that the reduced car gave to the full car's best, and to those that are as
            good.
        friction: up to which they are clean on the full car; `first` that of the law which the
            reduced car puts first.
        runs: of the full car.
    """

    ranks: list[int]
    friction: float
    first: float
    runs: int

    @property
    def found(self):
        """Whether the full car's best, or one of several as good, is in the reduced car's best
        tenth.
        """
        return min(self.ranks) <= BEST * CANDIDATES


def searched(engine, car, seed):
    """The laws that stay clean longest on the full car, without driving each to its limit.

    The limit of the law that the reduced car puts first is searched for; all others are driven one
    step of the grid beyond it, those that are clean there another step further, until none is. A
    law that is not clean a step beyond has its row of clean runs broken there at the latest, so
    that it is not better.
    """
    laws = [(*car, *law) for law in drawn_laws(CANDIDATES, seed)]
    screened = screened_friction([load_scenario(SCENARIO, law) for law in laws], SEARCH)
    order = np.argsort([-(found.survived or 0.0) for found in screened], kind="stable").tolist()
    driven = 0

    def clean(places, friction):
        nonlocal driven
        driven += len(places)
        tasks = [
            RunTask(f"{place}", SCENARIO, (*laws[place], f"{FRICTION}={friction!r}"))
            for place in places
        ]
        return [
            place for place, row in zip(places, engine.rows(tasks), strict=True) if is_clean(row)
        ]

    def run(wanted):
        return [bool(clean([order[0]], friction)) for _, friction in wanted]

    limit = search_rows(SEARCH, ["bisect"], run, bool)[0].survived
    first = place = -1 if limit is None else SEARCH.index(limit)
    best = order[:1]
    left = order[1:]
    while place < SEARCH.index(SEARCH.high) and (left := clean(left, SEARCH.value(place + 1))):
        best = left
        place = place + 1
    ranks = [order.index(law) + 1 for law in best]
    return Searched(ranks, SEARCH.value(place), SEARCH.value(first), driven)


def main():
    """Prints the table of the gate."""
    folder = Path(sys.argv[1])
    (number, with_laws, searches, cores) = map(int, sys.argv[2:])
    ensemble = load_ensemble()
    tuned = {member.name for member in ensemble.drawn(TUNED)}
    others = [m for m in ensemble.drawn(len(ensemble.members)) if m.name not in tuned]
    cars = [(*m.settings_on(SCENARIO), *SPEED) for m in others[:number]]
    with (
        RowStore(folder / "runs.jsonl", {"schema": "screening gate"}) as store,
        open_run_engine(cores) as workers,
    ):
        engine = Runs(workers, store)
        for place, member in enumerate(
            others[:: max(1, len(others) // max(1, searches))][:searches]
        ):
            begin = time.process_time()
            found = searched(engine, (*member.settings_on(SCENARIO), *SPEED), seed=100 + place)
            print(
                f"search {place + 1}, {member.name}: best {'in' if found.found else 'NOT in'} the "
                "best tenth, ranks "
                f"{found.ranks} at {found.friction:.4f}, first at {found.first:.4f}; {found.runs} "
                "runs, "
                f"{time.process_time() - begin:.0f} s of CPU",
                flush=True,
            )
        print(f"{'':36s} Spearman difference (most) pairs  clean alike")
        for name, law in CONTROLLERS.items():
            friction = compared_friction(engine, [(*car, *law) for car in cars])
            print(f"{name:18s} critical friction {friction.words()}", flush=True)
            heading = compared_heading(engine, [(*car, *law, *STEERING, FLOOR) for car in cars])
            print(f"{name:18s} heading           {heading.words()}", flush=True)
        laws = drawn_laws(LAWS)
        for place in range(0, number, 4)[:with_laws]:
            friction = compared_friction(engine, [(*cars[place], *law) for law in laws])
            best = "in" if friction.best_is_screened() else "NOT in"
            print(
                f"laws of car {place:<6d} critical friction {friction.words()}  best {best} the "
                "best tenth",
                flush=True,
            )
            heading = compared_heading(
                engine, [(*cars[place], *law, *STEERING, LAW_FLOOR) for law in laws]
            )
            print(f"laws of car {place:<6d} heading           {heading.words()}", flush=True)
    print(
        "one reduced run: "
        f"{1e3 * reduced_seconds([load_scenario(SCENARIO, car) for car in cars]):.1f} ms of CPU"
    )


def reduced_seconds(scenarios, count=768):
    """CPU time of one run among many, s."""
    places = np.arange(count) % len(scenarios)
    vehicles = Vehicles.of(scenarios).take(places)
    plans = TurnPlans.of(scenarios).take(places)
    begin = time.process_time()
    drive_turns(vehicles, plans)
    return (time.process_time() - begin) / count


if __name__ == "__main__":
    main()
