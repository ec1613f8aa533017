"""Run summaries made by hand, for tests of sentences and figures."""

import math
from typing import Any

from aerodima.workbench.metrics.published_values import TurnMetrics
from aerodima.workbench.metrics.run_summary import RunSummary
from aerodima.workbench.metrics.tail_impulses import Impulses
from aerodima.workbench.metrics.turn_metrics import Outcome, RunMetrics


def made_up_summary(
    mode: str = "none",
    speed: float = 3.33,
    result: str = "survived",
    touched: tuple[str, ...] = (),
    heading: float = math.radians(60.0),
    peak_roll: float = math.radians(5.0),
    trigger: float | None = None,
    raw: dict[str, float] | None = None,
    filtered: dict[str, float] | None = None,
    impulses: Impulses | None = None,
) -> RunSummary:
    """A run in which every metric is 1 unless a test says otherwise; `speed` is commanded and
    reached.
    """
    base = dict.fromkeys(TurnMetrics.__dataclass_fields__, 1.0) | {"speed_m_per_s": speed}
    ending: Any = result
    outcome = Outcome(ending, result == "survived" and not touched, peak_roll, 0.0, 4, touched)
    metrics = RunMetrics(
        source="truth",
        direction="left",
        raw=TurnMetrics(**(base | (raw or {}))),
        filtered=TurnMetrics(**(base | (filtered or raw or {}))),
        outcome=outcome,
        peak_roll_rad=peak_roll,
        two_wheel_time_s=0.0,
        heading_change_rad=heading,
        tail_torque_peak_n_m=20.0,
        tail_energy_j=3.0,
        speed_in_turn_m_per_s=speed,
        lift_yaw_rate_rad_per_s=1.0,
    )
    own = (
        None
        if mode == "none"
        else impulses or Impulses(aerodynamic=1.0, weight=0.5, inertial=-0.25)
    )
    return RunSummary(
        name=f"{mode}_{speed:.2f}",
        tail_mode=mode,
        commanded_speed=speed,
        metrics=metrics,
        window=(2.0, 2.64),
        impulses=own,
        trigger_time=trigger,
        swing_end_time=None if trigger is None else trigger + 0.3,
        peak_gyro=0.9,
    )
