"""Survival over speed x friction: where a car stays on its wheels, with the islands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.study_reading import by_value, ran, step_along, survived_share
from aerodima.optimisation.studies.study_report import Findings, make_report
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.run_study import Say
from aerodima.optimisation.sweep.study import Block, Range, Study
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.workbench.figures.figure_style import GREY, new_figure, styled
from aerodima.workbench.report.report_page import Plot

SURVIVED_COLOURS = "cividis"


def survival_study(scenario: str, settings: Sequence[str], speeds: Range, frictions: Range) -> Study:
    """Every speed with every friction."""
    block = Block(scenario=scenario, settings=tuple(settings), grid={SPEED: speeds, FRICTION: frictions})
    return Study(name=f"Survival over speed and friction: {Path(scenario).stem}", blocks=(block,))


def write_survival(study: Study, out: Path, engine: Engine, force: bool = False, say: Say | None = None) -> Path:
    """Runs it and writes its page; the path of the page."""
    return make_report(study, read_survival, out, engine, force=force, say=say)


def read_survival(frame: pd.DataFrame) -> Findings:
    """Threshold of the friction at each speed, and of the speed at each friction."""
    rows: list[dict[str, Any]] = []
    for factor, other in ((SPEED, FRICTION), (FRICTION, SPEED)):
        for value, part in by_value(frame, factor):
            step = step_along(part, other)
            rows.append(
                {
                    "at": factor,
                    "value": value,
                    "of": other,
                    "survived": step.survived,
                    "first_flipped": step.flipped,
                    "survives_again_at": " ".join(f"{island:g}" for island in step.islands),
                }
            )
    islands = sum(1 for row in rows if row["survives_again_at"])
    clean = int((ran(frame)["clean"] == True).sum())  # noqa: E712  # a column with missing values
    sentences = (
        f"{int((frame['outcome'] == 'survived').sum())} of {len(ran(frame))} runs survived, {clean} of them clean.",
        f"{islands} of {len(rows)} rows and columns have survivors beyond their first flip: survival is not monotone."
        if islands
        else "No row or column has survivors beyond its first flip on this grid; between its lines there may be some.",
    )
    picture = Plot(
        survival_figure(frame),
        "Survived (bright) and flipped (dark) over speed and tyre friction; a dot: survived, but cage, board or tail "
        "touched the ground. Over an ensemble the share of its weight that survived.",
        "Map of survival over speed and tyre friction",
        "survival",
    )
    return Findings(rows, sentences, (picture,), (SPEED, FRICTION, "outcome", "clean", "peak_roll_rad"))


def survival_figure(frame: pd.DataFrame) -> Any:
    """Map of the survived share."""
    shares = pd.Series({key: survived_share(part) for key, part in frame.groupby([FRICTION, SPEED])}).unstack()
    with styled():
        figure, axes = new_figure(7.2, 4.6)
        ax = axes[0, 0]
        speeds, frictions = shares.columns.to_numpy(float), shares.index.to_numpy(float)
        mesh = ax.pcolormesh(
            _edges(speeds), _edges(frictions), shares.to_numpy(float), cmap=SURVIVED_COLOURS, vmin=0.0, vmax=1.0
        )
        touched = frame[(frame["outcome"] == "survived") & ~frame["clean"].fillna(True).astype(bool)]
        ax.plot(touched[SPEED], touched[FRICTION], ".", color=GREY, markersize=5)
        ax.set(xlabel="speed, m/s", ylabel="tyre friction", title="Survived share")
        ax.grid(False)
        figure.colorbar(mesh, ax=ax, ticks=[0.0, 0.5, 1.0]).ax.set_yticklabels(["flipped", "half", "survived"])
    return figure


def _edges(values: np.ndarray) -> np.ndarray:
    """Edges of the cells around the values (n), shape (n + 1,)."""
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middles = 0.5 * (values[1:] + values[:-1])
    first, last = values[0] - (middles[0] - values[0]), values[-1] + (values[-1] - middles[-1])
    return np.concatenate([[first], middles, [last]])
