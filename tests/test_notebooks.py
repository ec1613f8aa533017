"""Notebooks as they are stored: a story without outputs. `.ci/run` executes them."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def content(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def source(cell: dict[str, Any]) -> str:
    return "".join(cell["source"])


def test_seven_notebooks_are_numbered_from_01_without_a_gap() -> None:
    numbers = [int(re.match(r"(\d\d)_[a-z_]+$", path.stem)[1]) for path in NOTEBOOKS]
    assert numbers == [1, 2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path: Path) -> None:
    for cell in content(path)["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], f"{path.name}: clear the outputs before committing"
            assert cell["execution_count"] is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_begins_with_its_number_and_title(path: Path) -> None:
    first = content(path)["cells"][0]
    assert first["cell_type"] == "markdown"
    assert source(first).startswith(f"# {int(path.stem[:2])}. ")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_short_and_imports_only_public_names(path: Path) -> None:
    code = [source(cell) for cell in content(path)["cells"] if cell["cell_type"] == "code"]
    text = "\n".join(line for cell in code for line in cell.splitlines() if not line.startswith("%"))
    assert len(text.splitlines()) <= 120
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            assert not any(part.startswith("_") for part in (node.module or "").split("."))
            assert not any(alias.name.startswith("_") for alias in node.names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_axes_of_the_notebooks_own_plots_are_labelled(path: Path) -> None:
    for cell in content(path)["cells"]:
        if cell["cell_type"] == "code" and "plt.subplots" in source(cell):
            assert "xlabel" in source(cell), source(cell)
            assert "ylabel" in source(cell), source(cell)
