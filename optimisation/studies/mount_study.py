"""The yaw penalty of a swing (thesis Figure 7.9) and its remedies: place of the tail, front ballast, longer steering.

A tail that swings outwards behind the centre of mass pushes the car's tail inwards: it takes yaw rate from the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_report import Findings, band, by_value, ran, survived_share
from aerodima.optimisation.sweep.rollover_threshold import SPEED
from aerodima.optimisation.sweep.study import Block, Range, Study, Value
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError
from aerodima.workbench.figures.figure_style import CAUSE_STYLES, MODE_STYLES, new_figure, styled
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.report.report_page import Plot, zoomable

MOUNTS = (-0.06, -0.03, 0.03, 0.09, 0.15)
"""Tail joints ahead of the rear axle, m; the range that keeps the gearbox on the car."""
STEERING = (0.5, 0.6, 0.7)
"""Duration of the steering command, s; 0.5 is published."""
BALLASTS = (0.5, 1.0)
"""Added mass in front, kg."""
BALLAST_PLACE = (0.30, 0.10)
"""Ahead of the rear axle and above the ground, m: on the front bumper."""
STUDY_SPEED = 3.05
"""m/s, 11 km/h: a speed that the tailless car survives at all steering durations, for its heading change to compare."""

HOLD, MOUNT = "manoeuvre.turn_hold", "tail.mount_x"


def mount_study(settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None) -> Study:
    """Cars without tail, with it held and swung, over mount, ballast and steering duration.

    Raises:
        SweepError: an ensemble is given: the ballast is added to the one car of the settings.
    """
    if ensemble is not None:
        raise SweepError(f"mount: --ensemble {ensemble}: the ballast cases are made for one car; allowed: --set")
    common = (f"{SPEED}={STUDY_SPEED}", *settings)
    steering: dict[str, list[Value] | Range] = {HOLD: list[Value](STEERING)}
    blocks = [
        Block(
            name=f"tail {mode}" if mode != "none" else "no tail",
            scenario=f"turn_{mode}",
            settings=common,
            grid=steering,
        )
        for mode in ("none", "held", "swing")
    ]
    for place in MOUNTS:
        at = (*common, f"{MOUNT}={place}")
        blocks.append(Block(name=f"mount {place:+g} m", scenario="turn_swing", settings=at, grid=steering))
    for mass in BALLASTS:
        heavier = (*common, *ballast(mass, settings))
        blocks.append(Block(name=f"ballast {mass:g} kg", scenario="turn_swing", settings=heavier, grid=steering))
    name = "Mount: the yaw penalty of a swing and its remedies"
    return Study(name=name, signals="all", ensemble=ensemble, members=members, blocks=tuple(blocks))


def ballast(mass: float, settings: Sequence[str] = ()) -> tuple[str, ...]:
    """Settings of the car with a mass (kg) at `BALLAST_PLACE`: mass and centre of mass; gyration radii are kept."""
    car = load_scenario("turn_swing", settings).car
    total = car.mass + mass
    ahead, above = (
        (car.mass * own + mass * place) / total
        for own, place in zip((car.com_x, car.com_height), BALLAST_PLACE, strict=True)
    )
    return (f"car.mass={total!r}", f"car.com_x={ahead!r}", f"car.com_height={above!r}")


def read_mount(frame: pd.DataFrame) -> Findings:
    """Yaw rate, heading change and the tail's yaw impulse of every case; of runs that were survived."""
    reference = ran(frame[(frame["block"] == "no tail") & (frame["outcome"] == "survived")])
    headings = {hold: band(rows, "heading_change_rad")[1] for hold, rows in by_value(reference, HOLD)}
    published = headings.get(STEERING[0], float("nan"))
    rows: list[dict[str, Any]] = []
    cases = [
        (case, *group) for case in frame["block"].unique() for group in by_value(frame[frame["block"] == case], HOLD)
    ]
    for case, hold, part in cases:
        runs = ran(part[part["outcome"] == "survived"])
        heading = band(runs, "heading_change_rad")[1]
        rows.append(
            {
                "case": case,
                "steering_s": hold,
                "survived_share": survived_share(part),
                "average_yaw_rate_rad_per_s": band(runs, "average_yaw_rate_rad_per_s")[1],
                "heading_change_rad": heading,
                "of_tailless_heading": heading / published,
                "tail_inertial_yaw_impulse_n_m_s": _impulse(runs, "inertial"),
                "tail_aerodynamic_yaw_impulse_n_m_s": _impulse(runs, "aerodynamic"),
                "peak_roll_rad": band(runs, "peak_roll_rad")[1],
            }
        )
    pictures = (
        zoomable(
            _heading_figure(rows, published),
            "Heading change over the duration of the steering, where the car survived; dashed: the tailless car with "
            "the published 0.5 s.",
            "Heading change of each case over the steering duration",
            "heading",
        ),
        Plot(
            _impulse_figure(rows),
            "Angular impulse of the tail on the car about the vertical through its centre of mass over the turn, with "
            "the published steering. Negative: out of the turn.",
            "Yaw impulse of the tail by cause and case",
            "yaw_impulse",
        ),
    )
    columns = ("block", HOLD, "outcome", "clean", "average_yaw_rate_rad_per_s", "heading_change_rad", "peak_roll_rad")
    return Findings(rows, _sentences(rows), pictures, columns)


def _impulse(runs: pd.DataFrame, cause: str) -> float | None:
    column = f"{cause}_yaw_impulse_window_n_m_s"
    return band(runs, column)[1] if column in runs.columns and runs[column].notna().any() else None


def _sentences(rows: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    found = {(row["case"], row["steering_s"]): row for row in rows}
    none, swing = found["no tail", STEERING[0]], found["tail swing", STEERING[0]]
    turned = [key for key, row in found.items() if row["of_tailless_heading"] >= LEAST_HEADING]
    enough = [f"{case} with {hold:g} s" for case, hold in turned if not case.startswith("no tail")]
    return (
        f"With the published steering the swing turns the car by {swing['heading_change_rad']:.2f} rad against "
        f"{none['heading_change_rad']:.2f} rad without tail ({swing['of_tailless_heading']:.0%}).",
        f"At least 95 % of the tailless heading change reach: {', '.join(enough) or 'no case'}.",
        "All cars have the same friction and speed; whether a remedy keeps the rollover margin shows the peak roll.",
    )


def _heading_figure(rows: Sequence[dict[str, Any]], published: float) -> Figure:
    with styled():
        figure, axes = new_figure(7.2, 4.4)
        ax = axes[0, 0]
        for place, case in enumerate(dict.fromkeys(row["case"] for row in rows)):
            mine = [row for row in rows if row["case"] == case]
            style = {"no tail": "none", "tail held": "held", "tail swing": "swing"}.get(case)
            look: dict[str, Any] = {"alpha": 0.8, "linestyle": ":", "marker": "v^<>dP*"[place % 7], "markersize": 5}
            if style is not None:
                look = {"color": MODE_STYLES[style].colour, "marker": MODE_STYLES[style].marker, "linewidth": 2.2}
            x = [row["steering_s"] for row in mine]
            ax.plot(x, [row["heading_change_rad"] for row in mine], label=case, **look)
        ax.axhline(published, color="k", linestyle="--", linewidth=0.8)
        ax.set(xlabel="duration of the steering, s", ylabel="heading change, rad", title="How far the car turns")
        figure.legend(loc="outside right upper")
    return figure


def _impulse_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    mine = [row for row in rows if row["steering_s"] == STEERING[0] and row["case"] != "no tail"]
    with styled():
        figure, axes = new_figure(7.2, 0.36 * len(mine) + 1.2)
        ax = axes[0, 0]
        for shift, cause in ((-0.18, "aerodynamic"), (0.18, "inertial")):
            word, colour, hatch, _ = CAUSE_STYLES[cause]
            values = [row[f"tail_{cause}_yaw_impulse_n_m_s"] or 0.0 for row in mine]
            places = [place + shift for place in range(len(mine))]
            ax.barh(places, values, 0.34, color=colour, hatch=hatch, edgecolor="white", label=word)
        ax.set_yticks(range(len(mine)), [row["case"] for row in mine])
        ax.invert_yaxis()
        ax.axvline(0.0, color="k", linewidth=0.8)
        ax.set(xlabel="yaw impulse of the tail, N m s (positive: into the turn)", title="What the tail does to the yaw")
        ax.legend()
    return figure
