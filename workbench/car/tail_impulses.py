"""Moment of the tail on the car about its heading axis, split by cause.

Take the tail alone, with momentum P and angular momentum L about the world origin Wo. The air acts
on it with the force F and the moment M about Wo, its weight m g at its centre of mass c, and the
car with a reaction. Newton and Euler give the reaction; its opposite is what the tail does to the
car, and about a point p it is

    N = [M - p x F] + (c - p) x m g - [dL/dt - p x dP/dt]
         air           weight          inertia

at every instant, however p moves. With L = L_p + p x P the last bracket is dL_p/dt + v_p x P, free
of large terms that cancel. Here p is the point of the ground below Bo and the axis e is the
heading, horizontal along x of B. N . e rolls the car to the right. A left turn rolls it outwards,
to the right, so what helps is -N . e there and +N . e in a right turn.

Impulses are integrals of that moment over the window of the turn.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid

from aerodima.workbench.car.turn_signals import TurnSignals, turn_signals
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_signals

CAUSES = ("aerodynamic", "weight", "inertial")
"""Causes by which the tail's moment is split."""


@dataclass(frozen=True)
class Impulses:
    """Angular impulses of the tail on the car by cause, N m s."""

    aerodynamic: float
    weight: float
    inertial: float


def tail_impulses(run_log: RunLog) -> Impulses | None:
    """Returns the angular impulses about the heading axis over the window of the turn; None for a
    car without a tail.

    N m s, positive = against rolling outwards.

    Raises:
        LogError: no ground truth in the log, `tail_mass_kg` not in its metadata, NaN, unsorted time
            or a gap.
    """
    if not run_log.has_tail:
        return None
    if not run_log.has_truth:
        raise LogError(
            f"{run_log.name}: has no ground truth, so the tail's impulses cannot be found"
        )
    signals = turn_signals(run_log)
    yaw = run_log.signal("yaw_truth_rad")
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)])
    below = run_log.vector("position", "truth_m") * [1.0, 1.0, 0.0]
    return _over_window(run_log, signals, below, -signals.sign * heading)


def tail_yaw_impulses(run_log: RunLog) -> Impulses:
    """Returns the angular impulses of the tail over the window of the turn about the vertical
    through the vehicle's centre of mass.

    N m s, positive = into the turn. A weight has no moment about the vertical. The reaction of the
    tail's inertia is what turns the car out of the turn while the tail is behind the centre of mass
    and swings outwards.

    Raises:
        LogError: as for `tail_impulses`, or the car has no tail.
    """
    signals = turn_signals(run_log)
    axis = np.tile([0.0, 0.0, signals.sign], (signals.time.size, 1))
    return _over_window(run_log, signals, run_log.vector("com", "truth_m") * [1.0, 1.0, 0.0], axis)


def tail_effort(run_log: RunLog, after: BoolArray) -> tuple[float | None, float | None]:
    """Returns the largest torque (N m) and positive work (J) of the tail motors in these rows; None
    without their columns.

    A log of the real car may come from loggers that did not record the motors; a simulated one has
    them always.
    """
    torques = ("tail_pitch_torque_n_m", "tail_roll_torque_n_m")
    if run_log.kind != "car_run" and not set(torques) <= set(run_log.table.columns):
        return None, None
    signals = {name: run_log.signal(name) for name in torques}
    rates = [f"tail_{joint}_rate_rad_per_s" for joint in ("pitch", "roll")]
    if "tail_power_truth_w" in run_log.table.columns:
        signals["tail motor power"] = run_log.signal("tail_power_truth_w")
    elif run_log.kind == "car_run" or set(rates) <= set(run_log.table.columns):
        pairs = zip(signals.values(), rates, strict=True)
        signals["tail motor power"] = np.sum(
            [torque * run_log.signal(rate) for torque, rate in pairs], axis=0
        )
    check_signals(run_log.time, signals)
    peak = max(float(np.max(np.abs(signals[name][after]))) for name in torques)
    power = signals.get("tail motor power")
    if power is None:
        return peak, None
    return peak, float(trapezoid(np.maximum(power[after], 0.0), run_log.time[after]))


def _over_window(
    run_log: RunLog, signals: TurnSignals, point: FloatArray, axis: FloatArray
) -> Impulses:
    """Returns the impulses about an axis through a point, each (n, 3) in W.

    The inertial part is summed from the changes of the angular momentum themselves, with P and the
    axis taken in the middle of each step, so that a jump of the momentum (a contact) counts in full
    however short it was.
    """
    if "tail_mass_kg" not in run_log.extra:
        raise LogError(f"{run_log.name}: its metadata have no tail_mass_kg")
    weight = np.array(
        [0.0, 0.0, -float(run_log.extra["tail_mass_kg"]) * run_log.number("environment", "gravity")]
    )
    time = signals.time
    momentum = run_log.vector("tail_momentum", "truth_n_s")
    about_point = run_log.vector("tail_angular_momentum", "truth_n_m_s") - np.cross(point, momentum)
    air = run_log.vector("tail_force_moment", "truth_n_m") - np.cross(
        point, run_log.vector("tail_force", "truth_n")
    )
    hanging = np.cross(run_log.vector("tail_com", "truth_m") - point, weight)
    middle_momentum = 0.5 * (momentum[1:] + momentum[:-1])
    middle_axis = 0.5 * (axis[1:] + axis[:-1])
    change = np.diff(about_point, axis=0) + np.cross(np.diff(point, axis=0), middle_momentum)
    growth = {
        "aerodynamic": cumulative_trapezoid(np.vecdot(air, axis), time, initial=0.0),
        "weight": cumulative_trapezoid(np.vecdot(hanging, axis), time, initial=0.0),
        "inertial": np.concatenate([[0.0], np.cumsum(-np.vecdot(change, middle_axis))]),
    }
    check_signals(time, {f"tail impulse ({cause})": sums for cause, sums in growth.items()})
    return Impulses(
        **{
            cause: float(np.diff(np.interp(signals.window, time, s))[0])
            for cause, s in growth.items()
        }
    )
