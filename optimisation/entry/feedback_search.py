"""Search of the numbers of the feedback law: reduced training cars, the highest speeds that they enter at.

A law is scored by the speeds at which cars stay upright, over the entry speed of the car without tail. A car that
turns less than `LEAST_SHARE` of it counts less, by the third power of what is missing, so that the search is led to
laws that turn enough. The score is half the mean over cars and manoeuvres and half the mean of the worst fifth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.entry.entry_speed import LEAST_SHARE
from aerodima.optimisation.entry.suite import FEEDBACK, TRAINED_ON, manoeuvres
from aerodima.optimisation.screening.entry_runs import climb
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.optimisation.sweep.runs import Runs, scenario_content
from aerodima.optimisation.swing.candidate import NO_TAIL, Candidate
from aerodima.optimisation.swing.law_search import LawFamily, LawSearch, search_laws
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.errors import SweepError

FAMILY = LawFamily(
    FEEDBACK.name,
    {
        "feedback.steering_gain": (-12.0, 12.0),
        "feedback.roll_gain": (-20.0, 60.0),
        "feedback.roll_rate_gain": (-2.0, 6.0),
        "feedback.threshold": (0.5, 6.0),
        "feedback.most_speed": (3.0, 16.0),
        "feedback.most_roll": (1.0, 1.57),
        "feedback.brake_time": (0.0, 0.1),
        "feedback.swing_kd": (0.5, 5.0),
        "feedback.end_kp": (1.0, 20.0),
        "feedback.end_kd": (0.3, 5.0),
        "feedback.return_speed": (0.5, 6.0),
    },
)
"""Numbers that are free, in the units of `FeedbackParameters`."""
SPEEDS = np.array([2.8, 3.6, 4.4, 5.2, 6.0])
"""m/s, of the climb of a law; that of the car without tail is finer."""
SPEEDS_WITHOUT = np.arange(1.8, 4.7, 0.2)
AT_ONCE = 16
"""Laws in one piece of work."""
WORST = 0.2
"""Share of cases that the second half of the score is made of."""
CASE_SPEED = 4.0
"""m/s, at which the cars are built; each run has its own."""


@dataclass(frozen=True)
class Screened:
    """Laws on cars in a manoeuvre: small enough to send to a worker.

    Attributes:
        manoeuvre: name of the suite; `tail` of `suite.TAILS`.
        cars: settings of each car.
        laws: numbers by name.
    """

    manoeuvre: str
    tail: str
    cars: tuple[tuple[str, ...], ...]
    laws: tuple[Mapping[str, float], ...]


def search_feedback(cars: Sequence[Member], tail: str, search: LawSearch, runs: Runs) -> Candidate:
    """The law with the best score on training cars (`TRAINED_ON`).

    Args:
        cars: training cars.
        tail: of `suite.TAILS`.
        search: how much; finalists are not driven by full cars.
        runs: where the runs are made.

    Raises:
        UserError: no law keeps a car upright.
    """
    runs.stage = "feedback law"
    chosen = {name: manoeuvres([name], tail)[0] for name in TRAINED_ON}
    contents = {name: scenario_content(one.scenario, one.settings) for name, one in chosen.items()}

    def worth(laws: Sequence[Mapping[str, float]]) -> FloatArray:
        parts = [
            Screened(name, tail, tuple(car.settings_on("entry_turn") for car in cars), tuple(laws[k : k + AT_ONCE]))
            for k in range(0, len(laws), AT_ONCE)
            for name in TRAINED_ON
        ]
        keys = [content_key("screened entries", vars(part), *contents[part.manoeuvre]) for part in parts]
        found = runs.call(screened_entries, parts, keys)
        by_manoeuvre = [np.concatenate(found[k :: len(TRAINED_ON)]) for k in range(len(TRAINED_ON))]
        return score(np.concatenate(by_manoeuvre, axis=1))

    shipped = load_scenario(chosen[TRAINED_ON[0]].scenario).feedback
    start = {name: float(getattr(shipped, name.split(".")[1])) for name in FAMILY.ranges}
    found = search_laws(FAMILY, search, start, worth, runs.say)
    if not found:
        raise SweepError("no law that was tried keeps a training car upright at any speed")
    best = found[0]
    return Candidate(
        f"trained {FEEDBACK.name}", (*FEEDBACK.settings, *(f"{name}={value!r}" for name, value in best.items()))
    )


def score(ratios: FloatArray) -> FloatArray:
    """Of laws (laws,) from speeds over those without a tail (laws, cases)."""
    worst = np.sort(ratios, axis=1)[:, : max(1, round(WORST * ratios.shape[1]))]
    found: FloatArray = 0.5 * (ratios.mean(axis=1) + worst.mean(axis=1))
    return found


def screened_entries(screened: Screened) -> list[list[float]]:
    """Speed that each law is worth over the entry speed without tail (laws, cars).

    Raises:
        UserError: what the screening model does not know.
    """
    scenario, vehicles, without, least = _reference(screened.manoeuvre, screened.tail, screened.cars)
    count, laws = vehicles.count, screened.laws
    which = np.tile(np.arange(count), len(laws))
    gains = gains_of([law for law in laws for _ in range(count)], scenario)
    upright, figure = climb(vehicles.take(which), SPEEDS, scenario, gains, np.ones(len(which)))
    held = np.cumprod(upright, axis=0) > 0
    turned = np.minimum(1.0, np.maximum(figure, 0.0) / least[which]) ** 3
    worth = np.max(np.where(held, SPEEDS[:, None] * turned, 0.0), axis=0) / without[which]
    found: list[list[float]] = worth.reshape(len(laws), count).tolist()
    return found


@lru_cache(maxsize=16)
def _reference(
    manoeuvre: str, tail: str, cars: tuple[tuple[str, ...], ...]
) -> tuple[Scenario, Vehicles, FloatArray, FloatArray]:
    """Scenario of a manoeuvre, its cars with the tail, entry speeds without (n), m/s, and the least figures (n)."""
    (chosen,) = manoeuvres([manoeuvre], tail)
    of_the_car = ("manoeuvre.kind=turn", "manoeuvre.turns=1", "manoeuvre.rolling_start=false", "manoeuvre.turn_start=2")
    still = ("manoeuvre.duration=4", f"manoeuvre.speed={CASE_SPEED!r}", *of_the_car)

    def vehicles(who: Candidate) -> Vehicles:
        settings = [(*car, *chosen.settings, *who.settings, *still) for car in cars]
        return Vehicles.of([load_scenario(chosen.scenario, own) for own in settings])

    scenario = load_scenario(chosen.scenario, (*chosen.settings, *FEEDBACK.settings))
    none = vehicles(NO_TAIL)
    upright, figure = climb(none, SPEEDS_WITHOUT, scenario, gains_of([{}] * none.count, scenario), np.zeros(none.count))
    last = np.maximum(np.sum(np.cumprod(upright, axis=0), axis=0).astype(int) - 1, 0)
    least = LEAST_SHARE * np.take_along_axis(figure, last[None], axis=0)[0]
    return scenario, vehicles(FEEDBACK), SPEEDS_WITHOUT[last], least


def gains_of(laws: Sequence[Mapping[str, float]], scenario: Scenario) -> Any:
    """Fields of `FeedbackParameters` of laws as arrays (laws,); what a law does not name is the scenario's."""
    given = dict(scenario.feedback)
    return SimpleNamespace(
        **{key: np.array([law.get(f"feedback.{key}", value) for law in laws], float) for key, value in given.items()}
    )
