"""What a study of one's own car leaves: law, proved turn, tables, and the page of the corner study with more on it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from aerodima.optimisation.studies.contestants import NO_TAIL
from aerodima.optimisation.studies.corner_floors import turn_settings
from aerodima.optimisation.studies.corner_page import corner_page, gains, how_measured, summarise_corner
from aerodima.optimisation.studies.corner_plan import AFTER, PULSE
from aerodima.optimisation.studies.law_files import SCHEMA
from aerodima.optimisation.studies.own_car_study import LAW, TURN, WORDS, OwnCar, stated_car, stated_numbers
from aerodima.optimisation.studies.study_store import drop_stale
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, rounded
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.errors import SweepError
from aerodima.workbench.figures.figure_style import BLUE, GREY, new_figure, styled
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Page,
    Preformatted,
    Section,
    Table,
    write_files,
    zoomable,
)

PAGE = "study.html"


def write_own_car(out: Path, found: OwnCar) -> list[Path]:
    """Writes law, turn, tables and page into the folder of the study."""
    summary = summarise_corner(found.unseen.cases, found.corner.contestants)
    tables = {"cases.csv": found.corner.cases, "summary.csv": summary, "laws.csv": found.corner.laws}
    turn = turn_file(found)
    files = {LAW: law_file(found)} | ({} if turn is None else {TURN: turn})
    drop_stale(out, [TURN], files)
    return write_files(out, {**tables, **files, PAGE: own_car_page(out, found)}, error=SweepError)


def law_file(found: OwnCar) -> str:
    """The law as a list of one, for `aerodima corner --law`."""
    law = {"name": WORDS["trained"], "settings": list(found.law.at(found.speed)), "chosen": "aerodima study swing"}
    return yaml.safe_dump({"schema": SCHEMA, "contestants": [law]}, sort_keys=False, width=110)


def turn_file(found: OwnCar) -> str | None:
    """The run that proved the law on the stated car, as a scenario; None when none did."""
    row = found.own[found.own["contestant"] == found.law.name].iloc[0]
    if math.isnan(row["steering_deg"]):
        return None
    plan = found.plan
    end = load_scenario(plan.scenario).manoeuvre.turn_start + PULSE + AFTER
    data = {key: dict(value) if isinstance(value, dict) else value for key, value in found.data.items()}
    for setting in (
        *turn_settings(plan.scenario, found.law, stated_car(), found.speed, plan.fine_step),
        f"{FRICTION}={float(row['friction'])!r}",
        f"manoeuvre.steer_angle={rounded(math.radians(row['steering_deg']))!r}",
        f"manoeuvre.turn_hold={PULSE!r}",
        f"manoeuvre.duration={end:.9g}",
    ):
        Scenario.apply_setting(data, setting)
    return yaml.safe_dump(data, sort_keys=False, width=110)


def own_rows(found: OwnCar) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the stated car, for page and terminal."""
    header = [
        "",
        "steering [deg]",
        "course [deg]",
        "over no tail",
        "exit [s]",
        "peak roll [deg]",
        "friction, full lock",
    ]
    table, rows = gains(found.own, NO_TAIL.name), []
    for words, grip, row in zip(WORDS.values(), found.at_full_lock, table.to_dict("records"), strict=True):
        turned = np.degrees([row["course_change_rad"], row["peak_roll_rad"]])
        shown: list[Any] = [row["steering_deg"], turned[0], 100.0 * row["gain"], row["exit_time_s"], turned[1]]
        formats = ("{:.1f}", "{:.1f}", "{:+.1f} %", "{:.2f}", "{:.1f}")
        cells = ["-" if value != value else form.format(value) for form, value in zip(formats, shown, strict=True)]
        rows.append([words, *cells, found.grip_words(grip, 4)])
    return header, rows


def own_car_page(out: Path, found: OwnCar) -> Page:
    """The result first, then how to drive the law, what was known of the car, and the corner study of unseen cars."""
    unseen = found.unseen
    known = [f"{key}: {value}" for key, value in stated_numbers(found.data).items()]
    left_out = "".join(f" Left out: {words}." for words in found.corner.without_floor)
    how = how_measured(found.plan, found.test, (stated_car(), *found.training)) + left_out
    plot = zoomable(
        plot_courses(found), "Bar: the stated car; dots: unseen cars.", "Course turned by each contestant", "courses"
    )
    first, *others = corner_page(unseen, summarise_corner(unseen.cases, unseen.contestants), how).sections
    sections = [
        Section("Your car", [Finding([found.sentence() + ".", Table(*own_rows(found))]), plot]),
        Section("Drive the law", [_driving(out, found)]),
        Section("What was known", [KNOWN, Bullets(known or ["nothing: the car of the parameter files"])]),
        replace(first, title="Unseen cars"),
        *others,
        Section("Limits", [LIMITS]),
    ]
    lead = f"{found.data.get('name', found.plan.scenario)}: a law trained for it, by the course of a short turn."
    return Page("A swing for your car", lead, sections)


KNOWN = (
    "Stated of the car, and therefore the same on all training and unseen cars, but for friction and steering, which "
    "the study sets. In everything else these differ as the cars of the ensemble do, and the stated car is that of the "
    "parameter files:"
)
LIMITS = (
    "The law was trained on the stated car too: its figures there are those of a car that it knows; the unseen cars "
    "are the test. It is timed for this pulse and would swing in the middle of a longer turn; it has no feedback. A "
    "course is read when the car has left the turn, which some leave later than others (exit). Friction at full lock: "
    "the highest of an unbroken row of clean turns at the ordinary step, on the stated car."
)


def _driving(out: Path, found: OwnCar) -> Preformatted:
    judge = f"aerodima corner --scenario {found.plan.scenario} --law {out / LAW} --out out/corner"
    proved = f"aerodima turn --scenario {out / TURN} --replay turn.html"
    return Preformatted("\n".join([*([proved] if turn_file(found) else []), judge]))


def plot_courses(found: OwnCar) -> Figure:
    """Course of the stated car as bars, of the unseen cars as dots, a row per contestant."""
    names, own = [who.name for who in found.corner.contestants], np.degrees(found.own["course_change_rad"].to_numpy())
    cases = found.unseen.cases
    with styled():
        image, grid = new_figure(9.0, 1.2 + 0.5 * len(names))
        axes = grid[0, 0]
        for place, (name, course) in enumerate(zip(names, own, strict=True)):
            turned = np.degrees(cases[cases["contestant"] == name]["course_change_rad"].to_numpy(float))
            axes.barh(-place, np.nan_to_num(course), color=BLUE, height=0.5)
            axes.plot(turned, np.full(turned.size, -place), ".", color=GREY)
        axes.set_yticks([-place for place in range(len(names))], list(WORDS.values()))
        axes.set_xlabel("course in 0.5 s, each with its best steering [deg]")
    return image
