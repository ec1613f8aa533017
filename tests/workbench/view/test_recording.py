"""What is recorded: frames, arrows whose points are where the forces say, a world that moves under
the camera.
"""

from functools import partial

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.view.force_arrows import ForceArrow
from aerodima.workbench.view.logged_run import add_logged_run
from aerodima.workbench.view.recording import (
    FRAMES_PER_SECOND,
    MAX_FRAMES,
    _draw_arrow,
    _follow,
    frame_rows,
    record_run,
)
from tests.refusals import assert_refused
from tests.workbench.view.shown_calls import ShownCalls


def test_frames_are_the_nearest_rows_from_first_to_last():
    time = np.array([1.0, 1.011, 1.019, 1.031, 1.04])
    rows, frames_per_second = frame_rows(time, 1.0)
    assert rows.tolist() == [0, 2, 4]  # 1.00, 1.02, 1.04 s
    assert frames_per_second == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("length", "rate", "frames", "expected"),
    [
        (4.0, 0.25, 4 * 4 * 50, FRAMES_PER_SECOND),
        (600.0, 1.0, MAX_FRAMES, MAX_FRAMES / 600.0),
    ],
    ids=["slow motion: more frames", "a long replay: fewer a second"],
)
def test_replay_keeps_its_length(length, rate, frames, expected):
    rows, frames_per_second = frame_rows(np.arange(0.0, length + 1e-6, 0.002), rate)
    assert len(rows) == frames + 1
    assert frames_per_second == pytest.approx(expected)


@pytest.mark.parametrize("rate", [0.0, -1.0, 50.0, float("nan")])
def test_rate_out_of_range_is_refused(tailed, rate):
    work = partial(record_run, tailed, None, rate)
    assert_refused(work, UserError, "--rate", f"{rate:g}", "0.02", "20")


def test_point_of_an_arrow_is_force_times_scale_from_its_foot():
    points = np.array([[1.0, 2.0, 0.0], [1.5, 2.0, 0.0], [2.0, 2.0, 0.0]])
    lengths = np.array([[0.1, -0.2, 0.3], [0.0, 0.0, 0.0], [0.0, 0.4, 0.0]])
    tracks = ShownCalls()
    arrow = ForceArrow("wind", (1.0, 0.0, 0.0), points, lengths)
    _draw_arrow(tracks, tracks, arrow, np.arange(3))
    path = "/drake/forces/wind"
    for frame in (0, 2):
        X_WA = tracks.frames[path][frame]
        shaft = tracks.frames[f"{path}/shaft", "scale"][frame][2]
        X_AH = tracks.frames[f"{path}/head"][frame]
        X_AS = tracks.frames[f"{path}/shaft"][frame]
        assert X_WA.multiply(X_AH.translation()) == pytest.approx(points[frame] + lengths[frame])
        foot = X_WA.multiply(X_AS.multiply(np.array([0.0, 0.0, -shaft / 2])))
        assert foot == pytest.approx(points[frame], abs=1e-12)
        # The head is a cone that opens along its own z: back towards the foot.
        assert X_WA.rotation().multiply(X_AH.rotation()).matrix()[:, 2] @ lengths[frame] < 0
    assert tracks.frames[path, "visible"] == {0: True, 1: False, 2: True}


def test_world_moves_so_that_the_car_stays_in_view(tailed):
    logged = add_logged_run(DiagramBuilder(), tailed)
    tracks = ShownCalls()
    rows = np.array([0, 100, len(tailed.time) - 1])
    _follow(tracks, tracks, logged, rows)
    com = tailed.vector("com", "truth_m")
    for frame, row in enumerate(rows):
        shown = tracks.frames["/drake"][frame].multiply(com[row])
        assert np.linalg.norm(shown[:2]) < 0.1  # smoothed: the car moves a little in the picture
        assert shown[2] == pytest.approx(com[row, 2])  # the floor stays where it is
    position, target = tracks.camera
    assert position[0] > 1.0  # ahead of a car that heads along x
    assert position[1] < 0.0  # outside of a left turn: right
    assert target[2] > 0.0
