"""Shapes as triangles: sizes, axes, and the car that they make."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.errors import ModelError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.logged_car import add_logged_car
from aerodima.workbench.replay.picture import posed_triangles, shape_triangles, visible_surfaces


def volume(triangles: np.ndarray) -> float:
    """Of a closed surface whose triangles all turn the same way."""
    return float(np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6)


@pytest.mark.parametrize(
    ("shape", "size", "exact"),
    [
        (Box(0.2, 0.4, 0.6), (0.2, 0.4, 0.6), 0.048),
        (Cylinder(0.5, 0.3), (1.0, 1.0, 0.3), np.pi * 0.25 * 0.3),
        (Ellipsoid(0.1, 0.2, 0.3), (0.2, 0.4, 0.6), 4 / 3 * np.pi * 0.006),
        (Sphere(0.4), (0.8, 0.8, 0.8), 4 / 3 * np.pi * 0.064),
    ],
)
def test_surface_is_closed_and_has_the_size_of_the_shape(shape: Shape, size: tuple, exact: float) -> None:
    triangles = shape_triangles(shape, "thing")
    extent = np.ptp(triangles.reshape(-1, 3), axis=0)
    assert extent == pytest.approx(np.array(size), rel=1e-6)
    # A circle of 28 corners has 0.8 % less area than the round one, a sphere of 28 x 14 about 2.5 % less volume.
    assert abs(volume(triangles)) == pytest.approx(exact, rel=0.03)


def test_shape_that_cannot_be_drawn_is_named() -> None:
    with pytest.raises(ModelError, match="'blob': a Capsule cannot be drawn"):
        shape_triangles(Capsule(0.1, 0.2), "blob")


def test_wheels_turn_about_y_and_the_resting_tail_points_inside(tailed: RunLog) -> None:
    logged = add_logged_car(DiagramBuilder(), tailed)
    surfaces = visible_surfaces(logged.car)
    wheel = [surface for surface in surfaces if surface.body.name() == "front_left_wheel"]
    tread = max(wheel, key=lambda surface: np.ptp(surface.triangles[..., 0]))
    extent = np.ptp(tread.triangles.reshape(-1, 3), axis=0)
    car = logged.scenario.car
    assert extent == pytest.approx([2 * car.tyre_radius, car.tyre_width, 2 * car.tyre_radius], rel=1e-4)

    plant = logged.car.plant
    context = plant.CreateDefaultContext()
    logged.move(context, 0)
    sail = [surface for surface in surfaces if surface.body.name() in ("tail_sail", "tail_rod")]
    corners, _ = posed_triangles(sail, plant, context)
    assert corners[..., 1].max() == pytest.approx(logged.scenario.tail.length, abs=0.01)  # left, inside of a left turn
    assert corners[..., 1].min() > -0.02


def test_colours_are_those_of_the_model(tailed: RunLog) -> None:
    logged = add_logged_car(DiagramBuilder(), tailed)
    sail, _board = [surface for surface in visible_surfaces(logged.car) if surface.body.name() == "tail_sail"]
    assert sail.colour == pytest.approx((0.93, 0.74, 0.18))
