"""The published manoeuvre values (thesis Tables 7.1-7.4) and how a run compares with them."""

from dataclasses import dataclass, fields
from typing import Any, Literal

from aerodima.workbench.core.resources import published_rows

SAMPLE_TIMES = {"simulated": 0.001, "physical": 0.01}
"""Time between the samples that the printed roll sums were made from, s: inferred, not published
(ERRATA E35)."""

Platform = Literal["simulated", "physical"]

FILTERED = "filtered_"
"""Prefix of the columns of metrics from signals like those of the physical rows; others have
none."""

_ROLL_SUM = "integral_of_roll_rate_as_printed"


@dataclass(frozen=True)
class TurnMetrics:
    """The eight metrics of a turn, under the names that the published table uses.

    Attributes:
        speed_m_per_s: speed at the start of the turn, m/s.
        max_yaw_rate_rad_per_s: largest magnitude of the yaw rate in the window, rad/s.
        average_yaw_rate_rad_per_s: signed mean of the yaw rate over the window, rad/s.
        max_linear_acceleration_m_per_s2: largest magnitude of the lateral acceleration, m/s2.
        average_linear_acceleration_m_per_s2: signed mean of the lateral acceleration, m/s2.
        max_kohut_deg_m_per_s2: speed x largest yaw rate, (deg/s)(m/s).
        average_kohut_deg_m_per_s2: speed x mean yaw rate, (deg/s)(m/s).
        roll_integral_rad: largest value over the run of the integrated body roll rate, outwards,
            rad.
    """

    speed_m_per_s: float
    max_yaw_rate_rad_per_s: float
    average_yaw_rate_rad_per_s: float
    max_linear_acceleration_m_per_s2: float
    average_linear_acceleration_m_per_s2: float
    max_kohut_deg_m_per_s2: float
    average_kohut_deg_m_per_s2: float
    roll_integral_rad: float


_DIRECT = [field.name for field in fields(TurnMetrics) if field.name != "roll_integral_rad"]
"""Metrics that are columns of the published table."""


@dataclass(frozen=True)
class PublishedValues:
    """One published row.

    Attributes:
        platform: `simulated` or `physical`.
        configuration: `tailless` or `tailed`.
        metrics: the eight metrics; the roll integral in rad is the printed sum times the inferred
            sample time.
        source: table of the thesis that holds the row.
    """

    platform: Platform
    configuration: str
    metrics: TurnMetrics
    source: str


def published_values() -> tuple[PublishedValues, ...]:
    """Returns the four published rows, as in `models/published/manoeuvre_metrics.csv`."""
    values = []
    for row in published_rows("manoeuvre_metrics"):
        platform: Any = row["platform"]
        roll_integral = float(row[_ROLL_SUM]) * SAMPLE_TIMES[platform]
        direct = {name: float(row[name]) for name in _DIRECT}
        metrics = TurnMetrics(**direct, roll_integral_rad=roll_integral)
        values.append(PublishedValues(platform, row["configuration"], metrics, row["source_table"]))
    return tuple(values)


@dataclass(frozen=True)
class FlipBracket:
    """Highest commanded speed that a simulated car of the thesis survived and the one at which it
    flipped, m/s.
    """

    survived: float
    flipped: float


def flip_bracket(configuration: Literal["tailless", "tailed"]) -> FlipBracket:
    """Returns the published bracket of the simulated car (thesis 7.1.1, 7.1.2; which speed is
    which: ERRATA E37, E38).
    """
    survived = {
        "tailless": "fastest_simulated_tailless_commanded_speed",
        "tailed": "simulated_tailed_range_high",
    }
    return FlipBracket(
        survived=_constant(survived[configuration]),
        flipped=_constant(f"simulated_{configuration}_flip_speed"),
    )


def inner_lift_yaw_rate() -> float:
    """Returns the yaw rate up to which both inner wheels of the thesis' simulated car stay on the
    ground, rad/s (thesis 6.3.4).
    """
    return _constant("tail_trigger_yaw_rate")


def _constant(name: str) -> float:
    values = {row["name"]: row["value_si"] for row in published_rows("constants")}
    return float(values[name])
