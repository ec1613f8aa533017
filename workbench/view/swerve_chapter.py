"""Swerves of `models/swerve`: the stored table of `aerodima swing judge` and a case in step."""

import json
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from pydantic import Field

from aerodima.workbench.car.swerve import outline_from_above
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.view.replay_page import replays_in_step
from aerodima.workbench.view.report_page import Section, Table, Templated
from aerodima.workbench.view.run_channels import line_looks

SCHEMA = "aerodima/shown_swerve/1"
SHOWN = "swerve/shown.yaml"
SWERVES = "swerve/swerves.csv"
PLACE = ("tail", "floor", "car", "aim", "speed_m_per_s")
"""Columns that name a case and its swerve."""
AIM = "aside-0.5"
"""Aim whose medians are shown."""
NO_TAIL = "no tail"
"""Candidate that all others are compared with."""
FRAME_STEP = 0.02
"""Time between two pictures from above, s."""
AROUND = [0, 1, 2, 5, 4, 3]
"""Order of the corners of `car_outline` around the car."""


class ShownSwerve(StrictModel):
    """The shown case of the table; every candidate that completes it there is shown.

    Attributes:
        tail, floor, car, aim, speed_m_per_s: values of these columns of the table for the case.
        words: words on the page, by the name of a candidate that does not say enough.
    """

    schema_: str = Field(alias="schema")
    tail: str
    floor: str
    car: str
    aim: str
    speed_m_per_s: float
    words: dict[str, str]

    def rows(self) -> pd.DataFrame:
        """Returns the rows of the candidates whose full car completes the swerve."""
        table = stored_swerves()
        table = table[(table["plant"] == "full") & table["value"].notna()]
        for column in PLACE:
            table = table[table[column] == getattr(self, column)]
        return table.set_index("candidate")

    def runs(self) -> dict[str, Scenario]:
        """Makes the run of each of these candidates."""
        rows = self.rows()["settings"]
        return {str(name): load_scenario("swerve", json.loads(one)) for name, one in rows.items()}


def load_shown_swerve() -> ShownSwerve:
    """Loads the shipped case; ScenarioError where a key is missing, unknown or wrong."""
    path = model_path(SHOWN)
    return checked(ShownSwerve, read_yaml(path), str(path), schema=SCHEMA)


def stored_swerves() -> pd.DataFrame:
    """Reads the shipped table of `aerodima swing judge`: a row per candidate and swerve, NaN where
    none counts.
    """
    return pd.read_csv(model_path(SWERVES))


def swerve_medians(plant: str = "reduced") -> pd.DataFrame:
    """Lists median metres aside of the shipped table as texts: a row per candidate, a column per
    floor and speed.

    Each text also has the median gain over the same cars without tail, and in brackets how many
    cars complete the swerve. A dash stands for none, and for a case that was not compared.

    Args:
        plant: kind of cars, `reduced` or `full`.
    """
    table = stored_swerves()
    table = table[(table["plant"] == plant) & (table["aim"] == AIM)]
    columns = {}
    for (floor, speed), own in table.groupby(["floor", "speed_m_per_s"], sort=False):
        values = own.pivot(index="candidate", columns="car", values="value")
        gains = (values / values.loc[NO_TAIL] - 1.0).median(axis=1)
        cells = {}
        for candidate, row in values.iterrows():
            if row.count():
                name = str(candidate)
                cars = f"({row.count()} of {row.size})"
                cells[name] = f"{row.median():.3f}, {gains[name]:+.0%} {cars}"
        columns[f"friction {floor}, {speed:g} m/s"] = cells
    return pd.DataFrame(columns).reindex(table["candidate"].unique()).fillna("–")


def outlines_in_step(run_logs: Sequence[RunLog]) -> Templated:
    """Makes the picture from above that goes with `replays_in_step` of the same runs."""
    runs = []
    start = run_logs[0].number("manoeuvre", "turn_start")
    for log, look in zip(run_logs, line_looks(), strict=False):
        instants = np.arange(log.time[0], log.time[-2], FRAME_STEP)
        corners = outline_from_above(log, instants - start)[:, AROUND].T.round(3)
        runs.append({**look, "outlines": corners.tolist()})
    return Templated("from_above.html", {"runs": runs, "step": FRAME_STEP, "start": start})


def swerve_chapter(shown: ShownSwerve, run_logs: Mapping[str, RunLog]) -> list[Section]:
    """Shows the replays in step, and the medians of all cars.

    Args:
        shown: case of the table that is shown.
        run_logs: log of the run of each candidate, by the candidate's name.
    """
    values = shown.rows()["value"]
    captions = []
    names = []
    for name in run_logs:
        words = shown.words.get(name, name)
        names.append(words)
        captions.append(f"{words}: {values[name]:.2f} m aside after 0.5 s")
    case = f"{shown.speed_m_per_s:g} m/s, {shown.car}, friction {shown.floor}, {shown.tail} tail"
    logs = [*run_logs.values()]
    in_step = [outlines_in_step(logs), replays_in_step(logs, names, captions)]
    sections = [Section(f"In step: a swerve at {case}", in_step)]
    explanation = (
        "Metres that the last point of the car's outline has moved aside 0.5 s after the start of "
        "the steering, each candidate with its own best steering, those with rollover control with "
        "a driver at full lock: medians over test cars, the "
        "median gain over the same cars without tail, and how many complete the swerve. A swerve "
        "counts when the car is straight at its start, stays upright to the end and goes straight "
        "again there."
    )
    for plant in ("reduced", "full"):
        medians = swerve_medians(plant)
        rows = [
            [shown.words.get(str(row[0]), str(row[0])), *row[1:]]
            for row in medians.itertuples(name=None)
        ]
        table = Table(["candidate", *medians], rows)
        sections.append(Section(f"How far they swerve: {plant} cars", [table, explanation]))
    return sections
