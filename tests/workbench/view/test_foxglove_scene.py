"""A run in MCAP, read back with the classes of Foxglove's schemas: bodies, poses and forces are
those of the run.
"""

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.reader import make_reader
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.logs.exporters import export_log
from aerodima.workbench.view.foxglove_scene import (
    BODIES,
    FORCES,
    POSES,
    _add_shape,
    foxglove_scene,
)
from aerodima.workbench.view.logged_run import add_logged_run

CLASSES = {"foxglove.FrameTransforms": FrameTransforms, "foxglove.SceneUpdate": SceneUpdate}


@pytest.fixture(scope="module")
def exported(short_runs, tmp_path_factory):
    tailed = short_runs["swing"]
    (path,) = export_log(
        tailed, tmp_path_factory.mktemp("mcap") / "run.mcap", "mcap", scene=foxglove_scene(tailed)
    )
    return path


def messages(path, topic):
    """Time (s) and message, by the class that the file names."""
    found = []
    with open(path, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=[topic]):
            assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf")
            found.append((message.log_time * 1e-9, CLASSES[schema.name].FromString(message.data)))
    return found


def row_at(run, time):
    (row,) = np.flatnonzero(np.abs(run.time - time) < 1e-6)
    return int(row)


def test_poses_are_those_of_the_plant(tailed, exported):
    logged = add_logged_run(DiagramBuilder(), tailed)
    plant = logged.plant
    context = plant.CreateDefaultContext()
    poses = messages(exported, POSES)
    assert len(poses) == pytest.approx(50 * (tailed.time[-1] - tailed.time[0]), abs=2)
    for time, message in poses[:: len(poses) // 5]:
        logged.move(context, row_at(tailed, time))
        for name in ("chassis", "tail_rod"):
            (found,) = [
                transform for transform in message.transforms if transform.child_frame_id == name
            ]
            X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name))
            place = found.translation
            turn = found.rotation
            wanted = X_WB.rotation().ToQuaternion().wxyz()
            assert [place.x, place.y, place.z] == pytest.approx(X_WB.translation())
            assert [turn.w, turn.x, turn.y, turn.z] == pytest.approx(wanted)
            assert found.parent_frame_id == "world"


def test_a_hull_comes_as_triangles_about_its_middle():
    entity = SceneEntity()
    corners = [
        [0.0, 0.0, 0.0],
        [0.3, 0.0, 0.0],
        [0.0, 0.2, 0.0],
        [0.0, 0.0, 0.1],
        [0.05, 0.05, 0.01],
    ]  # one inside
    shape = {
        "body": "",
        "kind": "hull",
        "size": corners,
        "pose": [1, 0, 0, 0, 1, 2, 3],
        "colour": [1, 0, 0],
    }
    _add_shape(entity, shape)
    (hull,) = entity.triangles
    points = {(round(point.x, 6), round(point.y, 6), round(point.z, 6)) for point in hull.points}
    assert (len(hull.points), points) == (4 * 3, {tuple(corner) for corner in corners[:4]})
    assert (hull.pose.position.x, hull.pose.position.y, hull.pose.position.z) == (1.0, 2.0, 3.0)


def test_arrows_are_those_of_the_replay_and_go_when_the_force_does(tailed, exported):
    arrows = {arrow.name: arrow for arrow in add_logged_run(DiagramBuilder(), tailed).arrows}
    seen = 0
    for time, update in messages(exported, FORCES):
        row = row_at(tailed, time)
        shown = {name for name, arrow in arrows.items() if arrow.shown[row]}
        assert {entity.id for entity in update.entities} == shown
        assert {deletion.id for deletion in update.deletions} == set(arrows) - shown
        for entity in update.entities:
            (arrow,) = entity.arrows
            length = arrow.shaft_length + arrow.head_length
            along = rotation(arrow.pose.orientation) @ [length, 0.0, 0.0]
            wanted = arrows[entity.id].lengths[row]
            if np.linalg.norm(wanted) > 0.06:  # a shorter one is all head
                assert along == pytest.approx(wanted, abs=1e-6)
                seen += 1
    assert seen > 100


def rotation(turn):
    wxyz = np.array([turn.w, turn.x, turn.y, turn.z])
    return RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz))).matrix()


def test_every_body_is_drawn_once_in_its_own_frame(exported):
    ((_, update),) = messages(exported, BODIES)
    drawn = {entity.id: entity for entity in update.entities}
    assert all(
        entity.frame_id == entity.id and entity.frame_locked
        for name, entity in drawn.items()
        if name != "floor"
    )
    wheel = max(drawn["front_left_wheel"].cylinders, key=lambda cylinder: cylinder.size.x)
    assert 0.08 < wheel.size.x == wheel.size.y < 0.16, "m: a wheel of 1:10"
    axis = rotation(wheel.pose.orientation) @ [0.0, 0.0, 1.0]
    assert abs(axis) == pytest.approx([0.0, 1.0, 0.0], abs=1e-6)
