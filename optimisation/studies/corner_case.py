"""The case in the middle of a corner study, driven once more: paths over one another, and the replays in step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.candidates import NO_TAIL, Candidate
from aerodima.optimisation.studies.corner_floors import turn_settings
from aerodima.optimisation.studies.corner_plan import CornerPlan
from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.figures.figure_style import new_figure, styled
from aerodima.workbench.figures.run_figures import RUN_STYLES
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.report.replay_page import replays_in_step
from aerodima.workbench.report.report_page import Plot, Section

KEY = ["car", "speed_m_per_s", "floor", "pulse_s"]
AFTER = 1.0
"""How long a run goes on after the steering, s."""
MARKS = 0.25
"""Between two marks on a path, s."""
MOST_SHOWN = 6
"""Candidates that are driven again: those with the largest courses, and the car without tail."""


def middle_case(cases: pd.DataFrame) -> pd.DataFrame | None:
    """Rows of the case whose largest gain over the car without tail is in the middle; None where nobody gains.

    The lesser of two in the middle. Candidates without a turn that counts are left out.
    """
    table = cases.pivot_table(index=KEY, columns="candidate", values="course_change_rad", sort=False)
    if NO_TAIL.name not in table or table.shape[1] < 2:
        return None
    best = table.drop(columns=NO_TAIL.name).max(axis=1) / table[NO_TAIL.name]
    order = best.dropna().sort_values()
    if order.empty:
        return None
    key = order.index[(len(order) - 1) // 2]
    chosen = cases.set_index(KEY).loc[[key]].reset_index().dropna(subset="course_change_rad")
    first = chosen[chosen["candidate"] == NO_TAIL.name]
    others = chosen[chosen["candidate"] != NO_TAIL.name].nlargest(MOST_SHOWN - 1, "course_change_rad")
    return pd.concat([first, others])


def case_sections(
    plan: CornerPlan, candidates: Sequence[Candidate], test: Sequence[Member], cases: pd.DataFrame
) -> list[Section]:
    """The section of the page that shows it; empty where no case can be shown."""
    shown = middle_case(cases)
    if shown is None:
        return []
    by_name = {who.name: who for who in candidates}
    cars = {car.name: car for car in test}
    rows = shown.to_dict("records")
    runs = {row["candidate"]: _run(plan, by_name[row["candidate"]], cars[row["car"]], row) for row in rows}
    names = [f"{row['candidate']}: {math.degrees(row['course_change_rad']):.0f}°" for row in rows]
    car, speed, floor, pulse = (rows[0][name] for name in KEY)
    words = (
        f"{car} at {speed:g} m/s on a floor of friction {rows[0]['friction']:.2f} ({floor:g} times the critical one), "
        f"a pulse of {pulse:g} s: of all cases the one in the middle by the largest gain over the car without "
        "tail. Each is steered as is best for it; paths begin at the steering command."
    )
    paths = Plot(
        plot_paths(dict(zip(names, runs.values(), strict=True))),
        f"From above; a mark every {MARKS:g} s.",
        "Paths of the candidates over one another",
    )
    return [Section("The case in the middle", [words, paths, replays_in_step(list(runs.values()), names)])]


def _run(plan: CornerPlan, who: Candidate, car: Member, row: Mapping[Any, Any]) -> RunLog:
    """The run of a row of the table, at the fine step, with everything logged."""
    from aerodima.workbench.simulate.simulation import simulate  # loads Drake

    angle, hold = math.radians(row["steering_deg"]), float(row["pulse_s"])
    settings = [
        *turn_settings(plan.scenario, who, car, float(row["speed_m_per_s"]), plan.fine_step),
        f"{FRICTION}={float(row['friction'])!r}",
        f"manoeuvre.steer_angle={angle!r}",
        f"manoeuvre.turn_hold={hold!r}",
        f"manoeuvre.duration={load_scenario(plan.scenario).manoeuvre.turn_start + hold + AFTER:.9g}",
    ]
    if time := row.get("first_level_time_s"):
        settings += [
            f"manoeuvre.first_angle={min(row['first_level'] * angle, plan.search.high)!r}",
            f"manoeuvre.first_hold={min(time, hold)!r}",
        ]
    return simulate(load_scenario(plan.scenario, settings))


def plot_paths(runs: Mapping[str, RunLog]) -> Figure:
    """Paths of the centre of mass from the steering command on, with the heading there along the first axis."""
    with styled():
        image, grid = new_figure(8.0, 4.2)
        axes = grid[0, 0]
        for (name, run_log), (colour, line) in zip(runs.items(), cycle(RUN_STYLES), strict=False):
            begin = run_log.scenario["manoeuvre"]["turn_start"]
            late = run_log.time >= begin
            yaw = float(run_log.signal("yaw_truth_rad")[late][0])
            points = run_log.vector("com", "truth_m")[late, :2]
            ahead = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
            x, y = ahead @ (points - points[0]).T
            axes.plot(x, y, color=colour, linestyle=line, label=name)
            time = run_log.time[late] - begin
            marks = np.searchsorted(time, np.arange(MARKS, time[-1] + 1e-9, MARKS))
            axes.plot(x[marks], y[marks], ".", color=colour)
        axes.set_aspect("equal")
        axes.set_xlabel("ahead [m]")
        axes.set_ylabel("to the left [m]")
        axes.legend()
    return image
