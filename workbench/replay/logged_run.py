"""What a replay asks of a logged run, whatever moved in it: the plant to be posed, paths, forces and where to look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.logs.schema import RunLog

AIR_SCALE = 0.10
"""Length of the arrow of the air on a tail, m per N, unless the run says another: the car's gives a few newtons."""


@dataclass(frozen=True)
class AirOnTail:
    """The force of the air on one tail over a run, W axes, shape (n, 3) each.

    Attributes:
        name: of the tail.
        force: N.
        moment: about Wo, N m.
        root, tip: ends of its sections in W, m.
    """

    name: str
    force: FloatArray
    moment: FloatArray
    root: FloatArray
    tip: FloatArray


class LoggedRun(Protocol):
    """A run whose plant can be put where it was; see `aerodima.workbench.replay.logged_plant.add_logged_run`."""

    @property
    def run_log(self) -> RunLog:
        """The run, with what a replay reads."""

    @property
    def plant(self) -> MultibodyPlant:
        """Moved, not simulated."""

    @property
    def scene_graph(self) -> SceneGraph:
        """Shapes of the plant."""

    @property
    def path(self) -> FloatArray:
        """Where it went, W, m, shape (n, 3); the floor is drawn about it."""

    @property
    def tips(self) -> dict[str, FloatArray]:
        """Name -> path of the tip of a tail in W, m, shape (n, 3)."""

    @property
    def air(self) -> list[AirOnTail]:
        """The air on each tail; none where the log holds no forces."""

    @property
    def air_scale(self) -> float:
        """Length of an arrow of the air, m per N."""

    @property
    def camera_place(self) -> tuple[float, float, float]:
        """Distance and height of the camera, and height of the point that it looks at, m."""

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the plant where it was in one row of the log."""
