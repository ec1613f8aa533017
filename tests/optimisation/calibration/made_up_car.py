"""An engine whose cars follow a formula, so that the truth of a calibration is known and a run costs nothing."""

import math
from collections.abc import Callable, Sequence
from typing import Any

TAILLESS_GROUP = 1.05
"""Friction x height / half track at which the made-up car flips at 3.47 m/s."""


class MadeUpEngine:
    """Rows by formula: flips beyond a group that falls with the speed, and rises with the area of a swinging tail."""

    workers, startup = 1, 0.0

    def __init__(self, stop_after: int | None = None, tail_limit: float = 0.6) -> None:
        self.runs = 0
        self.stop_after = stop_after
        self.tail_limit = tail_limit

    def rows(self, tasks: Sequence[Any], done: Callable[[int, dict], None] | None = None) -> list[dict]:
        found = []
        for place, task in enumerate(tasks):
            if self.stop_after is not None and self.runs >= self.stop_after:
                raise KeyboardInterrupt
            self.runs += 1
            found.append(self.row(task))
            if done is not None:
                done(place, found[-1])
        return found

    def call(self, function: Callable, items: Sequence[Any]) -> list[Any]:
        return [function(item) for item in items]

    def row(self, task: Any) -> dict:
        value = {key: float(text) for key, text in (setting.split("=") for setting in task.settings)}
        friction, track, speed = value["car.tyre_friction"], value["car.track"], value["manoeuvre.speed"]
        group = 2 * friction * value["car.com_height"] / track
        limit = TAILLESS_GROUP - 0.1 * (speed - 3.47)
        if task.scenario == "turn_swing":
            area = value["tail.sail_length"] * value["tail.sail_width"]
            limit = TAILLESS_GROUP + self.tail_limit * (area - 0.05) - 0.3 * (speed - 4.58)
        flipped = group > limit
        margin = abs(group - limit)
        yaw, acceleration = 1.5 + 1.8 * (friction - 0.6), 9.81 * friction
        metrics = {
            "speed_m_per_s": speed,
            "max_yaw_rate_rad_per_s": 1.6 * yaw,
            "average_yaw_rate_rad_per_s": yaw,
            "max_linear_acceleration_m_per_s2": acceleration,
            "average_linear_acceleration_m_per_s2": 0.7 * acceleration,
            "max_kohut_deg_m_per_s2": 57.3 * speed * 1.6 * yaw,
            "average_kohut_deg_m_per_s2": 57.3 * speed * yaw,
            "roll_integral_rad": 0.1 + value["car.mass"] * 0.02,
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
