"""Entry speeds (`models/entry`): table of `aerodima swing judge`, some of its cars in step."""

import math
from collections.abc import Mapping

import pandas as pd
from pydantic import Field

from aerodima.workbench.car.tip_up import tip_up
from aerodima.workbench.car.turn_signals import steered_windows
from aerodima.workbench.car.verdict import EXIT_YAW_RATE, TWO_WHEELS
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.view.replay_page import replays_in_step
from aerodima.workbench.view.report_page import Section, Table

SCHEMA = "aerodima/shown_entry/1"
SHOWN = "entry/shown.yaml"
ENTRIES = "entry/entries.csv"
SPEED = "entry_speed_m_per_s"
UNKNOWN = ("error: ", "no reference", "not proved")
"""Begins `ended_by` of a climb that says nothing about the candidate."""


class ShownCandidate(StrictModel):
    """A candidate: its name in the table, its words on the page, its settings of the scenario."""

    name: str
    words: str
    settings: list[str]


class ShownEntry(StrictModel):
    """The shown case: manoeuvre, car and floor by their names in the table, with scenario, settings
    and speed.
    """

    schema_: str = Field(alias="schema")
    manoeuvre: str
    scenario: str
    ensemble: str
    car: str
    floor: str
    speed_m_per_s: float
    settings: list[str]
    candidates: list[ShownCandidate]

    def run(self, who: ShownCandidate) -> Scenario:
        """Makes the run of a candidate."""
        members = load_ensemble(self.ensemble).members
        car = next(member for member in members if member.name == self.car)
        speed = f"manoeuvre.speed={self.speed_m_per_s!r}"
        settings = [*car.settings_on(self.scenario), *self.settings, *who.settings, speed]
        return load_scenario(self.scenario, settings)


def load_shown_entry() -> ShownEntry:
    """Loads the shipped choice; ScenarioError where a key is missing, unknown or wrong."""
    path = model_path(SHOWN)
    return checked(ShownEntry, read_yaml(path), str(path), schema=SCHEMA)


def _entries() -> pd.DataFrame:
    """Reads the shipped table; a run that came to nothing leaves the entry speed unknown, NaN."""
    table = pd.read_csv(model_path(ENTRIES))
    unknown = table["ended_by"].fillna("").str.startswith(UNKNOWN)
    table[SPEED] = table[SPEED].mask(unknown)
    return table


def entry_medians(floor: str = "x 1.2") -> pd.DataFrame:
    """Lists median entry speeds of the shipped table on a floor as texts: a row per candidate, a
    column per manoeuvre.

    In brackets: how many cars complete the manoeuvre.
    """
    table = _entries().query("floor == @floor")
    cases = table.groupby(["candidate", "manoeuvre"], sort=False)
    cells = pd.Series({case: _median(cars) for case, cars in cases}).unstack()
    return cells.loc[table["candidate"].unique(), table["manoeuvre"].unique()]


def _median(cars: pd.DataFrame) -> str:
    """Writes the median speed of the cars that complete a manoeuvre, and how many do."""
    speeds = cars.dropna(subset=SPEED)
    if speeds.empty:
        return "none"
    median = speeds[SPEED].median()
    unbounded = speeds[SPEED].mask(speeds["at_ceiling"], math.inf).median()
    return f"{'≥ ' if unbounded > median else ''}{median:.2f} ({len(speeds)} of {len(cars)})"


def entry_chapter(shown: ShownEntry, run_logs: Mapping[str, RunLog]) -> list[Section]:
    """Shows the replays in step, and the medians of all manoeuvres.

    Args:
        shown: what is shown.
        run_logs: name of a candidate -> its run.
    """
    words = {candidate.name: candidate.words for candidate in shown.candidates}
    place = "manoeuvre == @shown.manoeuvre and car == @shown.car and floor == @shown.floor"
    limits = _entries().query(place).set_index("candidate")[SPEED]
    logs = [run_logs[name] for name in words]
    captions = []
    for name, run_log in zip(words, logs, strict=True):
        limit = f"enters at {limits[name]:.2f} m/s at most"
        if math.isnan(limits[name]):
            limit = "completes it at no speed"
        captions.append(f"{words[name]}: {_ending(run_log)} ({limit})")
    case = f"{shown.manoeuvre} at {shown.speed_m_per_s:g} m/s ({shown.car}, friction {shown.floor})"
    medians = entry_medians(shown.floor)
    rows = [[words.get(row[0], row[0]), *row[1:]] for row in medians.itertuples(name=None)]
    explanation = (
        "Medians in m/s over the cars that complete a manoeuvre, and how many do: two wheels of "
        "one side never lift by 5 mm, only wheels touch the ground, the car goes straight again, "
        "and before that its mean lateral acceleration is nearly that without a tail. The cars are "
        "few, each on its own floor, with a larger tail than was built, and ≥ says that climbs "
        "ended at their ceiling."
    )
    replays = replays_in_step(logs, list(words.values()), captions)
    table = Table(["candidate", *medians], rows)
    return [
        Section(f"In step: {case}", [replays]),
        Section("How fast they may enter", [table, explanation]),
    ]


def _ending(run_log: RunLog) -> str:
    """Says how a run ended, and how hard the car turned."""
    result = tip_up(run_log, steered_windows(run_log))
    if outcome_of(run_log).result == "flipped":
        return "rolls over"
    ending = "stays upright"
    if result.touched_when_steered:
        ending = f"{result.touched_when_steered} on the ground"
    if (result.side_lift_m or 0.0) > TWO_WHEELS:
        ending = "lifts two wheels"
    elif abs(result.last_yaw_rate_rad_per_s or 0.0) > EXIT_YAW_RATE:
        ending += ", goes on turning"
    return f"{ending}, {result.lateral_acceleration_m_per_s2 or math.nan:.1f} m/s² to the side"
