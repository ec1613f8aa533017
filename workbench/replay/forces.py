"""Forces of a run as arrows: ground on the wheels, air on the tail."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.logged_car import LoggedCar
from aerodima.workbench.replay.reckoned_motion import RECKONED

WHEEL_COLOUR = (0.10, 0.55, 0.25)
AIR_COLOUR = (0.85, 0.25, 0.10)
WHEEL_SCALE = 0.02
"""Length of the arrow of a wheel, m per N: a wheel at rest carries about 15 N."""
AIR_SCALE = 0.10
"""Length of the arrow of the tail, m per N: the air gives a few newtons."""
SHOWN_LENGTH = 0.015
"""Arrows shorter than this (m) are left out."""


@dataclass(frozen=True)
class ForceArrow:
    """One force over the run.

    Attributes:
        name: of the force.
        colour: red, green, blue from 0 to 1.
        points: where it acts in W, m, shape (n, 3).
        lengths: the arrow, force times scale, W axes, m, shape (n, 3).
    """

    name: str
    colour: tuple[float, float, float]
    points: FloatArray
    lengths: FloatArray

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Whether the arrow is long enough to be drawn, shape (n,)."""
        return np.linalg.norm(self.lengths, axis=1) > SHOWN_LENGTH


def force_arrows(logged: LoggedCar) -> list[ForceArrow]:
    """Every arrow of a run, one row per row of the log; none for a real car, whose log holds no forces."""
    run_log = logged.run_log
    if RECKONED in run_log.extra:
        return []
    arrows = [_wheel_arrow(run_log, wheel) for wheel in WHEELS]
    if logged.car.tail is not None:
        force = run_log.vector("tail_force", "truth_n")
        root, tip = tail_axis(logged)
        points = point_on_axis(force, run_log.vector("tail_force_moment", "truth_n_m"), root, tip)
        arrows.append(ForceArrow("air_on_tail", AIR_COLOUR, points, AIR_SCALE * force))
    return arrows


def _wheel_arrow(run_log: RunLog, wheel: str) -> ForceArrow:
    force = run_log.vector(f"wheel_force_{wheel}", "truth_n")
    points = run_log.vector(f"wheel_contact_{wheel}", "truth_m")
    return ForceArrow(f"ground_on_{wheel}", WHEEL_COLOUR, points, WHEEL_SCALE * force)


def tail_axis(logged: LoggedCar) -> tuple[FloatArray, FloatArray]:
    """Root and tip of the tail in W, m, each of shape (n, 3)."""
    plant = logged.car.plant
    context = plant.CreateDefaultContext()
    rod = plant.GetBodyByName("tail_rod")
    roots = []
    for row in range(len(logged.positions)):
        logged.move(context, row)
        roots.append(plant.EvalBodyPoseInWorld(context, rod).translation())
    return np.array(roots), logged.run_log.vector("tail_tip", "truth_m")


def point_on_axis(force: FloatArray, moment: FloatArray, root: FloatArray, tip: FloatArray) -> FloatArray:
    """The point of the tail's axis that is nearest to the line of action of a force.

    The line of action is q + s F with q = F x M / F.F, where M is the moment about the world origin. A point r + t u of
    the axis is nearest to it where (r + t u - q) is perpendicular to both lines. Without a force, or where it acts
    along the axis, it is the middle of the tail; beyond the ends it is the end.

    Args:
        force: F in W, N, shape (n, 3).
        moment: M about Wo, W axes, N m, shape (n, 3).
        root, tip: ends of the tail in W, m, shape (n, 3).
    """
    axis = tip - root
    square = np.einsum("ij,ij->i", force, force)[:, None]
    safe = np.where(square > 0.0, square, 1.0)
    q = np.cross(force, moment) / safe
    across = axis - force * np.einsum("ij,ij->i", force, axis)[:, None] / safe
    weight = np.einsum("ij,ij->i", across, axis)
    usable = (square[:, 0] > 0.0) & (weight > 1e-9 * np.einsum("ij,ij->i", axis, axis))
    fraction = np.einsum("ij,ij->i", across, q - root) / np.where(usable, weight, 1.0)
    fraction = np.where(usable, np.clip(fraction, 0.0, 1.0), 0.5)
    return root + fraction[:, None] * axis
