"""Names, units and numbers as the report prints them."""

import math
from collections.abc import Sequence


def metric_name(metric: str) -> str:
    """`max_yaw_rate_rad_per_s` -> `largest yaw rate`."""
    return {
        "speed_m_per_s": "speed at the start of the turn",
        "max_yaw_rate_rad_per_s": "largest yaw rate",
        "average_yaw_rate_rad_per_s": "mean yaw rate",
        "max_linear_acceleration_m_per_s2": "largest lateral acceleration",
        "average_linear_acceleration_m_per_s2": "mean lateral acceleration",
        "max_kohut_deg_m_per_s2": "largest Kohut",
        "average_kohut_deg_m_per_s2": "mean Kohut",
        "roll_integral_rad": "roll integral",
        "speed_in_turn_m_per_s": "speed in the turn",
        "lift_yaw_rate_rad_per_s": "yaw rate at which an inner wheel lifts",
        "integral_of_roll_rate_as_printed": "sum of roll-rate samples as printed",
    }[metric]


def metric_unit(metric: str) -> str:
    """Unit of a metric as it is printed."""
    endings = (("rad_per_s", "rad/s"), ("m_per_s2", "m/s²"), ("m_per_s", "m/s"), ("_rad", "rad"), ("printed", "rad/s"))
    if "kohut" in metric:
        return "deg m/s²"
    return next(unit for ending, unit in endings if metric.endswith(ending))


def percent(ratio: float) -> str:
    """+12 %."""
    return f"{100 * ratio:+.0f} %"


def degrees(angle: float) -> str:
    """An angle in rad as degrees."""
    return f"{math.degrees(angle):.1f}°"


def span(values: Sequence[float]) -> str:
    """`0.12`, or `-0.10 to 0.30` where they differ in what is printed."""
    low, high = (f"{value:.2f}".replace("-0.00", "0.00") for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
