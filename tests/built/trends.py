"""The trends of thesis 7.1.3 in the runs that `models/studies/turn.yaml` has too: speed x tail
speed.
"""

from functools import cache, partial

import numpy as np

from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.scenario.scenario import load_scenario
from tests.built.registry import RUNS, SLOW, slow
from tests.built.turns import (
    ROUNDING,
    TAILED,
    TAILLESS,
    field_trial,
    run_trial,
    throttle_speed,
)

WITHOUT = tuple(
    whole / KM_PER_H for whole in range(2, 22) if whole / KM_PER_H < TAILLESS + ROUNDING
)
WITH = tuple(whole / KM_PER_H for whole in range(12, 18) if whole / KM_PER_H < TAILED + ROUNDING)
"""m/s; the thesis stepped the speed in whole km/h (ERRATA E37)."""
TAIL_SPEEDS = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""rad/s, as in thesis 7.1.2; the published swing has 8."""


@cache
def turned(tail, speed, *settings):
    """Whether it stayed upright, and the raw metrics."""
    found = run_trial(
        load_scenario(f"turn_{tail}", [f"manoeuvre.speed={speed!r}", *settings])
    ).summary
    return found.survived, found.metrics.raw


def tailless(name):
    """A metric over the speeds from 0.56 to 3.33 m/s."""
    return np.array([getattr(turned("none", speed)[1], name) for speed in WITHOUT])


def tailed(name):
    """A metric over speed (3.33 to 4.44 m/s) and tail speed, shape (5, 7); NaN where the car
    flipped.
    """
    rows = [
        [turned("swing", speed, f"controller.swing_speed={swing!r}") for swing in TAIL_SPEEDS]
        for speed in WITH
    ]
    return np.array(
        [
            [getattr(metrics, name) if upright else np.nan for upright, metrics in row]
            for row in rows
        ]
    )


def line(speeds, values):
    """Slope, offset and share of the variance that a straight line explains."""
    kept = np.isfinite(values)
    at = np.asarray(speeds)[kept]
    slope, offset = np.polyfit(at, values[kept], 1)
    left = values[kept] - (slope * at + offset)
    return float(slope), float(offset), 1.0 - float(np.var(left) / np.var(values[kept]))


@slow
def change_of_the_mean_yaw_rate():
    """Largest less smallest mean yaw rate over 0.56 to 3.33 m/s without tail, of their mean."""
    values = tailless("average_yaw_rate_rad_per_s")
    return float(np.ptp(values) / np.mean(values))


@slow
def straightness_of_the_mean_acceleration():
    """Share of the variance of the mean acceleration over speed that a line explains, no tail."""
    return line(WITHOUT, tailless("average_linear_acceleration_m_per_s2"))[2]


@slow
def slope_with_tail_over_without():
    """Slope of the mean acceleration over speed, all tail speeds together, over that without
    tail.
    """
    name = "average_linear_acceleration_m_per_s2"
    return (
        line(np.repeat(WITH, len(TAIL_SPEEDS)), tailed(name).ravel())[0]
        / line(WITHOUT, tailless(name))[0]
    )


@slow
def largest_acceleration_over_the_tailless_line():
    """Mean over all tailed runs of the largest acceleration over the line through those without
    tail.
    """
    slope, offset, _ = line(WITHOUT, tailless("max_linear_acceleration_m_per_s2"))
    expected = slope * np.array(WITH) + offset
    return float(np.nanmean(tailed("max_linear_acceleration_m_per_s2") / expected[:, np.newaxis]))


def with_over_without(name):
    """Mean over all tailed runs of a metric over its mean without tail from 2.78 to 3.33 m/s."""
    return float(np.nanmean(tailed(name)) / np.mean(tailless(name)[-3:]))


for name in ("max_yaw_rate_rad_per_s", "average_yaw_rate_rad_per_s", "roll_integral_rad"):
    RUNS[f"{name}_with_over_without"] = partial(with_over_without, name)
    SLOW.add(f"{name}_with_over_without")


def scatter(name):
    """Scatter of a metric over the tail speeds, of its mean; mean over the speeds."""
    values = tailed(name)
    return float(np.nanmean(np.nanstd(values, axis=1) / np.nanmean(values, axis=1)))


@slow
def scatter_of_acceleration_and_roll_over_that_of_yaw():
    """Scatter over the tail speeds: the smaller of acceleration and roll integral over that of the
    yaw rate.
    """
    least = min(scatter("average_linear_acceleration_m_per_s2"), scatter("roll_integral_rad"))
    return least / scatter("average_yaw_rate_rad_per_s")


@slow
def most_stable_tail_speed():
    """The tail speed (rad/s) with the smallest mean roll integral over 3.33 to 4.44 m/s; one that
    flips is none.
    """
    values = tailed("roll_integral_rad")
    return float(
        TAIL_SPEEDS[
            int(np.argmin(np.where(np.isnan(values).any(axis=0), np.inf, np.mean(values, axis=0))))
        ]
    )


# Trends of the physical runs, section 7.2.3


@slow
def change_of_the_mean_acceleration_with_throttle():
    """Largest less smallest mean lateral acceleration, of their mean, over the tailed runs at 35 to
    50 %.
    """
    speeds = [throttle_speed(percent / 100.0) for percent in range(35, 51, 5)]
    values = [
        field_trial("swing", speed).summary.metrics.filtered.average_linear_acceleration_m_per_s2
        for speed in speeds
    ]
    return float(np.ptp(values) / np.mean(values))


def of_the_physical_pair(measure):
    """A measure of the fastest physical run with its tail over that of the fastest without."""
    return measure(field_trial("swing", 6.10)) / measure(field_trial("none", 3.37))


@slow
def physical_mean_yaw_rate_with_over_without():
    return of_the_physical_pair(lambda one: one.summary.metrics.filtered.average_yaw_rate_rad_per_s)


@slow
def time_on_two_wheels_with_over_without():
    return of_the_physical_pair(lambda one: one.summary.metrics.two_wheel_time_s or 0.0)
