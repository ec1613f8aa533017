"""An engine whose cars follow a formula, so that the truth of a calibration is known and a run costs nothing."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from aerodima.optimisation.calibration.calibration_plan import prior_ranges
from aerodima.workbench.batch.engine import Engine

TAILLESS_GROUP = 1.05
"""Friction x height / half track at which the made-up car flips at 3.47 m/s."""

YAW_LOSS = 0.55
"""Share of the yaw rate that the widest sail of the prior takes away."""
SAIL_WIDTHS = prior_ranges(("tail.sail_width",))[0]


def half_track(value: Mapping[str, float]) -> float:
    """To the outer edge of a cylindrical tyre, m."""
    return 0.5 * (value["car.track"] + value["car.tyre_width"])


class MadeUpEngine(Engine):
    """Rows by formula: flips beyond a group that falls with the speed, and rises with the width of a swinging sail."""

    def __init__(self, stop_after: int | None = None, tail_limit: float = 0.1) -> None:
        self.runs = 0
        self.stop_after = stop_after
        self.tail_limit = tail_limit

    def map(self, work: Any, tasks: Sequence[Any], done: Any = None, lost: Any = None) -> list[Any]:
        found = []
        for place, task in enumerate(tasks):
            if self.stop_after is not None and self.runs >= self.stop_after:
                raise KeyboardInterrupt
            self.runs += 1
            found.append(self.row(task))
            if done is not None:
                done(place, found[-1])
        return found

    def row(self, task: Any) -> dict:
        value = {key: float(text) for key, text in (setting.split("=") for setting in task.settings)}
        friction, speed = value["car.tyre_friction"], value["manoeuvre.speed"]
        group = friction * value["car.com_height"] / half_track(value)
        limit = TAILLESS_GROUP - 0.1 * (speed - 3.47)
        if task.scenario == "turn_swing":
            low, high = SAIL_WIDTHS
            share = (value["tail.sail_width"] - low) / (high - low)
            limit = TAILLESS_GROUP + self.tail_limit * (share - 0.5) - 0.3 * (speed - 4.58)
        flipped = group > limit
        margin = abs(group - limit)
        yaw, acceleration = 1.5 + 1.8 * (friction - 0.6), 9.81 * friction
        if task.scenario == "turn_swing":
            yaw, acceleration = yaw * (1.0 - YAW_LOSS * share), acceleration * value["tail.mass"] ** 0.1
        metrics = {
            "speed_m_per_s": speed,
            "max_yaw_rate_rad_per_s": 1.6 * yaw,
            "average_yaw_rate_rad_per_s": yaw,
            "max_linear_acceleration_m_per_s2": acceleration,
            "average_linear_acceleration_m_per_s2": 0.7 * acceleration,
            "max_kohut_deg_m_per_s2": 57.3 * speed * 1.6 * yaw,
            "average_kohut_deg_m_per_s2": 57.3 * speed * yaw,
            "roll_integral_rad": 0.1 + value["car.mass"] * 0.02,
            "speed_in_turn_m_per_s": speed * (1.0 - 0.1 * friction),
            "lift_yaw_rate_rad_per_s": 1.0 + 0.2 * (friction - 0.6),
        }
        peak_roll = max(0.02, 0.6 - 5.5 * margin**0.5)
        flip_time = 2.5 - (3.0 + math.log(max(margin, 1e-4))) / 3.5
        return {
            "run": task.name,
            "outcome": "flipped" if flipped else "survived",
            "commanded_speed_m_per_s": speed,
            "error": "",
            "peak_roll_rad": 1.6 if flipped else peak_roll,
            "stopped_at_flip_s": max(2.65, flip_time) if flipped else None,
            **metrics,
            **{f"filtered_{name}": figure for name, figure in metrics.items()},
        }
