"""What runs of the default car and of the car on the field show where the thesis states something
about its runs.

A run is made once per process.
"""

import math
from dataclasses import fields
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from aerodima.optimisation.calibrate.calibration_plan import load_plan
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.laws import steady_speed
from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import IMU_FILTER, low_pass
from aerodima.workbench.metrics.published_values import TurnMetrics, published_values
from aerodima.workbench.metrics.run_summary import KM_PER_H, RunSummary, summarise
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import AXLES
from tests.built.registry import RUNS, run

TAILLESS, TAILED = 12 / KM_PER_H, 16 / KM_PER_H
"""Fastest turns that the simulated car of the thesis survived without and with its tail, m/s
(ERRATA E37)."""
ROUNDING = 1e-6
"""Of a speed, m/s."""
UNLOADED = 0.1
"""A wheel in the air bears less, N."""


class Trial(NamedTuple):
    """A run and what it came to."""

    run_log: RunLog
    summary: RunSummary


def run_trial(scenario, record="outcome"):
    run = simulate(scenario, record=record, stop_when_certain=True)
    return Trial(run, summarise(run, scenario.name))


@cache
def trial(tail, speed, *settings):
    """The published turn of the default car; every column at the two published speeds."""
    overrides = [f"manoeuvre.speed={speed!r}", *settings]
    everything = speed in (TAILLESS, TAILED) and not settings
    return run_trial(load_scenario(f"turn_{tail}", overrides), "all" if everything else "outcome")


@cache
def field_trial(tail, speed):
    """The published turn of the car on the field, driven as its calibration drives it."""
    settings = [
        *load_plan().settings["physical"],
        f"tail.mode={tail}",
        f"manoeuvre.speed={speed!r}",
    ]
    return run_trial(load_scenario("field", settings))


def throttle_speed(throttle):
    """Steady speed (m/s) by the assumed line of the parameters: Fig. 6.8 is not in the text."""
    return steady_speed(throttle, load_scenario("turn_none").drive)


def signals_of(one):
    return turn_signals(one.run_log)


def column(one, name):
    return one.run_log.signal(name)


def in_window(one):
    return signals_of(one).in_window


# Outcomes


def outcome(tail, kilometres_per_hour):
    return trial(tail, kilometres_per_hour / KM_PER_H).summary.metrics.outcome.result


for tail, speeds in {"none": (10, 12, 13), "swing": (12, 16, 17)}.items():
    for whole in speeds:
        RUNS[f"outcome_{tail}_{whole}_km_per_h"] = partial(outcome, tail, whole)


@run
def outcome_swing_at_6_10():
    return field_trial("swing", 6.10).summary.metrics.outcome.result


# Metrics of Tables 7.1 to 7.4


def metric(platform, configuration, name):
    """A metric of a published row's run: raw signals for the simulated car, filtered ones for the
    real one.
    """
    row = next(
        r for r in published_values() if (r.platform, r.configuration) == (platform, configuration)
    )
    tail, speed = ("none", TAILLESS) if configuration == "tailless" else ("swing", TAILED)
    if platform == "simulated":
        one = trial(tail, speed)
    else:
        one = field_trial(tail, row.metrics.speed_m_per_s)
    return float(getattr(one.summary.metrics.like(platform), name))


for row in published_values():
    for field in fields(TurnMetrics):
        RUNS[f"{row.platform}_{row.configuration}_{field.name}"] = partial(
            metric, row.platform, row.configuration, field.name
        )


# The turn without tail at 3.33 m/s


@run
def time_of_the_servo():
    """From the steering command until the linkage stands at 30 degrees, s: its inner and outer
    wheel stop moving.
    """
    one = trial("none", TAILLESS)
    angle = column(one, "plant_position_car_front_left_steering_q")
    since = one.run_log.time - signals_of(one).window[0]
    held = (since > 0.3) & (since < 0.45)
    full = float(np.mean(angle[held]))
    return float(since[np.flatnonzero((since > 0.0) & (angle > 0.98 * full))[0]])


@run
def time_until_straight_again():
    first, last = signals_of(trial("none", TAILLESS)).window
    return last - first


def wheel_angle(side):
    one = trial("none", TAILLESS)
    since = one.run_log.time - signals_of(one).window[0]
    held = (since > 0.3) & (since < 0.45)
    return float(np.mean(column(one, f"plant_position_car_front_{side}_steering_q")[held]))


RUNS["angle_of_the_left_wheel"] = partial(wheel_angle, "left")
RUNS["angle_of_the_right_wheel"] = partial(wheel_angle, "right")


@run
def speed_kept_in_the_turn():
    """Forward speed at the end of the turn over that at its start, no tail, 3.33 m/s."""
    one = trial("none", TAILLESS)
    forward = column(one, "velocity_x_truth_m_per_s")[in_window(one)]
    return float(forward[-1] / forward[0])


@run
def speed_at_2_s():
    """Share of the commanded speed that is reached when the turn begins."""
    one = trial("none", TAILLESS)
    return float(signals_of(one).speed[in_window(one)][0] / TAILLESS)


@run
def yaw_rate_when_an_inner_wheel_lifts():
    """No tail, 3.33 m/s: the first of the two inner wheels."""
    return trial("none", TAILLESS).summary.metrics.lift_yaw_rate_rad_per_s


@run
def stands_on_its_right_wheels_and_comes_back():
    """Physical tailless turn: left turn at 3.37 m/s, both left wheels leave the ground, at the end
    all bear.
    """
    one = field_trial("none", 3.37)
    loads = signals_of(one).wheel_loads
    left_off = np.all(loads[:, [0, 2]] < UNLOADED, axis=1) & np.any(
        loads[:, [1, 3]] > UNLOADED, axis=1
    )
    return bool(np.any(left_off)) and one.summary.metrics.outcome.end_wheels_loaded == 4


@run
def rolls_over_its_front_right_end():
    """At 3.61 m/s without tail: leaning right, nose down, when its tilt passes 60 degrees."""
    one = field_trial("none", 3.61)
    past = np.flatnonzero(column(one, "tilt_truth_rad") > math.radians(60.0))
    if not past.size:
        return "no flip"
    roll, pitch = (float(column(one, f"{name}_truth_rad")[past[0]]) for name in ("roll", "pitch"))
    return f"{'front' if pitch > 0.0 else 'rear'} {'right' if roll > 0.0 else 'left'}"


@run
def tipping_acceleration_over_that_of_a_box():
    """Filtered lateral acceleration when both inner wheels are in the air (no tail, 3.33 m/s), over
    a box's.

    A rigid box tips at g x half the width it stands on / height of the centre of mass.
    """
    scenario = load_scenario("turn_none")
    signals = signals_of(trial("none", TAILLESS))
    box = scenario.environment.gravity * scenario.car.outer_half_track / scenario.car.com_height
    loads = signals.wheel_loads
    off = np.flatnonzero(signals.in_window & (loads[:, 0] < UNLOADED) & (loads[:, 2] < UNLOADED))
    return float(low_pass(signals.time, signals.lateral_acceleration, IMU_FILTER)[off[0]] / box)


@run
def damping_changes_the_outcome():
    """Whether half or twice the suspension's damping changes what the car survives at 3.33 and 3.61
    m/s.
    """
    values = load_scenario("turn_none").car
    found = set()
    for factor in (0.5, 1.0, 2.0):
        settings = [
            f"car.suspension_damping_{axle}="
            f"{factor * getattr(values, f'suspension_damping_{axle}')!r}"
            for axle in AXLES
        ]
        speeds = (TAILLESS, 13 / KM_PER_H)
        found.add(
            tuple(
                trial("none", speed, *settings).summary.metrics.outcome.result for speed in speeds
            )
        )
    return len(found) > 1


# Straight on


def full_throttle(board):
    """From rest with full throttle at once, no tail."""
    settings = [
        "tail.mode=none",
        "manoeuvre.speed=12.9",
        "manoeuvre.speed_ramp=0.001",
        "manoeuvre.duration=3.0",
    ]
    return run_trial(
        load_scenario("straight", [*settings, f"car.board={board}"])
    ).summary.metrics.outcome.result


RUNS["full_throttle_with_board"] = partial(full_throttle, "true")
RUNS["full_throttle_without_board"] = partial(full_throttle, "false")


@run
def board_touches_in_the_turn():
    """In the fastest turns survived in simulation, with and without tail."""
    runs = (trial("none", TAILLESS), trial("swing", TAILED))
    return any("board" in one.summary.metrics.outcome.touched for one in runs)


# The verification run


@run
def slalom():
    """Driven on at its speed."""
    return run_trial(
        load_scenario("slalom", ["manoeuvre.duration=4.0"])
    ).summary.metrics.outcome.result
