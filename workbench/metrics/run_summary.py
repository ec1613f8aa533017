"""What a table or a plot over many runs needs of each run, and the table of a demo with the published figures beside.

Everything comes from the run log. `RunSummary` is small and pickles, so a worker process can send it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.ensemble import BUILT
from aerodima.workbench.controllers.law_of_scenario import NO_SWING
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import Platform, PublishedValues, TurnMetrics, published_values
from aerodima.workbench.metrics.tail_impulses import Impulses, tail_impulses
from aerodima.workbench.metrics.turn_metrics import (
    RunMetrics,
    metrics_of,
)
from aerodima.workbench.metrics.turn_signals import turn_window

KM_PER_H = 3.6
"""km/h per m/s."""

PUBLISHED_RUNS: dict[tuple[str, int], tuple[tuple[Platform, str], ...]] = {
    ("none", 12): (("simulated", "tailless"), ("physical", "tailless")),
    ("swing", 16): (("simulated", "tailed"),),
}
"""(tail mode, commanded speed in whole km/h) -> published rows made so. The thesis stepped the speed in whole km/h
(ERRATA E37); its tailed car swung the tail. The physical tailed row (6.10 m/s) is faster than any run of the demo."""


@dataclass(frozen=True)
class RunSummary:
    """One run in numbers.

    Attributes:
        name: of the log, without its ending.
        tail_mode: see `tail_mode_of`.
        commanded_speed: m/s.
        metrics: outcome and metrics.
        window: start and end of the turn, s.
        over_window: impulses of the tail over the window; None without tail or without its ground truth.
        until_peak_roll: the same from the start of the turn to the largest roll.
        trigger_time: when the controller began to swing, s; None when it never did.
        swing_end_time: when the swing was over, s; None when it was not within the run.
        peak_gyro: largest yaw rate into the turn that the IMU reported in the window, rad/s.
    """

    name: str
    tail_mode: str
    commanded_speed: float
    metrics: RunMetrics
    window: tuple[float, float]
    over_window: Impulses | None
    until_peak_roll: Impulses | None
    trigger_time: float | None
    swing_end_time: float | None
    peak_gyro: float

    @property
    def survived(self) -> bool:
        """Whether the car stayed on its wheels."""
        return self.metrics.outcome.result == "survived"

    @property
    def clean(self) -> bool:
        """Survived, and nothing but the wheels touched the ground."""
        return bool(self.metrics.outcome.clean)


def tail_mode_of(scenario: Mapping[str, Any]) -> str:
    """What the tail does in a resolved scenario: `none`, `held`, `swing`, or a swing that is not the published one.

    Those are `optimised`, played from a file, and `designed`, the published motion of another tail than the built one.
    """
    tail = scenario["tail"]
    if tail["mode"] != "swing":
        return str(tail["mode"])
    if scenario.get("controller", {}).get("swing_file", NO_SWING) != NO_SWING:
        return "optimised"
    return "swing" if tail.get("name", BUILT) == BUILT else "designed"


def summarise(run_log: RunLog, name: str) -> RunSummary:
    """Measures a run of a turn; LogError as for `metrics_of`."""
    impulses = tail_impulses(run_log) if "tail_com_x_truth_m" in run_log.table.columns else None
    window = turn_window(run_log)
    swinging = run_log.time[run_log.signal("controller_state") == SwingState.SWING]
    side = -1.0 if run_log.scenario["manoeuvre"]["direction"] == "right" else 1.0
    in_window = (run_log.time >= window[0]) & (run_log.time <= window[1])
    ended = swinging.size > 0 and swinging[-1] < run_log.time[-1]
    return RunSummary(
        name=name,
        tail_mode=tail_mode_of(run_log.scenario),
        commanded_speed=float(run_log.scenario["manoeuvre"]["speed"]),
        metrics=metrics_of(run_log),
        window=window,
        over_window=None if impulses is None else impulses.over_window,
        until_peak_roll=None if impulses is None else impulses.until_peak_roll,
        trigger_time=float(swinging[0]) if swinging.size else None,
        swing_end_time=float(swinging[-1]) if ended else None,
        peak_gyro=float(np.max(side * run_log.signal("imu_gyro_z_rad_per_s")[in_window])),
    )


def published_for(summary: RunSummary) -> dict[Platform, PublishedValues]:
    """Published rows that were made as this run was, by platform."""
    kilometres_per_hour = KM_PER_H * summary.commanded_speed
    whole = round(kilometres_per_hour)
    if not math.isclose(kilometres_per_hour, whole, abs_tol=0.02):
        return {}
    wanted = PUBLISHED_RUNS.get((summary.tail_mode, whole), ())
    rows = {(row.platform, row.configuration): row for row in published_values()}
    return {platform: rows[platform, configuration] for platform, configuration in wanted}


def summary_row(summary: RunSummary) -> dict[str, Any]:
    """One flat row: the run, its metrics, and where they exist the published figures and the differences to them.

    A difference is the metric, from the signals of that platform (`published_values.SIGNALS`), less the published
    figure. Units are at the end of the names.
    """
    metrics = summary.metrics
    row: dict[str, Any] = {
        "run": summary.name,
        "tail_mode": summary.tail_mode,
        "commanded_speed_m_per_s": summary.commanded_speed,
        "commanded_speed_km_per_h": KM_PER_H * summary.commanded_speed,
        **metrics.as_row(),
        "swing_trigger_time_s": summary.trigger_time,
        "swing_end_time_s": summary.swing_end_time,
        "imu_peak_yaw_rate_rad_per_s": summary.peak_gyro,
    }
    for label, impulses in (("window", summary.over_window), ("until_peak_roll", summary.until_peak_roll)):
        for cause in ("aerodynamic", "weight", "inertial"):
            value = None if impulses is None else getattr(impulses, cause)
            row[f"{cause}_impulse_{label}_n_m_s"] = value
    published = published_for(summary)
    platforms: tuple[Platform, ...] = ("simulated", "physical")
    for platform in platforms:
        found = published.get(platform)
        row[f"published_{platform}_source"] = None if found is None else found.source
        for field in fields(TurnMetrics):
            figure = None if found is None else getattr(found.metrics, field.name)
            ours = getattr(metrics.like(platform), field.name)
            row[f"published_{platform}_{field.name}"] = figure
            row[f"difference_{platform}_{field.name}"] = None if figure is None else ours - figure
    return row


def write_summary(summaries: Sequence[RunSummary], path: Path, *, force: bool = False) -> Path:
    """Writes `summary_row` of each run as CSV: empty cells where there is no number, floats in full precision."""
    rows = [{name: _cell(value) for name, value in summary_row(summary).items()} for summary in summaries]
    return write_atomically(path, pd.DataFrame(rows).to_csv(index=False), force, UserError)


def _cell(value: Any) -> Any:
    return str(value).lower() if isinstance(value, bool) else value
