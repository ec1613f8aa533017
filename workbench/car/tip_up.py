"""Tip-up of a steered car: how high two wheels of one side are lifted, and what touches the
ground.

NHTSA calls two wheels of one side two inches (51 mm) above the ground a tip-up, on cars of full
size. At the size of this car, a tenth, it is `TWO_WHEELS`. Everything is from the ground truth and
counts from the start of the steering on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.car.verdict import is_loaded, side_lift, touches_ground
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


@dataclass(frozen=True)
class TipUp:
    """Lift and contacts of a steered car.

    Attributes:
        side_lift_m: largest value over time of the smaller lift of the two wheels of one side, m;
            None where the log lacks the lifts.
        touched_when_steered: which of cage, board and tail touched the ground; the anti-ramp board
            counts only while the car is steered, since it is there to catch a car that gathers
            speed after a turn; None where the log cannot tell.
    """

    side_lift_m: float | None
    touched_when_steered: str | None


def tip_up(run_log: RunLog, windows: Windows) -> TipUp:
    """Measures a run; LogError as for `turn_signals`, or where there is no ground truth.

    Args:
        run_log: log of a run of the car.
        windows: parts of the run in which the car is steered.
    """
    signals = turn_signals(run_log, "truth")
    contact = signals.ground_contact
    steered = signals.from_start
    lifts = [run_log.signal(name)[steered] for name in LIFT_COLUMNS if name in run_log.table]
    turning = in_parts(run_log.time, [(start, end) for start, end, _ in windows])
    largest_lift = None
    if len(lifts) == len(WHEELS):
        largest_lift = float(np.max(side_lift(lifts)))
    touched = None
    if contact is not None:
        touched = " ".join(_touched(contact[steered], turning[steered]))
    return TipUp(side_lift_m=largest_lift, touched_when_steered=touched)


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


def path_row(run_log: RunLog, scenario: Scenario) -> dict[str, float | bool]:
    """Returns how far a car leaves its lane at most, m (negative if it stays inside), and whether
    it reaches the end of the path.

    The row is empty for a manoeuvre without a path. LogError where there is no ground truth.
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
