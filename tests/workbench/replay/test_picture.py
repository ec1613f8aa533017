"""The camera sees left on the left, up above, near before far; the sun throws a shadow on the floor."""

from __future__ import annotations

import numpy as np
import pytest

from aerodima.workbench.replay.picture import Camera, draw_picture

RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def along_x() -> Camera:
    """Looks along x from 4 m behind and 2 m above the origin's floor, horizontally."""
    return Camera(np.array([-4.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]), focal_length=100.0, width=120, height=100)


def upright_square(x: float, side: float, y: float = 0.0, z: float = 2.0) -> np.ndarray:
    """Two triangles in the plane of a given x, about (x, y, z)."""
    half = side / 2
    a, b, c, d = ([x, y + u * half, z + v * half] for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]])


def reddish(picture: np.ndarray) -> np.ndarray:
    return picture[..., 0] > picture[..., 1] + 0.3


def test_point_ahead_is_in_the_middle_left_is_left_and_up_is_up() -> None:
    column, row, inverse_depth = along_x().project(np.array([0.0, 0.0, 2.0]))
    assert (column, row, inverse_depth) == pytest.approx((60.0, 50.0, 0.25))
    column, row, _ = along_x().project(np.array([0.0, 1.0, 2.4]))  # 1 m to the left, 0.4 m up, 4 m away
    assert (column, row) == pytest.approx((60.0 - 25.0, 50.0 - 10.0))


def test_square_has_the_size_of_its_projection() -> None:
    picture = draw_picture(along_x(), upright_square(0.0, 1.0), np.array([RED, RED]))
    rows, columns = np.nonzero(reddish(picture))
    assert (rows.min(), rows.max()) == (37, 62)  # 25 pixels about row 50, the outermost half covered
    assert (columns.min(), columns.max()) == (47, 72)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_near_square_hides_the_far_one_in_either_order(order: tuple[int, int]) -> None:
    squares = [upright_square(0.0, 1.0), upright_square(-1.0, 0.3)]
    colours = [[RED, RED], [GREEN, GREEN]]
    triangles = np.concatenate([squares[i] for i in order])
    picture = draw_picture(along_x(), triangles, np.concatenate([colours[i] for i in order]))
    assert picture[50, 60, 1] > picture[50, 60, 0]
    assert reddish(picture)[50, 50]


def test_squares_that_cross_hide_each_other_in_part() -> None:
    tilted = upright_square(0.0, 1.0)
    tilted[..., 0] += tilted[..., 1]  # its left edge is farther, its right edge nearer than the other one
    picture = draw_picture(
        along_x(), np.concatenate([upright_square(0.0, 1.0), tilted]), np.array([RED, RED, GREEN, GREEN])
    )
    assert reddish(picture)[50, 52]
    assert not reddish(picture)[50, 66]


def test_floor_hides_what_is_below_it() -> None:
    camera = Camera(np.array([-4.0, 0.0, 3.0]), np.zeros(3), focal_length=100.0, width=120, height=100)
    picture = draw_picture(camera, upright_square(0.0, 1.0, z=-0.6), np.array([RED, RED]))
    assert not reddish(picture).any()


def test_shadow_lies_away_from_the_sun_which_stands_to_the_right_and_near() -> None:
    camera = Camera(np.array([-4.0, 0.0, 4.0]), np.zeros(3), focal_length=100.0, width=120, height=100)
    plate = np.array([[[-0.3, -0.3, 1.0], [0.3, -0.3, 1.0], [0.3, 0.3, 1.0]]])
    empty = draw_picture(camera, np.zeros((0, 3, 3)), np.zeros((0, 3)))
    picture = draw_picture(camera, plate, np.array([RED]))
    darker = (picture.sum(axis=-1) < 0.85 * empty.sum(axis=-1)) & ~reddish(picture)
    # Along the sun's rays from the plate's centre to the floor: 0.35 m away from the camera and 0.25 m to the left.
    column, row, _ = camera.project(np.array([0.1 + 0.35, -0.1 + 0.25, 0.0]))
    rows, columns = np.nonzero(darker)
    assert (columns.mean(), rows.mean()) == pytest.approx((column, row), abs=2.5)  # part of it is behind the plate
    assert 20 < rows.size < 60  # 0.18 m2, seen from 5.7 m at 45 degrees: 40 pixels
    untouched = ~darker & ~reddish(picture)
    assert np.abs(picture - empty)[untouched].mean() < 0.01


def test_triangle_behind_or_beside_the_picture_changes_nothing() -> None:
    empty = draw_picture(along_x(), np.zeros((0, 3, 3)), np.zeros((0, 3)))
    beside = upright_square(0.0, 1.0, y=50.0)
    assert np.array_equal(draw_picture(along_x(), beside, np.array([RED, RED])), empty)
