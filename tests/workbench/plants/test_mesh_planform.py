"""Planform of a mesh: area and centre of known outlines, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from aerodima.workbench.errors import ModelError
from aerodima.workbench.plants.mesh_planform import planform_from_mesh

CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (-1, 1) for x in (-1, 1)], float)
FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def prism(near: float, far: float, sweep: float = 0.0) -> np.ndarray:
    """Corners of a prism 0.4 m high on z = 0.3, 0.02 m deep along y, as wide along x as said at its ends."""
    x, y, z = CORNERS.T
    width = np.where(z == 0, near, far)
    return np.column_stack([x * width / 2 + sweep * z, 0.01 * y, 0.3 + 0.4 * z])


def obj(path: Path, corners: np.ndarray, faces=FACES) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    path.write_text("\n".join(lines + ["f " + " ".join(str(i + 1) for i in face) for face in faces]))
    return path


def triangles(corners: np.ndarray) -> np.ndarray:
    return np.array([corners[[f[0], *pair]] for f in FACES for pair in ((f[1], f[2]), (f[2], f[3]))])


def binary_stl(path: Path, corners: np.ndarray) -> Path:
    record = np.zeros(12, np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    record["c"] = triangles(corners)
    path.write_bytes(b"\0" * 80 + (12).to_bytes(4, "little") + record.tobytes())
    return path


def text_stl(path: Path, corners: np.ndarray) -> Path:
    facets = [
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet\n"
        for t in triangles(corners).tolist()
    ]
    path.write_text("solid s\n" + "".join(facets) + "endsolid s\n")
    return path


@pytest.mark.parametrize(("write", "name"), [(obj, "m.obj"), (binary_stl, "m.stl"), (text_stl, "m.stl")])
def test_outline_of_a_tapered_prism_is_its_trapezoid(tmp_path: Path, write, name: str) -> None:
    found = planform_from_mesh(write(tmp_path / name, prism(0.2, 0.1)), 0.5)
    assert found.area == pytest.approx(0.4 * 0.15, rel=1e-5)  # cuts lie a millionth inside; STL has single precision
    np.testing.assert_allclose(found.centre_of_pressure, [0, 0, 0.3 + 0.4 * (0.2 + 0.2) / (3 * 0.3)], atol=1e-5)
    assert found.moments.mass == pytest.approx(0.5 * 0.06, rel=1e-5)


def test_swept_outline_keeps_its_area_and_centre(tmp_path: Path) -> None:
    found = planform_from_mesh(obj(tmp_path / "m.obj", prism(0.2, 0.2, sweep=0.3)), 0.5, pieces=8)
    assert found.area == pytest.approx(0.08, rel=1e-5)
    np.testing.assert_allclose(found.centre_of_pressure, [0.15, 0, 0.5], atol=1e-5)


def test_mesh_in_millimetres_is_scaled(tmp_path: Path) -> None:
    path = obj(tmp_path / "m.obj", 1000 * prism(0.2, 0.1))
    with pytest.raises(ModelError, match=r"400 m long; allowed: .*scale 0\.001"):
        planform_from_mesh(path, 0.5)
    assert planform_from_mesh(path, 0.5, scale=0.001).area == pytest.approx(0.06, rel=1e-5)


def test_what_is_no_closed_mesh_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="the mesh is not closed: 4 of 17 edges"):
        planform_from_mesh(obj(tmp_path / "open.obj", prism(0.2, 0.1), FACES[1:]), 0.5)
    (tmp_path / "words.obj").write_text("v one two three")
    for name, words in (
        ("words.obj", "not a mesh: a line is no OBJ"),
        ("missing.obj", "no such file"),
        ("sail.step", "ending '.step'"),
    ):
        (tmp_path / "sail.step").touch()
        with pytest.raises(ModelError, match=words):
            planform_from_mesh(tmp_path / name, 0.5)
    whole = obj(tmp_path / "m.obj", prism(0.2, 0.1))
    with pytest.raises(ModelError, match="runs along the axis"):
        planform_from_mesh(whole, 0.5, normal=(0.0, 0.0, 1.0))
    with pytest.raises(ModelError, match="density is 0 kg/m2"):
        planform_from_mesh(whole, 0.0)
