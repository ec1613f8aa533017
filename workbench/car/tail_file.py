"""Tails with a geometry of their own: their files, and their shapes in the SDF."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydrake.math import RollPitchYaw, RotationMatrix

from aerodima.workbench.aero.tail_geometry import SCHEMA, Plate, TailGeometry
from aerodima.workbench.aero.tail_pieces import Piece
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.sdf_model import SdfModel
from aerodima.workbench.core.yaml_files import checked, read_yaml

_ARM_COLOUR = "0.16 0.17 0.20 1"
"""Red, green, blue and opacity of the rod, from 0 to 1."""
_PLATE_COLOUR = "0.93 0.74 0.18 1"
"""Red, green, blue and opacity of the plates, from 0 to 1."""
_THIN = 0.002
"""Least drawn thickness of a plate, m."""
_HALF_CYLINDER = "package://aerodima_models/tail/half_cylinder.obj"
"""Mesh of a half cylinder of diameter and length 1, hollow towards +y, its opening in the plane
y = 0."""


def read_tail(path: str | Path) -> TailGeometry:
    """Reads a tail file.

    Raises:
        ModelError: no such file, a wrong key, value or unit, or an impossible tail; names the
            file.
    """
    place = Path(path)
    return checked(
        TailGeometry, read_yaml(place, ModelError), str(place), ModelError, schema=SCHEMA
    )


def write_tail(geometry: TailGeometry, path: str | Path, *, force: bool = False) -> Path:
    """Writes a tail file; reading it gives the same tail, to the last bit.

    Raises:
        ModelError: the file exists and `force` is not given.
    """
    content = geometry.model_dump(mode="json", by_alias=True, exclude_none=True)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return write_atomically(Path(path), text, force, ModelError)


def set_tail_shapes(model: SdfModel, geometry: TailGeometry, margin: float) -> list[str]:
    """Draws rod and plates, section by section, in place of the shapes of the model.

    Args:
        model: models/tail/tail.sdf; its links `tail_rod` and `tail_sail` have the frame T of the
            geometry.
        geometry: tail that is drawn.
        margin: radius of the spheres that feel the ground, m; they lie that far inside the outline.

    Returns:
        Names of these spheres, shapes of `tail_sail`: at the corners of plates, and at the tip of
        an arm without one.
    """
    for link in ("tail_rod", "tail_sail"):
        model.remove_shapes(link)
    points = geometry.arm.points
    for number, (near, far) in enumerate(pairwise(points)):
        length = float(np.linalg.norm(far - near))
        frame = RotationMatrix.MakeFromOneVector(far - near, 2).matrix()
        pose = _pose((near + far) / 2, frame)
        model.add_shape(
            "tail_rod",
            f"rod_{number}",
            pose,
            "cylinder",
            colour=_ARM_COLOUR,
            radius=geometry.arm.radius,
            length=length,
        )
    for plate in geometry.plates:
        for number, piece in enumerate(plate.pieces):
            _draw(model, plate, piece, f"{plate.name.replace(' ', '_')}_{number}")
    pieces = [piece for plate in geometry.plates for piece in plate.pieces]
    corners = [corner for plate in geometry.plates for corner in _corners(plate, margin)]
    if not any(_covers(piece, points[-1]) for piece in pieces):
        corners.append(points[-1])
    names = [f"tail_corner_{number}" for number in range(len(corners))]
    for name, corner in zip(names, corners, strict=True):
        model.add_shape("tail_sail", name, [*corner, 0.0, 0.0, 0.0], "sphere", radius=margin)
    return names


def _draw(model: SdfModel, plate: Plate, piece: Piece, name: str) -> None:
    """Draws each section as a box, or half a cylinder, with the width at its middle."""
    part = piece.length / plate.sections
    frame = np.column_stack([piece.across, piece.normal, piece.axis])
    if plate.kind == "half_shell":
        frame = np.column_stack([-piece.across, -piece.normal, piece.axis])
    for number in range(plate.sections):
        share = (number + 0.5) / plate.sections
        width = piece.chords[0] + share * (piece.chords[1] - piece.chords[0])
        pose = _pose(piece.start + share * piece.length * piece.axis, frame)
        shape = "box"
        size: dict[str, Any] = {"size": (width, max(plate.depth, _THIN), part)}
        if plate.kind == "half_shell":
            shape = "mesh"
            size = {"uri": _HALF_CYLINDER, "scale": (width, width, part)}
        model.add_shape("tail_sail", f"{name}_{number}", pose, shape, colour=_PLATE_COLOUR, **size)


def _corners(plate: Plate, margin: float) -> list[FloatArray]:
    """Returns the far corners of each piece in T, m, and the near ones of a first piece that
    narrows; all lie inside the outline.
    """
    corners = []
    for number, piece in enumerate(plate.pieces):
        near, far = piece.chords
        inset = min(margin, piece.length / 2)
        ends = [(far, piece.length - inset)]
        if number == 0 and near > far:
            ends.append((near, inset))
        for chord, along in ends:
            side = max(chord / 2 - margin, 0.0)
            corners += [
                piece.start + along * piece.axis + sign * side * piece.across
                for sign in (-1.0, 1.0)
            ]
    return corners


def _covers(piece: Piece, point: FloatArray) -> bool:
    """Returns whether a point in T lies on a piece, to a millimetre."""
    from_start = point - piece.start
    along = float(from_start @ piece.axis)
    across = float(from_start @ piece.across)
    off = float(from_start @ piece.normal)
    near, far = piece.chords
    width = near + (far - near) * min(max(along / piece.length, 0.0), 1.0)
    return -1e-3 < along < piece.length + 1e-3 and abs(across) < width / 2 and abs(off) < 1e-3


def _pose(position: FloatArray, frame: FloatArray) -> list[float]:
    return [*position.tolist(), *RollPitchYaw(RotationMatrix(frame)).vector().tolist()]
