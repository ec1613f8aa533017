"""Where a car stays on its wheels: over speed x friction with the islands, and under uncertainty (Monte Carlo)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_report import (
    Findings,
    by_value,
    make_report,
    ran,
    rollover_probability,
    step_along,
    survived_share,
)
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study import Block, Normal, Range, Sample, Study, Uniform
from aerodima.optimisation.sweep.study_engine import RunEngine
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.figures.figure_style import FLIPPED_MARKER, GREY, MODE_STYLES, new_figure, styled
from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.report.report_page import Plot

SURVIVED_COLOURS = "cividis"


def survival_study(scenario: str | Path, settings: Sequence[str], speeds: Range, frictions: Range) -> Study:
    """Every speed with every friction."""
    block = Block(scenario=str(scenario), settings=tuple(settings), grid={SPEED: speeds, FRICTION: frictions})
    return Study(name=f"Survival over speed and friction: {Path(scenario).stem}", blocks=(block,))


def write_survival(
    study: Study, out: Path, engine: RunEngine, force: bool = False, progress: ProgressLine = silent
) -> Path:
    """Runs it and writes its page; the path of the page."""
    return make_report(study, read_survival, out, engine, force=force, progress=progress)


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


FACTORS: dict[str, Uniform | Normal] = {
    FRICTION: Normal(mean=0.62, deviation=0.05),
    SPEED: Normal(mean=14 / KM_PER_H, deviation=0.15),
    "imu.gyro_noise": Uniform(low=0.001, high=0.02),
    "imu.gyro_bias": Uniform(low=0.0, high=0.05),
}
"""Grip that differs from floor to floor, a speed that differs from run to run, and the priors of the gyro."""


TAIL_MODES = ("none", "held", "swing")
"""Compared with each other; each has a scenario of its name."""


def monte_carlo_study(
    samples: int, seed: int, settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None
) -> Study:
    """The same samples for no tail, tail held and tail swung."""
    sample = Sample(method="sobol", number=samples, seed=seed, factors=dict(FACTORS), new_seeds=True)
    blocks = tuple(
        Block(name=mode, scenario=f"turn_{mode}", settings=tuple(settings), sample=sample) for mode in TAIL_MODES
    )
    name = "Monte Carlo: rollover under uncertain friction, speed and trigger"
    return Study(name=name, ensemble=ensemble, members=members, blocks=blocks)


def read_monte_carlo(frame: pd.DataFrame) -> Findings:
    """Probability with its interval for each tail mode."""
    rows: list[dict[str, Any]] = []
    for mode in TAIL_MODES:
        found = rollover_probability(frame[frame["block"] == mode])
        rows.append(
            {
                "tail_mode": mode,
                "rollover_probability": found.value,
                "low_95_percent": found.low,
                "high_95_percent": found.high,
                "runs": found.runs,
                "effective_runs": found.effective,
            }
        )
    picture = Plot(
        _figure(frame, rows),
        "Left: probability with its 95 % interval. Beside: the samples of each tail mode over speed and friction; open "
        "marks survived, crosses flipped.",
        "Rollover probability of each tail mode, and the samples",
        "rollover",
    )
    said = tuple(
        f"{MODE_STYLES[row['tail_mode']].words}: {row['rollover_probability']:.0%} "
        f"[{row['low_95_percent']:.0%}, {row['high_95_percent']:.0%}] of {row['runs']} runs roll over."
        for row in rows
    )
    note = (
        "The interval counts the samples as independent; those of Sobol's sequence fill the space more evenly than "
        "that, so it is on the safe side. The members of an ensemble share samples: there the effective number counts."
    )
    columns = ("block", FRICTION, SPEED, "outcome", "clean", "swing_trigger_time_s", "peak_roll_rad")
    return Findings(rows, (*said, note), (picture,), columns)


def _figure(frame: pd.DataFrame, rows: Sequence[dict[str, Any]]) -> Figure:
    with styled():
        figure, axes = new_figure(11.0, 3.6, 1, 1 + len(rows))
        left, samples = axes[0, 0], axes[0, 1:]
        for place, (row, ax) in enumerate(zip(rows, samples, strict=True)):
            style = MODE_STYLES[row["tail_mode"]]
            value = row["rollover_probability"]
            errors = np.array([[max(0.0, value - row["low_95_percent"])], [max(0.0, row["high_95_percent"] - value)]])
            left.errorbar(place, value, errors, fmt=style.marker, color=style.colour, capsize=6, markersize=8)
            part = ran(frame[frame["block"] == row["tail_mode"]])
            for outcome, marker, face in (
                ("survived", style.marker, "none"),
                ("flipped", FLIPPED_MARKER, style.colour),
            ):
                shown = part[part["outcome"] == outcome]
                ax.plot(shown[SPEED], shown[FRICTION], marker, color=style.colour, markersize=5, markerfacecolor=face)
            ax.set(xlabel="speed, m/s", title=style.words)
            ax.sharex(samples[0])
            ax.sharey(samples[0])
        samples[0].set_ylabel("tyre friction")
        left.set_xticks(range(len(rows)), [MODE_STYLES[row["tail_mode"]].words.replace(" ", "\n") for row in rows])
        left.set(ylabel="rollover probability", ylim=(-0.05, 1.05), xlim=(-0.5, len(rows) - 0.5), title="Rollover")
    return figure
