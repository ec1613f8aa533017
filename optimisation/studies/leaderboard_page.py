"""The leaderboard as tables (CSV) and as one HTML page with pictures and links to replays.

The summary has one row per controller: medians over the cars, and on how many it does better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.contestants import THESIS, Contestant
from aerodima.optimisation.studies.leaderboard_runs import OUTCOMES, Leaderboard
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.swing.full_car import SPIN
from aerodima.workbench.config.ensemble import weighted_quantiles
from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
    styled,
)
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.report.report_page import Bullets, Link, Page, Plot, Section, Table, write_files, zoomable

ROUNDING = 1e-9
"""Of a gain."""


def summarise_board(board: Leaderboard) -> pd.DataFrame:
    """Medians and shares over the ensemble, or of the nominal car without one; one row per controller."""
    frictions, runs, speeds = (_weighted(table) for table in (board.frictions, board.runs, board.speeds))
    reference, best = (_values(frictions, contestant) for contestant in (_thesis(board), board.contestants[3]))
    rows = []
    for contestant in board.contestants:
        name = contestant.name
        own = frictions[frictions["controller"] == name]
        row: dict[str, Any] = {"controller": name, "cars": int(own["member"].nunique())}
        for speed, part in own.groupby("speed_m_per_s"):
            row[f"critical_friction_at_{speed:g}_m_per_s"] = _median(part["critical_friction"], part["weight"])
            there = runs[(runs["controller"] == name) & (runs["speed_m_per_s"] == speed)]
            row[f"rollover_probability_at_{speed:g}_m_per_s"] = _share(there["outcome"] == "flipped", there["weight"])
        turns = list(zip(own["member"], own["speed_m_per_s"], strict=True))
        values = own["critical_friction"].to_numpy(float)
        gain, over_best = (values / np.array([other[turn] for turn in turns]) - 1.0 for other in (reference, best))
        heading = own["heading_ratio"].to_numpy(float) >= LEAST_HEADING
        row["gain_over_8_rad_per_s"] = _median(gain, own["weight"])
        row["gain_over_best_fixed_speed"] = _median(over_best, own["weight"])
        row["share_no_worse_than_8_rad_per_s"] = _share(gain >= -ROUNDING, own["weight"])
        row["heading_ratio_median"] = _median(own["heading_ratio"], own["weight"])
        row["share_heading_at_least_95_percent"] = _share(heading, own["weight"])
        row["share_that_spins_with_8_rad_per_s"] = _share(own["spins_with_8_rad_per_s"], own["weight"])
        row["share_faster_turn"] = _share(heading & (gain > ROUNDING), own["weight"])
        top = speeds[speeds["controller"] == name]
        row["highest_speed_m_per_s"] = _median(top["highest_speed_m_per_s"], top["weight"])
        mine = runs[(runs["controller"] == name) & runs["clean"].fillna(False).astype(bool)]
        for column in OUTCOMES:
            row[f"median_{column}"] = _median(mine[column], mine["weight"]) if len(mine) else math.nan
        rows.append(row)
    return make_frame(rows)


def _thesis(board: Leaderboard) -> Contestant:
    return next(contestant for contestant in board.contestants if contestant.name == THESIS.name)


def _weighted(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the ensemble; those of the nominal car, alike in weight, where there are no others."""
    members = table[table["weight"] > 0.0]
    return members if len(members) else table.assign(weight=1.0)


def _values(frictions: pd.DataFrame, contestant: Contestant) -> dict[tuple[Any, Any], float]:
    own = frictions[frictions["controller"] == contestant.name]
    turns = zip(own["member"], own["speed_m_per_s"], strict=True)
    return dict(zip(turns, own["critical_friction"].to_numpy(float), strict=True))


def _median(values: Any, weights: Any) -> float:
    return float(weighted_quantiles(np.asarray(values, float), np.asarray(weights, float), [0.5])[0])


def _share(condition: Any, weights: Any) -> float:
    chosen, weight = np.asarray(condition, bool), np.asarray(weights, float)
    return float(weight[chosen].sum() / weight.sum()) if weight.sum() else math.nan


_COLOURS = (BLACK, BLUE, VERMILION, ORANGE, GREEN, PURPLE, SKY, GREY)
_MARKERS = "osd^vP*X"
PAGE = "leaderboard.html"
HOLLOW = "A hollow mark has turned less than 95 % as far as with 8 rad/s and is no faster turn."
CLAIMED = f"Highest tyre friction of an unbroken row survived clean. {HOLLOW}"
MEMBERS = f"The same over the cars of the ensemble. Large marks: median, dots: each car. {HOLLOW}"
COUNTS = (
    "Medians and shares over the cars, at the ordinary step. Critical friction: highest tyre friction of an "
    "unbroken row survived clean. A gain over the 8 rad/s swing counts where the heading change is at least 95 % "
    "of that swing's, compared at the highest friction that both survive. A car that spins with the 8 rad/s swing "
    f"(heading change above {SPIN:g} rad there) has no turn to compare with; it counts all the same."
)
ALTERNATIVE = "Critical friction of each controller over the speed of the turn"


def write_leaderboard(folder: Path, board: Leaderboard, replays: Mapping[str, str], how: str) -> list[Path]:
    """Writes one CSV per table and the page; earlier ones are replaced.

    Args:
        folder: of the leaderboard.
        board: what was measured.
        replays: controller -> file beside the page.
        how: one line about members, speeds and step.
    """
    frames = {field.name: getattr(board, field.name) for field in fields(board)} | {"summary": summarise_board(board)}
    tables = {f"{name}.csv": t for name, t in frames.items() if isinstance(t, pd.DataFrame) and len(t)}
    return write_files(folder, {**tables, PAGE: leaderboard_page(board, replays, how)})


def leaderboard_page(board: Leaderboard, replays: Mapping[str, str], how: str) -> Page:
    """What was measured, as a page."""
    members = plot_frictions(_shares(board.frictions))
    maps = "On the nominal car. Green: survived clean; hatched: something touched the ground; red: flipped."
    sections = [
        Section(
            "The car that the swings were made for, at the fine step",
            [how, _claims(board.claims), zoomable(plot_frictions(board.claims), CLAIMED, ALTERNATIVE)],
        ),
        Section(
            "Cars of the ensemble",
            [_summary(summarise_board(board)), COUNTS, zoomable(members, MEMBERS, ALTERNATIVE)],
        ),
        Section(
            "Survival over speed and friction",
            [Plot(plot_maps(board.map), maps, "One map of outcomes per controller")],
        ),
    ]
    if len(board.robustness):
        sections.append(_robustness(board.robustness))
    if replays:
        sections.append(Section("Replays", [Bullets([Link(target, name) for name, target in replays.items()])]))
    return Page(
        "Tail controllers on the same turns", "Who keeps the car on its wheels, clean, and still turns.", sections
    )


def _robustness(robustness: pd.DataFrame) -> Section:
    wide = robustness.pivot(index="controller", columns="change", values="critical_friction")
    order = list(dict.fromkeys(robustness["controller"]))
    changes = list(dict.fromkeys(robustness["change"]))
    rows = [[change, *(_cell("friction", wide.loc[name, change]) for name in order)] for change in changes]
    speed = robustness["speed_m_per_s"].iloc[0]
    words = f"Critical friction at {speed:g} m/s on the nominal car, as planned and with something otherwise."
    return Section("Robustness", [words, Table(["", *order], rows)])


def _claims(claims: pd.DataFrame) -> Table:
    """One row per speed and controller."""
    header = ["m/s", "controller", "critical friction", "over 8 rad/s", "heading", "at friction", "faster turn"]
    header += ["peak roll [deg]", "energy [J]", "torque [N m]"]
    rows = []
    for speed, part in claims.groupby("speed_m_per_s"):
        for row in part.to_dict("records"):
            faster = row["gain_over_8_rad_per_s"] > 1e-9 and row["heading_ratio"] >= LEAST_HEADING
            shown = [
                ("friction", "critical_friction"),
                ("gain", "gain_over_8_rad_per_s"),
                ("heading_percent", "heading_ratio"),
                ("friction", "heading_at_friction"),
            ]
            more = [("peak_rad", "peak_roll_rad"), ("", "tail_energy_j"), ("", "tail_torque_peak_n_m")]
            cells = [_cell(kind, row[name]) for kind, name in shown]
            edge = [_cell(kind, row[f"{name}_at_critical"]) for kind, name in more]
            rows.append([f"{speed:g}", row["controller"], *cells, "yes" if faster else "no", *edge])
    return Table(header, rows)


def _shares(frictions: pd.DataFrame) -> pd.DataFrame:
    """The cars of the ensemble, or the own one where there are none."""
    members = frictions[frictions["weight"] > 0.0]
    return members if len(members) else frictions


def _summary(summary: pd.DataFrame) -> Table:
    """One column per controller: there are more measures than controllers, and a page is taller than wide."""
    shown = [name for name in summary.columns if name != "controller"]
    columns = summary.to_dict("records")
    rows = [[_words(name), *(_cell(name, column[name]) for column in columns)] for name in shown]
    header = ["", *(column["controller"] for column in columns)]
    return Table(header, rows)


def _words(name: str) -> str:
    for unit in ("m_per_s", "rad_per_s", "n_m", "rad", "j"):
        if name.endswith(f"_{unit}") and "_at_" not in name and "8_rad" not in name:
            shown = {"m_per_s": "m/s", "rad_per_s": "rad/s", "n_m": "N m", "rad": "deg", "j": "J"}[unit]
            return f"{name.removesuffix('_' + unit).replace('_', ' ')} [{shown}]"
    return name.replace("_m_per_s", " m/s").replace("_rad_per_s", " rad/s").replace("_", " ")


def _cell(name: str, value: float) -> str:
    if value is None or value != value:
        return "-"
    if name == "cars":
        return f"{value:.0f}"
    if name.startswith(("gain", "share", "rollover", "heading_ratio", "heading_percent")):
        return f"{value:+.1%}" if name.startswith("gain") else f"{value:.1%}" if "percent" in name else f"{value:.0%}"
    if name.endswith("_rad"):
        return f"{np.degrees(value):.1f}"
    return f"{value:.4f}" if "friction" in name else f"{value:.2f}"


def plot_frictions(frictions: pd.DataFrame) -> Figure:
    """Critical friction over speed, one marker and colour per controller, side by side at each speed."""
    names = list(dict.fromkeys(frictions["controller"]))
    speeds = sorted(frictions["speed_m_per_s"].unique())
    with styled():
        image, grid = new_figure(11.0, 4.8)
        axes = grid[0, 0]
        for number, name in enumerate(names):
            colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
            own = frictions[frictions["controller"] == name]
            for place, speed in enumerate(speeds):
                part = own[own["speed_m_per_s"] == speed]
                x = place + 0.1 * (number - 0.5 * (len(names) - 1))
                axes.plot(np.full(len(part), x), part["critical_friction"], ".", color=colour, markersize=4, alpha=0.6)
                weights = part["weight"] if part["weight"].sum() else np.ones(len(part))
                median, turned = (
                    weighted_quantiles(part[column].astype(float), weights, [0.5])[0]
                    for column in ("critical_friction", "heading_ratio")
                )
                axes.plot(
                    x, median, marker, color=colour, markersize=9,
                    markerfacecolor=colour if turned >= LEAST_HEADING else "white", label=name if place == 0 else None,
                )  # fmt: skip
        axes.set_xticks(range(len(speeds)), [f"{speed:g} m/s" for speed in speeds])
        axes.set_ylabel("critical friction [1]")
        axes.set_xlabel("speed of the turn")
        image.legend(loc="outside upper center", ncols=4)
    return image


def plot_maps(survival: pd.DataFrame) -> Figure:
    """Small maps of outcome over speed and friction."""
    names = list(dict.fromkeys(survival["controller"]))
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    speeds, frictions = (sorted(survival[key].unique()) for key in ("speed_m_per_s", "friction"))
    with styled():
        image, grid = new_figure(11.0, 2.9 * rows, rows, columns, sharex=True, sharey=True)
        for axes, name in zip(grid.flat, names, strict=False):
            own = survival[survival["controller"] == name]
            for row in own.to_dict("records"):
                x, y = speeds.index(row["speed_m_per_s"]), frictions.index(row["friction"])
                flipped, clean = row["outcome"] != "survived", row["clean"] is True or row["clean"] == True  # noqa: E712
                colour = VERMILION if flipped else GREEN if clean else "#b8e0d2"
                axes.fill(
                    [x - 0.5, x + 0.5, x + 0.5, x - 0.5], [y - 0.5, y - 0.5, y + 0.5, y + 0.5], facecolor=colour,
                    edgecolor="white", hatch=None if flipped or clean else "///", linewidth=1.0,
                )  # fmt: skip
            axes.set_title(name, fontsize=9)
            axes.set_xticks(range(len(speeds)), [f"{speed:g}" for speed in speeds])
            axes.set_yticks(range(len(frictions)), [f"{friction:g}" for friction in frictions])
            axes.grid(False)
        for axes in list(grid.flat)[len(names) :]:
            axes.set_axis_off()
        image.supxlabel("speed [m/s]", fontsize=9.5)
        image.supylabel("tyre friction [1]", fontsize=9.5)
    return image
