"""Claims of the thesis that follow from its own printed numbers."""

import math
from dataclasses import fields

from aerodima.workbench.metrics.published_values import TurnMetrics, flip_bracket, published_values
from aerodima.workbench.view.demo import DemoPlan
from tests.built.registry import check


@check
def speeds_of_the_demo_in_whole_km_per_h():
    return all(
        math.isclose(3.6 * speed, round(3.6 * speed), abs_tol=1e-9) for _, speed in DemoPlan().turns
    )


def physical(configuration):
    return next(
        r.metrics
        for r in published_values()
        if (r.platform, r.configuration) == ("physical", configuration)
    )


@check
def gain_of_speed():
    return 100.0 * (physical("tailed").speed_m_per_s / physical("tailless").speed_m_per_s - 1.0)


@check
def loss_of_roll_integral():
    return 100.0 * (
        1.0 - physical("tailed").roll_integral_rad / physical("tailless").roll_integral_rad
    )


@check
def gain_of_kohut():
    slow = physical("tailless")
    fast = physical("tailed")
    return 100.0 * (fast.max_kohut_deg_m_per_s2 / slow.max_kohut_deg_m_per_s2 - 1.0)


@check
def simulated_gain_of_speed():
    return 100.0 * (flip_bracket("tailed").flipped / flip_bracket("tailless").flipped - 1.0)


@check
def metrics_that_improve():
    """Of the eight, between the best physical runs: larger is better but for the roll integral
    (ERRATA E34).
    """
    slow = physical("tailless")
    fast = physical("tailed")
    pairs = [
        (field.name, getattr(slow, field.name), getattr(fast, field.name))
        for field in fields(TurnMetrics)
    ]
    return float(
        sum(
            (after < before) if name.startswith("roll") else (after > before)
            for name, before, after in pairs
        )
    )


@check
def largest_error_of_kohut():
    """Of the printed Kohut figures against speed x yaw rate in degrees, largest relative
    difference.
    """
    worst = 0.0
    for row in published_values():
        for kind in ("max", "average"):
            printed = getattr(row.metrics, f"{kind}_kohut_deg_m_per_s2")
            product = row.metrics.speed_m_per_s * math.degrees(
                getattr(row.metrics, f"{kind}_yaw_rate_rad_per_s")
            )
            worst = max(worst, abs(product / printed - 1.0))
    return worst


@check
def recorded_tailed_turns():
    """From 35 to 50 % in steps of 5 %."""
    return float(len(range(35, 51, 5)))


@check
def names_of_the_metrics():
    return float(len(fields(TurnMetrics)))
