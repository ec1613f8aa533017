"""A `TailGeometry` in Meshcat: arm, plates and half shells, section centres with their normals, axis."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from aerodima.workbench.plants.tail_geometry import Piece, Plate, TailGeometry
from aerodima.workbench.replay.viewer import open_meshcat

_ARM, _PLATE, _NORMAL = Rgba(0.16, 0.17, 0.20), Rgba(0.93, 0.74, 0.18), Rgba(0.0, 0.45, 0.70)
_PRESSURE, _MASS = Rgba(0.84, 0.37, 0.0), Rgba(0.0, 0.0, 0.0)
_ARROW = 0.1
"""Length of a normal, m."""
_ARC = 16
"""Facets of a half shell."""


def draw_tail(meshcat: Meshcat, geometry: TailGeometry, path: str = "/tail") -> None:
    """Draws a tail where the frame of `path` is, in the frame T of the geometry.

    Args:
        path: of Meshcat; what stood there is deleted.
    """
    meshcat.Delete(path)
    meshcat.SetLine(f"{path}/arm", np.asfortranarray(geometry.arm.points.T), 4.0, _ARM)
    for plate in geometry.plates:
        for number, piece in enumerate(plate.pieces):
            points, faces = _surface(plate, piece)
            meshcat.SetTriangleMesh(
                f"{path}/{plate.name}/{number}", np.asfortranarray(points.T), np.asfortranarray(faces.T), _PLATE
            )
        for number, layout in enumerate(plate.section_layouts()):
            centres = layout.p_BoSi_B
            ends = centres + _ARROW * np.asarray(layout.normal_B)
            meshcat.SetLineSegments(
                f"{path}/{plate.name}/normals_{number}", np.asfortranarray(centres.T), np.asfortranarray(ends.T),
                3.0, _NORMAL,
            )  # fmt: skip
    spots = {"pressure": (geometry.centre_of_pressure(), _PRESSURE), "mass": (np.array(geometry.inertial.com), _MASS)}
    for name, (place, colour) in spots.items():
        meshcat.SetObject(f"{path}/centre_of_{name}", Sphere(0.008), colour)
        meshcat.SetTransform(f"{path}/centre_of_{name}", RigidTransform(place))


def tail_page(geometry: TailGeometry) -> str:
    """The tail in Meshcat as one self-contained HTML page."""
    meshcat = open_meshcat(None)
    draw_tail(meshcat, geometry)
    middle = geometry.points.mean(axis=0)
    size = float(np.ptp(geometry.points, axis=0).max())
    meshcat.SetCameraPose(middle + size * np.array([0.9, -1.1, 0.4]), middle)
    return str(meshcat.StaticHtml())


def _surface(plate: Plate, piece: Piece) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Points (n, 3), m, and triangles (m, 3), seen from both sides, of a piece."""
    angles = np.linspace(0.0, math.pi, _ARC + 1) if plate.kind == "half_shell" else np.array([0.0, math.pi])
    round_off = plate.kind == "half_shell"
    offsets = np.outer(np.cos(angles), piece.across) + round_off * np.outer(np.sin(angles), piece.normal)
    near, far = (chord / 2 * offsets + piece.start for chord in piece.chords)
    points = np.vstack([near, far + piece.length * piece.axis])
    count = len(angles)
    faces = []
    for i in range(count - 1):
        square = [i, i + 1, count + i + 1, count + i]
        faces += [[square[0], square[1], square[2]], [square[0], square[2], square[3]]]
    both = np.array(faces + [face[::-1] for face in faces], dtype=np.int32)
    return points, both
