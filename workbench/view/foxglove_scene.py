"""The scene of a run in Foxglove's schemas: bodies, poses and forces.

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

from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.exporters import SceneMessage, stamp_of
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.force_arrows import (
    HEAD_LENGTH,
    HEAD_RADIUS,
    SHAFT_RADIUS,
    ForceArrow,
)
from aerodima.workbench.view.logged_run import LoggedRun, add_logged_run
from aerodima.workbench.view.recording import frame_rows
from aerodima.workbench.view.scene_shapes import plant_shapes, scene_bodies, shape_pose
from aerodima.workbench.view.viewer import area_around

POSES = "/tf"
"""Topic of the poses: one message `FrameTransforms` per frame."""
BODIES = "/scene/bodies"
"""Topic of the bodies: `SceneUpdate`."""
FORCES = "/scene/forces"
"""Topic of the force arrows: `SceneUpdate`."""
WORLD_FRAME = "world"
_FLOOR = (0.90, 0.91, 0.92)
"""Red, green, blue from 0 to 1."""


def foxglove_scene(run_log: RunLog) -> Iterator[SceneMessage]:
    """Makes the messages of a run in the order of their times, 50 frames a second.

    Args:
        run_log: log of the run.

    Raises:
        LogError: the log cannot be replayed (see `replayable`).
    """
    builder = DiagramBuilder()
    logged = add_logged_run(builder, run_log)
    diagram = builder.Build()
    return _messages(logged, diagram.CreateDefaultContext())


def _messages(logged: LoggedRun, context: Context) -> Iterator[SceneMessage]:
    time = logged.run_log.time
    rows, _ = frame_rows(time, 1.0)
    arrows = logged.arrows
    scene = plant_shapes(logged.plant, logged.scene_graph)
    plant_context = logged.plant.GetMyMutableContextFromRoot(context)
    bodies = scene_bodies(logged.plant, scene)
    yield SceneMessage(time[rows[0]], BODIES, _bodies(logged, scene, time[rows[0]]))
    for row in rows:
        logged.move(plant_context, row)
        yield SceneMessage(time[row], POSES, _poses(logged, bodies, plant_context, time[row]))
        if arrows:
            yield SceneMessage(time[row], FORCES, _forces(arrows, row, time[row]))


def _bodies(logged: LoggedRun, scene: list[Json], time: float) -> Any:
    """Makes every visible shape, locked to the frame of its body, and the floor."""
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    entities: dict[str, Any] = {}
    for shape in scene:
        name = shape["body"] or WORLD_FRAME
        if name not in entities:
            entities[name] = _entity(update, name, name, time)
        _add_shape(entities[name], shape)
    x0, x1, y0, y1 = area_around(logged.path)
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2, logged.floor - 0.012])
    look = _look(RigidTransform(middle), _FLOOR)
    floor = _entity(update, "floor", WORLD_FRAME, time)
    floor.cubes.add(size=_vector((x1 - x0, y1 - y0, 0.01)), **look)
    return update


def _entity(update: Any, name: str, frame: str, time: float) -> Any:
    """Adds an entity that moves with its frame."""
    entity = update.entities.add(id=name, frame_id=frame, frame_locked=True)
    entity.timestamp.FromNanoseconds(stamp_of(time))
    return entity


def _add_shape(entity: Any, shape: Json) -> None:
    """Adds a shape of `plant_shapes` as Foxglove's primitive; a hull as its triangles."""
    size = np.asarray(shape["size"], float)
    look = _look(shape_pose(shape), shape["colour"])
    if shape["kind"] == "hull":
        corners = size[ConvexHull(size).simplices].reshape(-1, 3)
        entity.triangles.add(points=[_vector(corner) for corner in corners], **look)
    elif shape["kind"] == "box":
        entity.cubes.add(size=_vector(size), **look)
    elif shape["kind"] == "cylinder":
        diameter = 2.0 * size[0]
        widths = _vector((diameter, diameter, size[1]))
        entity.cylinders.add(bottom_scale=1.0, top_scale=1.0, size=widths, **look)
    else:
        entity.spheres.add(size=_vector(np.broadcast_to(2.0 * size, 3)), **look)


def _poses(
    logged: LoggedRun, bodies: dict[str, BodyIndex], plant_context: Context, time: float
) -> Any:
    """Makes the poses of the bodies in the world."""
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    message = FrameTransforms()
    for name, index in bodies.items():
        X_WB = logged.plant.EvalBodyPoseInWorld(plant_context, logged.plant.get_body(index))
        transform = message.transforms.add(
            parent_frame_id=WORLD_FRAME,
            child_frame_id=name,
            translation=_vector(X_WB.translation()),
            rotation=_quaternion(X_WB),
        )
        transform.timestamp.FromNanoseconds(stamp_of(time))
    return message


def _forces(arrows: list[ForceArrow], row: int, time: float) -> Any:
    """Makes the arrows of a row; removes an arrow that is too short."""
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

    update = SceneUpdate()
    for arrow in arrows:
        if not arrow.shown[row]:
            gone = update.deletions.add(id=arrow.name, type=SceneEntityDeletion.MATCHING_ID)
            gone.timestamp.FromNanoseconds(stamp_of(time))
            continue
        length = float(np.linalg.norm(arrow.lengths[row]))
        # Foxglove's arrows point along x.
        turn = RotationMatrix.MakeFromOneVector(arrow.lengths[row] / length, 0)
        look = _look(RigidTransform(turn, arrow.points[row]), arrow.colour)
        entity = _entity(update, arrow.name, WORLD_FRAME, time)
        entity.arrows.add(
            shaft_length=max(length - HEAD_LENGTH, 1e-3),
            shaft_diameter=2.0 * SHAFT_RADIUS,
            head_length=HEAD_LENGTH,
            head_diameter=2.0 * HEAD_RADIUS,
            **look,
        )
    return update


def _look(pose: RigidTransform, colour: Sequence[float]) -> Json:
    """Writes pose and colour of a primitive as its fields."""
    position = _vector(pose.translation())
    rgba = dict(zip("rgba", (*colour, 1.0), strict=True))
    return {"pose": {"position": position, "orientation": _quaternion(pose)}, "color": rgba}


def _vector(values: Any) -> dict[str, float]:
    """Writes three numbers as the fields of a vector."""
    return dict(zip("xyz", map(float, values), strict=True))


def _quaternion(pose: RigidTransform) -> dict[str, float]:
    """Writes a rotation as the fields of a quaternion."""
    return dict(zip("wxyz", pose.rotation().ToQuaternion().wxyz(), strict=True))
