"""A run as Foxglove draws it (https://docs.foxglove.dev/docs/visualization/message-schemas):
bodies, poses and forces.

The bodies and the floor are drawn once, each in the frame of its own body; poses come as transforms
to `world`, forces as arrows there, of the lengths and colours of the replay. `export_log` puts them
beside the signals.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.spatial import ConvexHull

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.exporters import SceneMessage, stamp_of
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.force_arrows import ForceArrow, force_arrows, shortest_turn
from aerodima.workbench.view.logged_run import LoggedRun, add_logged_run
from aerodima.workbench.view.recording import frame_rows
from aerodima.workbench.view.scene_shapes import WORLD_BODY, body_label, pose_of, shapes_of
from aerodima.workbench.view.viewer import area_around

POSES = "/tf"
"""Topic of the poses: a message `FrameTransforms` each."""
BODIES = "/scene/bodies"
"""Topic of the bodies: `SceneUpdate`."""
FORCES = "/scene/forces"
"""Topic of the force arrows: `SceneUpdate`."""
WORLD_FRAME = "world"
_FLOOR = (0.90, 0.91, 0.92)
"""Red, green, blue from 0 to 1."""
_SHAFT = 0.014
"""Diameter of the shaft of an arrow, m."""
_HEAD = 0.036
"""Diameter of the head of an arrow, m."""
_HEAD_LENGTH = 0.05
"""Length of the head of an arrow, m."""


def foxglove_scene(run_log: RunLog) -> Iterator[SceneMessage]:
    """The messages of a run in the order of their times, 50 frames a second.

    Args:
        run_log: the run.

    Raises:
        LogError: the log cannot be replayed (see `replayable`), or `foxglove_schemas_protobuf` is
            not installed.
    """
    try:
        import foxglove_schemas_protobuf  # noqa: F401
    except ImportError:
        raise LogError(
            "a scene needs foxglove_schemas_protobuf: pip install 'aerodima-workbench[logs]'"
        ) from None
    builder = DiagramBuilder()
    logged = add_logged_run(builder, run_log)
    diagram = builder.Build()
    return _messages(logged, diagram.CreateDefaultContext())


def _messages(logged: LoggedRun, context: Context) -> Iterator[SceneMessage]:
    time = logged.run_log.time
    if len(time) > 1:
        rows = frame_rows(time, 1.0)[0]
    else:
        rows = np.zeros(1, dtype=np.int64)
    arrows = force_arrows(logged)
    scene = shapes_of(logged.plant, logged.scene_graph)
    plant_context = logged.plant.GetMyMutableContextFromRoot(context)
    labels = {
        body_label(logged.plant, BodyIndex(index)): index
        for index in range(logged.plant.num_bodies())
    }
    bodies = {
        entry["body"]: BodyIndex(labels[entry["body"]])
        for entry in scene
        if entry["body"] != WORLD_BODY
    }
    yield SceneMessage(time[rows[0]], BODIES, _bodies(logged, scene, time[rows[0]]))
    for row in rows:
        logged.move(plant_context, row)
        yield SceneMessage(time[row], POSES, _poses(logged, bodies, plant_context, time[row]))
        if arrows:
            yield SceneMessage(time[row], FORCES, _forces(arrows, row, time[row]))


def _bodies(logged: LoggedRun, scene: list[dict[str, Any]], time: float) -> Any:
    """Every visible shape, locked to the frame of its body, and the floor."""
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    entities: dict[str, Any] = {}
    for shape in scene:
        name = shape["body"] or WORLD_FRAME
        if name not in entities:
            entities[name] = _entity(update, name, name, time)
        _add_shape(entities[name], shape)
    x0, x1, y0, y1 = area_around(logged.path)
    slab = _entity(update, "floor", WORLD_FRAME, time).cubes.add()
    _place(
        slab, RigidTransform(np.array([(x0 + x1) / 2, (y0 + y1) / 2, logged.floor - 0.012])), _FLOOR
    )
    _set_vector(slab.size, (x1 - x0, y1 - y0, 0.01))
    return update


def _entity(update: Any, name: str, frame: str, time: float) -> Any:
    """A new entity that moves with its frame."""
    entity = update.entities.add(id=name, frame_id=frame, frame_locked=True)
    entity.timestamp.FromNanoseconds(stamp_of(time))
    return entity


def _add_shape(entity: Any, shape: dict[str, Any]) -> None:
    """A shape of `shapes_of` as Foxglove's primitive; a hull as its triangles."""
    size = np.asarray(shape["size"], dtype=float)
    if shape["kind"] == "hull":
        primitive = entity.triangles.add()
        for corner in size[ConvexHull(size).simplices].reshape(-1, 3):
            _set_vector(primitive.points.add(), corner)
    elif shape["kind"] == "box":
        primitive = entity.cubes.add()
        _set_vector(primitive.size, size)
    elif shape["kind"] == "cylinder":
        primitive = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
        _set_vector(primitive.size, (2.0 * size[0], 2.0 * size[0], size[1]))
    else:
        primitive = entity.spheres.add()
        _set_vector(primitive.size, np.broadcast_to(2.0 * size, 3))
    _place(primitive, pose_of(shape), shape["colour"])


def _poses(
    logged: LoggedRun, bodies: dict[str, BodyIndex], plant_context: Context, time: float
) -> Any:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message = FrameTransforms()
    for name, index in bodies.items():
        X_WB = logged.plant.EvalBodyPoseInWorld(plant_context, logged.plant.get_body(index))
        transform = message.transforms.add(parent_frame_id=WORLD_FRAME, child_frame_id=name)
        transform.timestamp.FromNanoseconds(stamp_of(time))
        _set_vector(transform.translation, X_WB.translation())
        _set_rotation(transform.rotation, X_WB.rotation())
    return message


def _forces(arrows: list[ForceArrow], row: int, time: float) -> Any:
    """The arrows of a row; one that is too short is taken away."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    for arrow in arrows:
        if not arrow.shown[row]:
            gone = update.deletions.add(id=arrow.name, type=SceneEntityDeletion.MATCHING_ID)
            gone.timestamp.FromNanoseconds(stamp_of(time))
            continue
        length = float(np.linalg.norm(arrow.lengths[row]))
        drawn = _entity(update, arrow.name, WORLD_FRAME, time).arrows.add(
            shaft_length=max(length - _HEAD_LENGTH, 1e-3),
            shaft_diameter=_SHAFT,
            head_length=_HEAD_LENGTH,
            head_diameter=_HEAD,
        )
        # Foxglove's arrows point along x, `shortest_turn` turns z.
        along_x = RotationMatrix.MakeYRotation(-np.pi / 2.0)
        turn = shortest_turn(arrow.lengths[row] / length) @ along_x
        _place(drawn, RigidTransform(turn, arrow.points[row]), arrow.colour)
    return update


def _place(primitive: Any, pose: RigidTransform, colour: Sequence[float]) -> None:
    _set_vector(primitive.pose.position, pose.translation())
    _set_rotation(primitive.pose.orientation, pose.rotation())
    primitive.color.r, primitive.color.g, primitive.color.b = colour
    primitive.color.a = 1.0


def _set_vector(target: Any, values: Any) -> None:
    target.x, target.y, target.z = map(float, values)


def _set_rotation(target: Any, rotation: RotationMatrix) -> None:
    quaternion = rotation.ToQuaternion()
    target.w = quaternion.w()
    target.x = quaternion.x()
    target.y = quaternion.y()
    target.z = quaternion.z()
