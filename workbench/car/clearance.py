"""Range of motion in which the tail does not touch the car: clearance over pitch and roll by signed
distances of drawn shapes.

The contact model of a run knows only the few points of car and tail that meet the ground; here
every shape that the model draws takes part: rod and sail against cage, deck, board, wheels and
ground. The gearbox that carries the joints is left out, as the rod ends on it and its bracket is
not published. Only rod and sail are asked, not the hub.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerodima.workbench.core.array_types import FloatArray, Texts
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.tail_parameters import TailParameters

PARTS = ("cage", "deck", "wheels", "ground")
"""Parts that the tail may touch. Deck: chassis, rear deck, electronics and anti-ramp board."""

_TAIL_LINKS = ("tail_rod", "tail_sail")
_FAR = 0.3
"""Largest clearance that is looked for, m; a larger one counts as this."""
_GROUND_SIZE = 20.0
"""Length and width of the ground, m."""


@dataclass(frozen=True)
class RangeOfMotion:
    """Clearance map of a car that stands on level ground.

    Attributes:
        pitch: pitch of the tail at the nodes, rad, increasing, shape (p,).
        roll: roll of the tail at the nodes, rad, increasing, shape (r,).
        clearances: clearance to each of `PARTS`, m, at most 0.3, negative where the shapes overlap,
            shape (p, r, 4).
    """

    pitch: FloatArray
    roll: FloatArray
    clearances: FloatArray

    def clearance(self, pitch: ArrayLike, roll: ArrayLike, parts: Texts = PARTS) -> NDArray[Any]:
        """Returns the least clearance to some parts, m: bilinear between the nodes, that of the
        edge beyond the map.

        Args:
            pitch, roll: angles of the tail, rad, of shapes that broadcast.
            parts: names from `PARTS`; without the ground the clearance holds at any attitude of
                the car.
        """
        from scipy.interpolate import RegularGridInterpolator

        values = self.clearances[:, :, [PARTS.index(part) for part in parts]].min(axis=2)
        nodes = (self.pitch, self.roll)
        places = (pitch, roll)
        held = [
            np.clip(place, axis[0], axis[-1]) for place, axis in zip(places, nodes, strict=True)
        ]
        return np.asarray(RegularGridInterpolator(nodes, values)(tuple(held)))


def make_range_of_motion(
    scenario: Scenario, pitch_count: int = 37, roll_count: int = 37
) -> RangeOfMotion:
    """Asks Drake's proximity engine at every node of a grid over the whole range of both joints.

    Args:
        scenario: scenario of the car; its tail mode does not matter.
        pitch_count, roll_count: numbers of nodes, at least 3 each.

    Raises:
        UserError: the grid is too small.
        ModelError: the car does not load.
    """
    for name, count in (("pitch", pitch_count), ("roll", roll_count)):
        check_range(f"{name} nodes", count, 3, 1001, NO_UNIT)
    query = TailQuery(scenario.varied(tail={"mode": "swing"}))
    tail = scenario.tail
    pitch = np.linspace(-tail.pitch_limit, tail.pitch_limit, pitch_count)
    roll = np.linspace(-tail.roll_limit, tail.roll_limit, roll_count)
    clearances = np.array([[query.clearances(p, r) for r in roll] for p in pitch])
    return RangeOfMotion(pitch, roll, clearances)


def ground_clearance(
    scenario: Scenario, pitch: ArrayLike, roll: ArrayLike, car_roll: ArrayLike = 0.0
) -> NDArray[Any]:
    """Returns the height of the lowest point of rod and sail above ground as the car leans, m.

    The car leans about the contact line of its outer wheels: to the right (positive) about the
    right ones. A locked sail is the flat plate between its corners; one that turns is the cylinder
    that it sweeps, board included.

    Args:
        scenario: scenario that gives the geometry.
        pitch, roll: angles of the tail, rad.
        car_roll: roll of the car, rad, positive to the right.
    """
    tail = scenario.tail
    half_track = scenario.car.outer_half_track
    pitch, roll, lean = np.broadcast_arrays(pitch, roll, car_roll)
    # Heights of the joints, and of unit steps along x, y and z of the tail.
    sine = np.sin(lean)
    cosine = np.cos(lean)
    joints = np.abs(half_track * sine) + tail.mount_height * cosine
    along_x = -np.sin(pitch) * cosine
    along_y = np.cos(roll) * sine + np.cos(pitch) * np.sin(roll) * cosine
    along_z = -np.sin(roll) * sine + np.cos(pitch) * np.cos(roll) * cosine
    if tail.sail == "locked":
        across = -np.abs(tail.sail_width / 2 * along_x)
    else:
        across = -tail.sail_reach * np.hypot(along_x, along_y)
    ends = [joints + z * along_z + across for z in (tail.length - tail.sail_length, tail.length)]
    return np.asarray(np.min([joints, *ends], axis=0))


class TailQuery:
    """The car with all its drawn shapes as obstacles."""

    def __init__(self, scenario: Scenario) -> None:
        from pydrake.systems.framework import DiagramBuilder

        from aerodima.workbench.car.car_plant import add_car_plant

        builder = DiagramBuilder()
        built = add_car_plant(builder, scenario)
        self._plant = built.plant
        self._parts = _make_obstacles(
            built, None if scenario.tail.sail == "locked" else scenario.tail
        )
        diagram = builder.Build()
        context = diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(context)
        self._query_port = built.scene_graph.get_query_output_port()
        self._graph_context = built.scene_graph.GetMyContextFromRoot(context)
        self._joints: list[Any] = [
            self._plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")
        ]

    def clearances(self, pitch: float, roll: float) -> list[float]:
        """Returns the distance to each of `PARTS`, m."""
        for joint, angle in zip(self._joints, (pitch, roll), strict=True):
            joint.set_angle(self._context, angle)
        query: Any = self._query_port.Eval(self._graph_context)
        least = dict.fromkeys(PARTS, _FAR)
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(_FAR):
            part = self._parts.get(pair.id_A) or self._parts.get(pair.id_B)
            if part is not None:
                least[part] = min(least[part], pair.distance)
        return [least[part] for part in PARTS]


def _make_obstacles(built: Any, turning: TailParameters | None) -> dict[Any, str]:
    """Gives every drawn shape of car and tail a proximity role, and the ground a body; returns the
    part to which each obstacle belongs.

    The cylinder that a turning sail sweeps stands for the sail's shapes. Filters leave only the
    pairs of rod or sail with an obstacle.
    """
    from pydrake.geometry import (
        Box,
        CollisionFilterDeclaration,
        Cylinder,
        GeometrySet,
        ProximityProperties,
        Role,
    )

    plant = built.plant
    graph = built.scene_graph
    inspector = graph.model_inspector()
    source = plant.get_source_id()
    before = GeometrySet(inspector.GetAllGeometryIds(Role.kProximity))
    parts = {}
    arm = []
    rest = []
    for instance in built.instances:
        for index in plant.GetBodyIndices(instance):
            body = plant.get_body(index)
            if body.name() == "tail_sail" and turning is not None:
                middle = turning.length - turning.sail_length / 2
                shape = Cylinder(turning.sail_reach, turning.sail_length)
                swept = _obstacle("swept_sail", shape, middle)
                arm.append(
                    graph.RegisterGeometry(source, plant.GetBodyFrameIdOrThrow(index), swept)
                )
                continue
            for geometry in inspector.GetGeometries(
                plant.GetBodyFrameIdOrThrow(index), Role.kIllustration
            ):
                graph.AssignRole(source, geometry, ProximityProperties())
                part = _part(body.name(), inspector.GetName(geometry))
                if body.name() in _TAIL_LINKS:
                    arm.append(geometry)
                elif part is None:
                    rest.append(geometry)
                else:
                    parts[geometry] = part
    slab = _obstacle("range_of_motion_ground", Box(_GROUND_SIZE, _GROUND_SIZE, 1.0), -0.5)
    parts[graph.RegisterAnchoredGeometry(source, slab)] = "ground"
    everything = GeometrySet([*parts, *arm, *rest])
    filters = CollisionFilterDeclaration()
    filters.ExcludeWithin(before).ExcludeBetween(before, everything)
    filters.ExcludeWithin(GeometrySet([*parts, *rest])).ExcludeWithin(GeometrySet(arm))
    filters.ExcludeBetween(GeometrySet(arm), GeometrySet(rest))
    graph.collision_filter_manager().Apply(filters)
    return parts


def _obstacle(name: str, shape: Any, height: float) -> Any:
    """Makes an obstacle that is not drawn, with its middle at a height, m."""
    from pydrake.geometry import GeometryInstance, ProximityProperties
    from pydrake.math import RigidTransform

    obstacle = GeometryInstance(RigidTransform(np.array([0.0, 0.0, height])), shape, name)
    obstacle.set_proximity_properties(ProximityProperties())
    return obstacle


def _part(body: str, geometry: str) -> str | None:
    """Returns which of `PARTS` a drawn shape belongs to; None for what the tail need not avoid."""
    if body.endswith("_wheel"):
        return "wheels"
    if body not in ("chassis", "board"):
        return None
    return "cage" if "bar" in geometry or "cage" in geometry else "deck"
