"""Rollover probability when friction, speed and the trigger's signal are uncertain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_reading import ran, rollover_probability
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study import Block, Normal, Sample, Study, Uniform
from aerodima.workbench.figures.figure_style import FLIPPED_MARKER, MODE_STYLES, new_figure, styled
from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.report.report_page import Plot

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
