"""The short turn of the shipped table: who takes part, which case is shown, and the runs that show it.

`models/short_turn` holds the list of candidates and what `aerodima swing judge` measures of them. Shown is the case in
the middle: that whose gain of the last candidate over the first is the median of all, the lesser of two in the middle.
There all of them get the steering that is best for the last one.
"""

import math
from dataclasses import dataclass

import pandas as pd
from pydantic import Field

from aerodima.workbench.config.checked_files import StrictModel, checked, read_yaml
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.errors import ScenarioError
from aerodima.workbench.resources import model_path

SCHEMA = "aerodima/short_turn/1"
ENTRIES, CASES = "short_turn/candidates.yaml", "short_turn/cases.csv"
STEP, LOG_RATE = 0.0005, 500.0
"""Step of the plant (s) and rate of the log (Hz) of the runs that the table rests on."""
PULSE, AFTER = 0.5, 1.5
"""How long the wheels are steered, and the run goes on after that, s."""
_KEY = ["car", "speed_m_per_s", "floor"]


class Entry(StrictModel):
    """A candidate.

    Attributes:
        name: in the table.
        words: on the page.
        settings: of the scenario.
    """

    name: str
    words: str
    settings: list[str]


class Entries(StrictModel):
    """What the table is made of; the first candidate is the reference, the last one the best that is known."""

    schema_: str = Field(alias="schema")
    scenario: str
    ensemble: str
    seed: int
    test_cars: int
    speeds_m_per_s: list[float]
    floors: list[float]
    candidates: list[Entry]


def load_entries() -> Entries:
    """The shipped list.

    Raises:
        ScenarioError: a key is missing, unknown or of another kind.
    """
    path = model_path(ENTRIES)
    return checked(Entries, read_yaml(path), str(path), schema=SCHEMA)


@dataclass(frozen=True)
class ShortTurn:
    """The table and the case that is shown.

    Attributes:
        entries: the candidates.
        cases: columns of `aerodima swing judge`, a row per candidate and case.
        gains: of the last candidate over the first by (car, speed, floor), rising.
        shown: index of the case that is shown.
    """

    entries: Entries
    cases: pd.DataFrame
    gains: pd.Series
    shown: tuple[str, float, float]

    def row(self, name: str) -> pd.Series:
        """What the table says of a candidate in the case that is shown."""
        own = self.cases
        for column, value in zip(["candidate", *_KEY], (name, *self.shown), strict=True):
            own = own[own[column] == value]
        return own.iloc[0]

    @property
    def steering_deg(self) -> float:
        """That all of them get in the case that is shown: the best one of the last candidate."""
        return float(self.row(self.entries.candidates[-1].name)["steering_deg"])

    def scenario(self, name: str, steering_deg: float | None = None) -> Scenario:
        """The run of a candidate in the case that is shown; with its own best steering unless it is given."""
        row = self.row(name)
        angle = float(row["steering_deg"]) if steering_deg is None else steering_deg
        return turn_of(self.entries, name, self.shown, float(row["friction"]), angle)


def load_short_turn() -> ShortTurn:
    """The shipped table, and the case in its middle.

    Raises:
        ScenarioError: the table and the list of candidates do not go together.
    """
    entries, cases = load_entries(), pd.read_csv(model_path(CASES))
    names = [one.name for one in entries.candidates]
    if list(dict.fromkeys(cases["candidate"])) != names:
        raise ScenarioError(f"{CASES}: has not the candidates of {ENTRIES}: {', '.join(names)}")
    course = cases.set_index(["candidate", *_KEY])["course_change_rad"]
    gains = (course.loc[names[-1]] / course.loc[names[0]] - 1.0).sort_values()
    return ShortTurn(entries, cases, gains, gains.index[(len(gains) - 1) // 2])


def turn_of(
    entries: Entries, name: str, case: tuple[str, float, float], friction: float, steering_deg: float
) -> Scenario:
    """The run of a candidate on a floor of that friction, steered by that amplitude (degrees)."""
    car = next(member for member in load_ensemble(entries.ensemble).members if member.name == case[0])
    who = next(one for one in entries.candidates if one.name == name)
    start = load_scenario(entries.scenario).manoeuvre.turn_start
    settings = [
        *car.settings_on(entries.scenario),
        f"simulation.step={STEP!r}",
        f"simulation.log_rate={LOG_RATE:g}",
        *who.settings,
        f"manoeuvre.speed={float(case[1])!r}",
        f"car.tyre_friction={float(friction)!r}",
        f"manoeuvre.steer_angle={math.radians(steering_deg):.9g}",
        f"manoeuvre.turn_hold={PULSE!r}",
        f"manoeuvre.duration={start + PULSE + AFTER:.9g}",
    ]
    return load_scenario(entries.scenario, settings)
