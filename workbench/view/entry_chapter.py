"""Entry speeds (`models/entry`): table of `aerodima swing judge`, some of its cars in step."""

import math
from collections.abc import Mapping

import pandas as pd
from pydantic import Field

from aerodima.workbench.car.tip_up import TWO_WHEELS, tip_up
from aerodima.workbench.car.turn_signals import EXIT_YAW_RATE, steered_windows
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
    """What is shown: manoeuvre, car and floor by their names in the table, with scenario, settings
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
        """The run of a candidate."""
        car = next(
            member for member in load_ensemble(self.ensemble).members if member.name == self.car
        )
        own = [*car.settings_on(self.scenario), *self.settings, *who.settings]
        return load_scenario(self.scenario, [*own, f"manoeuvre.speed={self.speed_m_per_s!r}"])


def load_shown_entry() -> ShownEntry:
    """The shipped choice. ScenarioError where a key is missing, unknown or of another kind."""
    path = model_path(SHOWN)
    return checked(ShownEntry, read_yaml(path), str(path), schema=SCHEMA)


def _entries() -> pd.DataFrame:
    """The shipped table; a run that came to nothing leaves the entry speed unknown, NaN."""
    table = pd.read_csv(model_path(ENTRIES))
    return table.assign(
        **{SPEED: table[SPEED].mask(table["ended_by"].fillna("").str.startswith(UNKNOWN))}
    )


def entry_medians(floor: str = "x 1.2") -> pd.DataFrame:
    """Median entry speeds of the shipped table on a floor as texts: a row per candidate, a column
    per manoeuvre.

    In brackets: how many cars complete the manoeuvre.
    """
    table = _entries().query("floor == @floor")
    cells = {
        case: _median(own) for case, own in table.groupby(["candidate", "manoeuvre"], sort=False)
    }
    return pd.Series(cells).unstack()[table["manoeuvre"].unique()].loc[table["candidate"].unique()]


def _median(own: pd.DataFrame) -> str:
    speeds = own.dropna(subset=SPEED)
    if speeds.empty:
        return "none"
    median = speeds[SPEED].median()
    unbounded = speeds[SPEED].mask(speeds["at_ceiling"], math.inf).median()
    return f"{'≥ ' if unbounded > median else ''}{median:.2f} ({len(speeds)} of {len(own)})"


def entry_chapter(shown: ShownEntry, run_logs: Mapping[str, RunLog]) -> list[Section]:
    """The replays in step, and the medians of all manoeuvres.

    Args:
        shown: what is shown.
        run_logs: name of a candidate -> its run.
    """
    who = {one.name: one.words for one in shown.candidates}
    place = "manoeuvre == @shown.manoeuvre and car == @shown.car and floor == @shown.floor"
    there = _entries().query(place).set_index("candidate")[SPEED]
    speeds = there.map("enters at {:.2f} m/s at most".format).mask(
        there.isna(), "completes it at no speed"
    )
    captions = [
        f"{words}: {_ending(run_logs[name])} ({speeds[name]})" for name, words in who.items()
    ]
    case = f"{shown.manoeuvre} at {shown.speed_m_per_s:g} m/s ({shown.car}, friction {shown.floor})"
    medians = entry_medians(shown.floor)
    rows = [
        [who.get(name, name), *row]
        for name, row in zip(medians.index, medians.to_numpy(), strict=True)
    ]
    said = (
        "Medians in m/s over the cars that complete a manoeuvre, and how many do: two wheels of "
        "one side never lift by 5 mm, only wheels touch the ground, the car goes straight again, "
        "and before that its mean lateral acceleration is nearly that without a tail. The cars are "
        "few, each on its own floor, with a larger tail than was built, and ≥ says that climbs "
        "ended at their ceiling."
    )
    return [
        Section(
            f"In step: {case}",
            [replays_in_step([run_logs[name] for name in who], list(who.values()), captions)],
        ),
        Section("How fast they may enter", [Table(["candidate", *medians], rows), said]),
    ]


def _ending(run_log: RunLog) -> str:
    found = tip_up(run_log, steered_windows(run_log))
    if outcome_of(run_log).result == "flipped":
        return "rolls over"
    last = found.last_yaw_rate_rad_per_s or 0.0
    said = "stays upright"
    if found.touched_when_steered:
        said = f"{found.touched_when_steered} on the ground"
    if (found.side_lift_m or 0.0) > TWO_WHEELS:
        said = "lifts two wheels"
    elif abs(last) > EXIT_YAW_RATE:
        said += ", goes on turning"
    return f"{said}, {found.lateral_acceleration_m_per_s2 or math.nan:.1f} m/s² to the side"
