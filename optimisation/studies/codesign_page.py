"""Co-design as one piece of work: store, runs, tables and one page."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.codesign import (
    AROUND,
    OWN_LAW,
    Codesign,
    CodesignPlan,
    measure_codesign,
)
from aerodima.optimisation.studies.codesign_figures import plot_mounts, plot_outlines, plot_pareto, plot_sobol
from aerodima.optimisation.studies.contestants import NO_TAIL, THESIS
from aerodima.optimisation.studies.corner_page import gains
from aerodima.optimisation.studies.corner_plan import MOST_ROLL, MOST_SIDESLIP, PULSE
from aerodima.optimisation.studies.study_report import table_cells
from aerodima.optimisation.studies.study_store import drop_stale, open_runs
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunEngine
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.batch.row_store import saying_how_to_go_on
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.report.report_page import (
    Finding,
    Folded,
    Page,
    Part,
    Plot,
    Preformatted,
    Section,
    Table,
    write_files,
    zoomable,
)

PAGE = "codesign.html"
SOMETIMES = ("mounts", "sensitivities")
"""Tables that may be left out."""
_REFERENCES = {"published": THESIS.name, "own_law": OWN_LAW, "no_tail": NO_TAIL.name}


def make_codesign(
    out: Path,
    plan: CodesignPlan,
    nominal: Member,
    test: Sequence[Member],
    training: Sequence[Member],
    engine: RunEngine,
    *,
    force: bool = False,
    progress: ProgressLine = silent,
) -> tuple[Codesign, pd.DataFrame, list[Path]]:
    """Does what the folder does not hold yet, and writes tables and page; `measure_codesign` has the arguments.

    Returns:
        What was found, its summary, and the files.
    """
    start = time.monotonic()
    with open_runs(out, force=force) as store:
        remembering = RememberingEngine(engine, store, progress)
        with saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs and searches"):
            found = measure_codesign(plan, nominal, test, training, remembering)
    took = f"{remembering.ran} runs of full cars made in {time.monotonic() - start:.0f} s, the others were there"
    progress(took)
    summary = summarise(found, nominal)
    tables = {
        "summary.csv": summary,
        "tried.csv": found.tried,
        "finalists.csv": found.finalists,
        "cases.csv": found.corner.cases,
        "laws.csv": found.law_of_thesis,
    }
    tables |= {f"{name}.csv": table for name in SOMETIMES if len(table := getattr(found, name))}
    drop_stale(out, [f"{name}.csv" for name in SOMETIMES], tables)
    page = codesign_page(found, summary, _how(plan, nominal, test, training))
    return found, summary, write_files(out, {**tables, PAGE: page})


def summarise(found: Codesign, nominal: Member) -> pd.DataFrame:
    """A row per contestant: gains in course on the nominal and on the unseen cars, and its critical friction."""
    cases = found.corner.cases
    own = cases["car"] == nominal.name
    gained = {label: gains(cases, name)["gain"] for label, name in _REFERENCES.items()}
    rows = []
    for who in found.corner.contestants:
        mine = cases["contestant"] == who.name
        row: dict[str, Any] = {"contestant": who.name}
        for part, chosen in {"nominal": mine & own, "unseen": mine & ~own}.items():
            row[f"{part}_cases"] = int(chosen.sum())
            row[f"{part}_course_rad"] = float(cases[chosen]["course_change_rad"].median())
            row |= {f"{part}_over_{label}": float(values[chosen].median()) for label, values in gained.items()}
            row |= {
                f"{part}_worst_over_{label}": float(values[chosen].groupby(cases["car"]).median().min())
                for label, values in gained.items()
            }
        row["critical_friction"] = float(
            found.critical.set_index("contestant")["critical_friction"].get(who.name, np.nan)
        )
        rows.append(row)
    return make_frame(rows)


_GAINS = {
    "course_rad": "course [deg]",
    "over_published": "over the thesis' tail, published swing",
    "worst_over_published": "worst car",
    "over_own_law": "over the thesis' tail, trained law",
    "worst_over_own_law": "worst car",
    "over_no_tail": "over no tail",
}
PARTS = {"nominal": "Nominal car", "unseen": "Unseen cars"}


def gain_cells(summary: pd.DataFrame, part: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the summary for `nominal` or `unseen` cars."""
    shown = {f"{part}_{name}": words for name, words in _GAINS.items() if part != "nominal" or "worst" not in name}
    names = {"contestant": PARTS[part], **shown}
    if part == "nominal":
        names["critical_friction"] = "critical friction at full lock"
    return list(names.values()), [[_cell(name, row[name]) for name in names] for row in summary.to_dict("records")]


def _cell(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    if value != value:
        return "-"
    if "_over_" in name:
        return f"{value:+.1%}"
    return f"{np.degrees(value):.1f}" if name.endswith("_rad") else f"{value:.3f}"


_SIZES = {
    "length [m]": ("tail.length", 1.0),
    "sail, along the tail [m]": ("tail.sail_length", 1.0),
    "chord [m]": ("tail.sail_width", 1.0),
    "area [m2]": ("area", 1.0),
    "areal mass [kg/m2]": ("areal_mass", 1.0),
    "mass [g]": ("tail.mass", 1000.0),
    "inertia about the roll axis, with rotor [kg m2]": ("inertia", 1.0),
    "mount ahead of the rear axle [m]": ("tail.mount_x", 1.0),
    "mount over the ground [m]": ("tail.mount_height", 1.0),
    "weight sideways [N m]": ("weight_torque", 1.0),
    "torque over a cycle [N m]": ("rms_torque", 1.0),
    "overload of a swing [N2 m2 s]": ("overload", 1.0),
    "swing [rad/s]": ("swing_speed", 1.0),
    "delay [s]": ("delay", 1.0),
}


def codesign_page(found: Codesign, summary: pd.DataFrame, how: str) -> Page:
    """What was found, as a page."""
    parts = [part for part in PARTS if summary[f"{part}_cases"].any()]
    sections = [
        Section("What is gained", [Finding([Table(*gain_cells(summary, part)) for part in parts]), how]),
        Section("Course against mass", [_pareto_plot(found), PARETO]),
        Section("Designs", _designs(found)),
    ]
    if len(found.mounts):
        sections.append(Section("Where the tail stands", [_mount_plot(found.mounts), MOUNT, _whole(found.mounts)]))
    if len(found.sensitivities):
        sections.append(Section("What the course depends on", [_sensitivity_plot(found.sensitivities), SENSITIVE]))
    sections.append(
        Section(
            "Each case",
            [
                Folded("Cases", [_whole(found.corner.cases)]),
                Folded("Laws of the thesis' tail", [_whole(found.law_of_thesis)]),
            ],
        )
    )
    return Page(
        "Tail and law designed together", "Course turned by a short pulse of steering, by mass of the tail.", sections
    )


PARETO = (
    "Worth: course over that of the published swing of the thesis' tail, half the mean over the training cases, half "
    "that of the worst training car. Reduced cars choose the finalists, full training cars the designs."
)
MOUNT = (
    "The nominal car, 2 ms, each place with its own best steering. The gearbox stays where it is: a longer or shorter "
    "shaft carries the joints. Yaw impulses are those of the tail on the car about the vertical through its centre of "
    "mass, positive into the turn. Not allowed: what `aerodima models tail` says of the tail there."
)
SENSITIVE = (
    "Sobol indices of the course of the reduced nominal car with its best steering: every number moves by "
    f"{AROUND:.0%} of its searched range to either side of the design's, independently. First: share of the variance "
    "that the number explains alone; total: share in which it takes part. Lines: 95 % by bootstrap. What a car allows "
    "is not asked for."
)


def _designs(found: Codesign) -> list[Part]:
    tails = found.finalists.to_dict("records")
    header = ["searched for", *(str(row["searched_for"]) for row in tails)]
    rows = [
        ["chosen for", *(str(row["chosen_for"]) or "-" for row in tails)],
        ["course over the published swing, training", *(f"{row['worth'] - 1.0:+.1%}" for row in tails)],
    ]
    rows += [[words, *(f"{scale * row[key]:.4g}" for row in tails)] for words, (key, scale) in _SIZES.items()]
    parts: list[Part] = [Table(header, rows)]
    parts += [
        Folded(f"{design.name}: settings of aerodima turn", [Preformatted("\n".join(design.settings))])
        for design in found.designs
    ]
    words = "Rod and sail from the roll axis on, seen broadside, to one scale."
    return [*parts, zoomable(plot_outlines(found.tail_of_thesis, found.designs), words, "Outlines of tails", "tails")]


def _pareto_plot(found: Codesign) -> Plot:
    return zoomable(
        plot_pareto(found.tried, found.finalists),
        "Dots: tails on the reduced training cars, line: the best of each mass. Squares: finalists on the full ones.",
        "Worth of tails over their mass",
        "pareto",
    )


def _mount_plot(table: pd.DataFrame) -> Plot:
    return zoomable(
        plot_mounts(table),
        "Left: course and, dashed, heading at the exit; middle: critical friction at full lock; right: yaw impulse of "
        "the air, and dashed of inertia.",
        "Course, critical friction and yaw impulse over the place of the tail's joints",
        "mounts",
    )


def _sensitivity_plot(table: pd.DataFrame) -> Plot:
    return zoomable(
        plot_sobol(table), "Total and first-order index of each number.", "Sobol indices of the course", "sensitivities"
    )


def _whole(frame: pd.DataFrame) -> Table:
    return Table(list(frame.columns), table_cells(frame, list(frame.columns)))


def _how(plan: CodesignPlan, nominal: Member, test: Sequence[Member], training: Sequence[Member]) -> str:
    search = plan.corner.training
    return (
        f"Nominal car {nominal.name}; unseen cars {_names(test)}; training cars {_names(training)}; "
        f"{plan.corner.speeds[0]:g} m/s; floors {_listed(plan.corner.floors)} (training) and {_listed(plan.judged)} "
        "(judged) times the critical friction of the published swing of the thesis' tail at full lock; pulse "
        f"{PULSE:g} s. Peak roll at most {MOST_ROLL:g} rad, sideslip at the exit at most {MOST_SIDESLIP:g} rad. "
        f"Differential evolution: {search.laws} candidates for each number and {search.generations} generations per "
        f"budget, each with {search.steering_runs} steering runs per case; {search.finalists} finalists of each. "
        f"Judged at {1000 * plan.corner.fine_step:g} ms by the rule of the corner study; medians over the cases."
    )


def _names(cars: Sequence[Member]) -> str:
    return ", ".join(car.name for car in cars) or "none"


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
