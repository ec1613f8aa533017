"""Planform of a mesh (OBJ or STL): its outline seen along a normal, as a plate in straight pieces.

The mesh is cut across its axis at even distances; each cut gives the width and the middle of the outline there, and the
plate goes linearly from cut to cut. A hole in the outline, such as a gap between two sails, is not seen: the width of a
cut is that from its outermost points. Frame of the mesh: T (`tail_geometry.py`), in m.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.tail_plate import UP, Plate, Vector, as_tuple, unit_vector

_LARGEST = 10.0
"""m; a tail beyond that is a mesh in other units."""
_STL_HEADER = 84
_STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_EDGE = 1e-6
"""Share of the length by which the first and last cut lie inside the mesh, whose end may be an edge or a face."""


def planform_from_mesh(
    path: str | Path,
    density: float,
    *,
    name: str = "sail",
    axis: Vector = UP,
    normal: Vector = (0.0, -1.0, 0.0),
    pieces: int = 20,
    scale: float = 1.0,
    sections: int = 1,
) -> Plate:
    """A plate with the outline of a closed mesh.

    Args:
        path: OBJ or STL (text or binary).
        density: kg/m2 of the planform.
        axis, normal: directions in the mesh; its outline is seen along the normal, cuts are across the axis.
        pieces: straight pieces from end to end.
        scale: m per unit of the mesh; 0.001 for mm.
        sections: of each piece.

    Raises:
        ModelError: no such file, not a mesh, not closed, or too large for a tail; and as `Plate`.
    """
    place = Path(path)
    if not 1 <= pieces <= 1000:
        raise ModelError(f"{place}: {pieces} pieces; allowed: 1 to 1000")
    corners = scale * _triangles(place)
    _require_closed(place, corners)
    along = unit_vector(axis)
    facing = np.asarray(normal, float) - (np.asarray(normal, float) @ along) * along
    if np.linalg.norm(facing) < 1e-3:
        raise ModelError(f"{place}: normal {normal} runs along the axis {axis}; allowed: across it")
    across = np.cross(unit_vector(facing), along)
    heights, sides = corners @ along, corners @ across
    low, high = float(heights.min()), float(heights.max())
    if not 1e-4 < high - low < _LARGEST:
        raise ModelError(
            f"{place}: {high - low:g} m long; allowed: 0.1 mm to {_LARGEST:g} m (a mesh in mm: scale 0.001)"
        )
    margin = _EDGE * (high - low)
    cuts = np.linspace(low, high, pieces + 1)
    spans = np.array([_span(heights, sides, cut) for cut in np.clip(cuts, low + margin, high - margin)])
    chords, middles = spans[:, 1] - spans[:, 0], spans.mean(axis=1)
    depth = _depth(corners @ unit_vector(facing))
    spine = np.outer(cuts, along) + np.outer(middles, across) + depth * unit_vector(facing)
    steps = np.diff(spine, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    straight = np.allclose(steps / lengths[:, None], along, atol=1e-9)
    lean = steps @ along / lengths  # a swept piece is narrower across itself than across the axis
    chords = chords * np.concatenate([lean[:1], (lean[:-1] + lean[1:]) / 2, lean[-1:]])
    return Plate(
        name=name,
        root=as_tuple(spine[0]),
        lengths=tuple(lengths.tolist()),
        chords=tuple(np.maximum(chords, 1e-9).tolist()),
        normal=as_tuple(unit_vector(facing)),
        density=density,
        axes=(as_tuple(along),) if straight else tuple(as_tuple(step) for step in steps / lengths[:, None]),
        sections=sections,
    )


def _span(heights: np.ndarray, sides: np.ndarray, cut: float) -> tuple[float, float]:
    """Outermost points of the cut through the triangles (n, 3) at a height."""
    found = []
    for one, other in ((0, 1), (1, 2), (2, 0)):
        below, above = heights[:, one], heights[:, other]
        through = (below - cut) * (above - cut) <= 0.0
        through &= below != above
        share = (cut - below[through]) / (above[through] - below[through])
        found.append(sides[through, one] + share * (sides[through, other] - sides[through, one]))
    points = np.concatenate(found)
    return float(points.min()), float(points.max())


def _depth(places: np.ndarray) -> float:
    """Middle of the mesh along the normal, m: where the plate stands."""
    return float(places.min() + places.max()) / 2


def _triangles(path: Path) -> np.ndarray:
    """Corners of the triangles (n, 3, 3), in units of the file."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise ModelError(f"{path}: no such file") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error}") from None
    kind = path.suffix.lower()
    if kind not in (".obj", ".stl"):
        raise ModelError(f"{path}: ending {path.suffix!r}; allowed: .obj, .stl")
    try:
        triangles = _obj(data.decode("utf-8", "replace")) if kind == ".obj" else _stl(data)
    except (ValueError, IndexError):
        raise ModelError(f"{path}: not a mesh: a line is no {kind[1:].upper()}") from None
    if not len(triangles) or not np.all(np.isfinite(triangles)):
        raise ModelError(f"{path}: not a mesh: it holds no triangles of finite numbers")
    return triangles


def _obj(text: str) -> np.ndarray:
    points: list[list[float]] = []
    faces: list[list[int]] = []
    for line in text.splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append([float(value) for value in rest[:3]])
        elif word == "f":
            numbers = [int(value.split("/")[0]) for value in rest]
            corners = [n - 1 if n > 0 else len(points) + n for n in numbers]
            faces += [[corners[0], *pair] for pair in pairwise(corners[1:])]
    return np.array(points, float).reshape(-1, 3)[np.array(faces, int).reshape(-1, 3)]


def _stl(data: bytes) -> np.ndarray:
    count = int.from_bytes(data[80:_STL_HEADER], "little")
    if len(data) == _STL_HEADER + count * _STL_RECORD.itemsize:
        return np.frombuffer(data, _STL_RECORD, count, _STL_HEADER)["corners"].astype(float)
    words = [line.split() for line in data.decode("ascii", "replace").splitlines()]
    points = [[float(value) for value in line[1:]] for line in words if line and line[0] == "vertex"]
    return np.array(points, float).reshape(-1, 3, 3)


def _require_closed(path: Path, corners: np.ndarray) -> None:
    """Each edge must belong to two triangles; corners at the same place, to a millionth of the size, are one."""
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    _, numbers = np.unique(np.round(corners.reshape(-1, 3) / (1e-6 * size)), axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    edges = np.sort(np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, counts = np.unique(edges, axis=0, return_counts=True)
    open_edges = int(np.sum(counts % 2))
    if open_edges:
        raise ModelError(
            f"{path}: the mesh is not closed: {open_edges} of {len(counts)} edges belong to one triangle only; "
            "allowed: a closed surface"
        )
