"""Tip-up of a steered car: how high two wheels of one side are lifted, and what touches the
ground.

NHTSA calls two wheels of one side two inches (51 mm) above the ground a tip-up, on cars of full
size. At the size of this car, a tenth, it is `TWO_WHEELS`. Everything is from the ground truth and
counts from the start of the steering on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from aerodima.workbench.car.turn_course import ground_velocity
from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.car.verdict import LAST, is_loaded, side_lift, touches_ground
from aerodima.workbench.control.paths import off_path, path_of
from aerodima.workbench.core.array_types import BoolArray, FloatArray
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import in_parts
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, WHEELS

LIFT_COLUMNS = tuple(f"wheel_lift_{wheel}_truth_m" for wheel in WHEELS)
"""Height of the lowest point of each tyre over the level ground, m; not above 0 where it presses
into the ground."""

Windows = Sequence[tuple[float, float, float]]
"""Start and end, s, and side, +1 left or -1 right, of each part of a run in which the car is
steered to that side."""

_TIME_MARGIN = 1e-6
"""A sample this close to the edge of a window (s) belongs to it."""


@dataclass(frozen=True)
class TipUp:
    """Lift, contacts and turning of a steered car.

    Attributes:
        side_lift_m: largest value over time of the smaller lift of the two wheels of one side, m;
            None where the log lacks the lifts.
        touched_when_steered: which of cage, board and tail touched the ground, the anti-ramp board
            while the car is steered alone: it is there to catch a car that gathers speed after a
            turn; None where the log cannot tell.
        lateral_acceleration_m_per_s2: see `lateral_acceleration`; None where the log ends before
            the steering.
        last_yaw_rate_rad_per_s: mean of the last `LAST` seconds; None where the car is steered in
            them.
    """

    side_lift_m: float | None
    touched_when_steered: str | None
    lateral_acceleration_m_per_s2: float | None
    last_yaw_rate_rad_per_s: float | None


def tip_up(run_log: RunLog, windows: Windows) -> TipUp:
    """Measures a run; LogError as for `turn_signals`, or where there is no ground truth.

    Args:
        run_log: of the car.
        windows: in which it is steered.
    """
    signals = turn_signals(run_log, "truth")
    contact = signals.ground_contact
    steered = signals.from_start
    lifts = [run_log.signal(name)[steered] for name in LIFT_COLUMNS if name in run_log.table]
    last = signals.time[-1] - LAST
    time = run_log.time
    turning = in_parts(time, [(start, end) for start, end, _ in windows])
    largest_lift = None
    if len(lifts) == len(WHEELS):
        largest_lift = float(np.max(side_lift(lifts)))
    touched = None
    if contact is not None:
        touched = " ".join(_touched(contact[steered], turning[steered]))
    last_yaw_rate = None
    if not any(end > last for _, end, _ in windows):
        last_yaw_rate = float(np.mean(signals.yaw_rate[signals.time >= last]))
    return TipUp(
        side_lift_m=largest_lift,
        touched_when_steered=touched,
        lateral_acceleration_m_per_s2=lateral_acceleration(
            time, *ground_velocity(run_log), windows
        ),
        last_yaw_rate_rad_per_s=last_yaw_rate,
    )


def _touched(contact: FloatArray, steered: BoolArray) -> list[str]:
    """Returns which of `GROUND_CONTACTS` counts as touched, from their forces (n, 3), N."""
    touched = []
    for part, force in zip(GROUND_CONTACTS, contact.T, strict=True):
        hit = is_loaded(force)
        if part == "board":
            counts = touches_ground(False, hit, steered)
        else:
            counts = touches_ground(hit, False, steered)
        if np.any(counts):
            touched.append(part)
    return touched


def lateral_acceleration(
    time: FloatArray, speed: FloatArray, course: FloatArray, windows: Windows
) -> float | None:
    """Returns the mean over all windows, and over time, of side times speed times rate of the
    course, m/s2.

    None where no window has two samples. The body's yaw rate would count a spin, which does not
    turn the path.

    A window that reaches beyond the samples counts as far as they go.

    Args:
        time: (n,), s.
        speed: over the ground (n,), m/s.
        course: (n,), rad, unwrapped, positive to the left.
        windows: in which the car is steered.
    """
    turned = 0.0
    length = 0.0
    for start, end, side in windows:
        inside = (time >= start - _TIME_MARGIN) & (time <= end + _TIME_MARGIN)
        if np.count_nonzero(inside) > 1:
            turned += side * float(trapezoid(speed[inside], course[inside]))
            length += float(np.ptp(time[inside]))
    if length:
        return turned / length
    return None


def path_row(run_log: RunLog, scenario: Scenario) -> dict[str, float | bool]:
    """Returns how far a run leaves its lane at most, m (negative: it keeps it), and whether it gets
    to the end of the path.

    Nothing for a manoeuvre that follows no path. LogError where there is no ground truth.
    """
    if scenario.manoeuvre.kind != "path":
        return {}
    path = path_of(scenario)
    car = scenario.car
    x = run_log.signal("position_x_truth_m")
    y = run_log.signal("position_y_truth_m")
    heading = run_log.signal("yaw_truth_rad")
    half_width = 0.5 * (car.track + car.tyre_width)
    outside = off_path(path, x, y, heading, half_width, car.wheelbase)
    return {
        "off_path_m": float(np.max(outside)),
        "path_end_reached": bool(np.max(path.station(x, y)) >= path.end),
    }
