"""Turn: speed x tail mode x tail speed (thesis Figures 7.8 and 7.10 to 7.13)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_report import (
    Findings,
    Step,
    band,
    by_value,
    ran,
    steps_of_members,
    survived_share,
    tipped,
    weights_of,
)
from aerodima.optimisation.sweep.rollover_threshold import SPEED
from aerodima.optimisation.sweep.study import Block, Range, Study, Value
from aerodima.workbench.config.ensemble import weighted_quantiles
from aerodima.workbench.figures.figure_style import FLIPPED_MARKER, GREY, MODE_STYLES, new_figure, styled
from aerodima.workbench.metrics.published_values import published_values
from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.report.report_page import Plot, zoomable

TAIL_SPEED = "controller.swing_speed"

TAILLESS_SPEEDS = tuple(whole / KM_PER_H for whole in range(2, 22))
TAILED_SPEEDS = tuple(whole / KM_PER_H for whole in range(12, 18))
"""m/s; the thesis stepped the speed in whole km/h (ERRATA E37), from 0.56 m/s without tail, to 4.72 with."""
TAIL_SPEEDS = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""rad/s, as in thesis 7.1.2; the published swing has 8."""

TIPPED_MARKER = "_"
"""Of a run that tipped over before its turn: it says nothing about the turn."""

PANELS = (
    ("max_yaw_rate_rad_per_s", "largest yaw rate, rad/s"),
    ("max_linear_acceleration_m_per_s2", "largest lateral acceleration, m/s²"),
    ("max_kohut_deg_m_per_s2", "largest Kohut figure, deg m/s²"),
    ("peak_roll_rad", "largest roll outwards, rad"),
)


def turn_study(settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None) -> Study:
    """20 runs without tail, 6 with the tail held, 42 in which it swings."""

    def block(mode: str, speeds: Sequence[float], more: dict[str, list[Value] | Range] | None = None) -> Block:
        return Block(
            name=mode, scenario=f"turn_{mode}", settings=tuple(settings), grid={SPEED: list(speeds), **(more or {})}
        )

    blocks = (
        block("none", TAILLESS_SPEEDS),
        block("held", TAILED_SPEEDS),
        block("swing", TAILED_SPEEDS, {TAIL_SPEED: list(TAIL_SPEEDS)}),
    )
    name = "Turn: speed, tail mode and tail speed"
    return Study(name=name, ensemble=ensemble, members=members, blocks=blocks)


def read_turn(frame: pd.DataFrame) -> Findings:
    """Threshold of the speed for every tail mode and tail speed, with islands and the band of an ensemble.

    A member that flips at every speed counts as 0 m/s, one that never flips as the fastest speed it survived; both are
    counted in `outside_the_range`.
    """
    rows = []
    for mode, tail_speed, part in _cases(frame):
        steps, weights = steps_of_members(part, SPEED)
        survived = [_highest_survived(step) for step in steps]
        low, middle, high = weighted_quantiles(survived, weights)
        rows.append(
            {
                "tail_mode": mode,
                "tail_speed_rad_per_s": tail_speed,
                "highest_speed_before_first_flip_m_per_s": float(middle),
                "low_5_percent": float(low),
                "high_95_percent": float(high),
                "step": steps[0].words if len(steps) == 1 else "",
                "members_with_islands": sum(bool(step.islands) for step in steps),
                "outside_the_range": sum(step.survived is None or step.flipped is None for step in steps),
                "members": len(steps),
                "survived_share": survived_share(part),
            }
        )
    pictures = (
        Plot(
            _survival_figure(frame),
            "Outcome of every speed: open marker survived, cross flipped in the turn, bar tipped over before it; over "
            "an ensemble the share that survived.",
            "Outcome over speed for each tail mode and tail speed",
            "survival",
        ),
        zoomable(
            _metrics_figure(frame),
            "Metrics over the speed at the start of the turn, raw signals. Line: tail speed of 8 rad/s where the tail "
            "swings; the other tail speeds are the small marks. Crosses: runs that flipped. Stars: published "
            "(Tables 7.1 and 7.2, simulated). Band: 5 to 95 % of an ensemble.",
            "Four metrics over speed for each tail mode",
            "metrics",
        ),
    )
    return Findings(
        rows, _sentences(frame), pictures, ("block", SPEED, TAIL_SPEED, "outcome", "clean", "peak_roll_rad")
    )


def _highest_survived(step: Step) -> float:
    if step.survived is not None:
        return step.survived
    return np.nan if step.flipped is None else 0.0


def _sentences(frame: pd.DataFrame) -> tuple[str, ...]:
    base = ran(frame[frame["block"] == "none"])
    turned = base[base["outcome"] == "survived"]
    most = float(turned["heading_change_rad"].max()) if len(turned) else float("nan")
    tailed = ran(frame[(frame["block"] != "none") & (frame["outcome"] == "survived")])
    enough = int((tailed["heading_change_rad"] >= LEAST_HEADING * most).sum())
    return (
        f"Without tail {len(turned)} of {len(base)} runs survived, with tail {len(tailed)} of "
        f"{int((frame['block'] != 'none').sum())}.",
        f"The largest heading change of a surviving run without tail is {most:.2f} rad; {enough} of the {len(tailed)} "
        "surviving tailed runs reach 95 % of it. A faster turn is only one that also turns as far.",
    )


def _cases(frame: pd.DataFrame) -> list[tuple[str, float | None, pd.DataFrame]]:
    cases: list[tuple[str, float | None, pd.DataFrame]] = []
    for mode in MODE_STYLES:
        part = frame[frame["block"] == mode]
        if mode == "swing":
            cases += [(mode, speed, rows) for speed, rows in by_value(part, TAIL_SPEED)]
        elif len(part):
            cases.append((mode, None, part))
    return cases


def _survival_figure(frame: pd.DataFrame) -> Figure:
    cases = _cases(frame)
    with styled():
        figure, axes = new_figure(7.2, 0.42 * len(cases) + 1.6)
        ax: Axes = axes[0, 0]
        for level, (mode, _, part) in enumerate(cases):
            style = MODE_STYLES[mode]
            for speed, rows in by_value(ran(part), SPEED):
                share = survived_share(rows)
                over = float(np.average(tipped(rows), weights=weights_of(rows))) >= 0.5
                marker = TIPPED_MARKER if over else style.marker if share >= 0.5 else FLIPPED_MARKER
                face = "white" if share >= 0.5 else GREY
                ax.plot(speed, level, marker, color=style.colour, markerfacecolor=face, markersize=8)
                if 0.0 < share < 1.0:
                    ax.annotate(f"{share:.0%}", (speed, level + 0.28), fontsize=6.5, ha="center")
        words = [MODE_STYLES[m].words + (f", {s:g} rad/s" if s is not None else "") for m, s, _ in cases]
        ax.set_yticks(range(len(cases)), words)
        ax.set(
            xlabel="commanded speed, m/s", title="Survived (open) and flipped (cross)", ylim=(-0.6, len(cases) - 0.3)
        )
    return figure


def _metrics_figure(frame: pd.DataFrame) -> Figure:
    with styled():
        figure, axes = new_figure(9.6, 6.4, 2, 2)
        for ax, (column, label) in zip(axes.flat, PANELS, strict=True):
            for mode in MODE_STYLES:
                _draw_mode(ax, ran(frame[(frame["block"] == mode) & ~tipped(frame)]), mode, column)
            _draw_published(ax, column)
            ax.set(xlabel="commanded speed, m/s", ylabel=label)
        axes[0, 0].legend(loc="best")
        axes[1, 1].set_ylim(0.0, 1.6)
    return figure


def _draw_mode(ax: Axes, part: pd.DataFrame, mode: str, column: str) -> None:
    if part.empty:
        return
    style = MODE_STYLES[mode]
    main = part[part[TAIL_SPEED] == 8.0] if mode == "swing" else part
    if mode == "swing":
        others = part[(part[TAIL_SPEED] != 8.0) & (part["outcome"] == "survived")]
        ax.plot(others[SPEED], others[column], style.marker, color=style.colour, markersize=3, alpha=0.5)
    kept = [(speed, rows) for speed, rows in by_value(main, SPEED) if survived_share(rows) >= 0.5]
    if kept:
        low, middle, high = np.array([band(rows[rows["outcome"] == "survived"], column) for _, rows in kept]).T
        speeds = [speed for speed, _ in kept]
        ax.fill_between(speeds, low, high, color=style.colour, alpha=0.15, linewidth=0)
        ax.plot(speeds, middle, marker=style.marker, color=style.colour, linestyle=style.line, label=style.words)
    flipped = [(speed, band(rows, column)[1]) for speed, rows in by_value(main, SPEED) if survived_share(rows) < 0.5]
    if flipped:
        ax.plot(*zip(*flipped, strict=True), FLIPPED_MARKER, color=style.colour, markersize=7)


def _draw_published(ax: Axes, column: str) -> None:
    for row in published_values():
        value: Any = getattr(row.metrics, column, None)
        if row.platform == "simulated" and value is not None:
            colour = MODE_STYLES["none" if row.configuration == "tailless" else "swing"].colour
            ax.plot(row.metrics.speed_m_per_s, value, "*", color=colour, markersize=11, markeredgecolor="white")
