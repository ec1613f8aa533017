"""Cars, tails and controllers compared by the grip that they survive at one speed (design section 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_reading import band, ran, steps_of_members
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study import Block, Range, Study
from aerodima.workbench.config.ensemble import weighted_quantiles
from aerodima.workbench.figures.figure_style import BLACK, BLUE, VERMILION, new_figure, styled
from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.report.report_page import Plot

CASE_SPEED = 16 / KM_PER_H
"""m/s; the published tailed car survived it (section 7.1.2)."""
FRICTIONS = Range(first=0.5, last=0.95, number=10)
REFERENCE_FRICTION = 0.6
"""Where heading changes are compared: of `FRICTIONS` the nearest to `models/parameters`; most cases survive there."""


@dataclass(frozen=True)
class Setup:
    """One case: scenario and overrides; `reference` ones are drawn apart."""

    scenario: str
    settings: tuple[str, ...] = ()
    reference: bool = False


def friction_study(
    name: str,
    setups: Mapping[str, Setup],
    settings: Sequence[str],
    ensemble: str | None,
    members: int | None,
    frictions: Range = FRICTIONS,
) -> Study:
    """Every case at every friction, at `CASE_SPEED` unless `settings` say otherwise."""
    speed = f"{SPEED}={CASE_SPEED!r}"
    blocks = tuple(
        Block(
            name=label,
            scenario=setup.scenario,
            settings=(speed, *settings, *setup.settings),
            grid={FRICTION: frictions},
        )
        for label, setup in setups.items()
    )
    return Study(name=name, ensemble=ensemble, members=members, blocks=blocks)


def friction_rows(frame: pd.DataFrame, setups: Mapping[str, Setup]) -> list[dict[str, Any]]:
    """Critical friction of each case with the band of an ensemble, islands, and the heading change beside."""
    low, high = float(frame[FRICTION].min()), float(frame[FRICTION].max())
    rows = []
    for label in setups:
        part = frame[frame["block"] == label]
        steps, weights = steps_of_members(part, FRICTION)
        middles = [step.middle(low, high) for step in steps]
        five, median, ninety_five = weighted_quantiles(middles, weights, (0.05, 0.5, 0.95))
        upright = ran(part)[(ran(part)[FRICTION] - REFERENCE_FRICTION).abs() < 1e-9]
        upright = upright[upright["outcome"] == "survived"]
        rows.append(
            {
                "case": label,
                "critical_friction": float(median),
                "low_5_percent": float(five),
                "high_95_percent": float(ninety_five),
                "outside_the_range": sum(step.survived is None or step.flipped is None for step in steps),
                "without_a_result": int(np.count_nonzero(np.isnan(middles))),
                "step": steps[0].words if len(steps) == 1 else "",
                "members_with_islands": sum(bool(step.islands) for step in steps),
                "heading_change_rad": band(upright, "heading_change_rad")[1] if len(upright) else None,
                "peak_roll_rad": band(upright, "peak_roll_rad")[1] if len(upright) else None,
            }
        )
    return rows


def read_friction(
    frame: pd.DataFrame, setups: Mapping[str, Setup], sentences: Sequence[str], more: Sequence[Plot] = ()
) -> Findings:
    """The cases in order of their critical friction, and the plot."""
    rows = friction_rows(frame, setups)
    best = max(rows, key=lambda row: -np.inf if np.isnan(row["critical_friction"]) else row["critical_friction"])
    step = float(np.diff(np.unique(frame[FRICTION]))[0]) if frame[FRICTION].nunique() > 1 else float("nan")
    said = (
        f"The highest critical friction has {best['case']!r}: {best['critical_friction']:.3f}; the grid resolves "
        f"{step:.2f}, so differences below that are none.",
        "The critical friction is the middle between the last friction survived and the first flip; a value at the end "
        "of the range is only a bound (column outside_the_range). Cars whose runs failed or tipped over before their "
        "turn up to the end of the range are left out (column without_a_result).",
        f"Heading change and peak roll are those at a friction of {REFERENCE_FRICTION:g}, where survived. A car that "
        "turns less far survives more easily.",
        *sentences,
    )
    picture = Plot(
        friction_figure(frame, setups, rows),
        "Critical friction of each case. Bar: from the last friction survived to the first flip, over an ensemble 5 to "
        "95 %. Small crosses: frictions beyond the first flip that are survived again (islands).",
        "Critical friction of each case",
        "critical_friction",
    )
    columns = ("block", FRICTION, "outcome", "clean", "heading_change_rad", "peak_roll_rad", "swing_trigger_time_s")
    return Findings(rows, said, (picture, *more), columns)


def friction_figure(frame: pd.DataFrame, setups: Mapping[str, Setup], rows: Sequence[Mapping[str, Any]]) -> Figure:
    """One line per case, references in black and blue."""
    with styled():
        figure, axes = new_figure(7.6, 0.32 * len(rows) + 1.2)
        ax = axes[0, 0]
        for level, row in enumerate(rows):
            setup = setups[row["case"]]
            colour = (BLACK if "none" in setup.scenario else BLUE) if setup.reference else VERMILION
            steps, _ = steps_of_members(frame[frame["block"] == row["case"]], FRICTION)
            ends = (row["low_5_percent"], row["high_95_percent"])
            if len(steps) == 1:
                low, high = float(frame[FRICTION].min()), float(frame[FRICTION].max())
                ends = (steps[0].survived or low, steps[0].flipped or high)
                ax.plot(steps[0].islands, [level] * len(steps[0].islands), "x", color=colour, markersize=5)
            ax.plot(ends, [level, level], color=colour, linewidth=4, alpha=0.4, solid_capstyle="butt")
            ax.plot(row["critical_friction"], level, "o", color=colour, markersize=6)
        ax.set_yticks(range(len(rows)), [row["case"] for row in rows])
        ax.invert_yaxis()
        ax.set(xlabel="tyre friction", title="Critical friction")
    return figure
