"""Notebooks as they are stored: a story with the outputs of its code, small; `.ci/run` executes
them again.
"""

import json
import re

import pytest

from tests.notebook_runs import (
    FOLDER,
    SIGNATURE,
    code_cells,
    definitions,
    differences,
    shown,
    signature,
    tags,
)

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST, TOGETHER = 1_000_000, 5_000_000
"""Bytes of a notebook, and of all."""


def content(path):
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_those_of_the_code(path):
    notebook = content(path)
    assert notebook["metadata"].get(SIGNATURE) == signature(notebook), (
        f"{path.name}: run `make notebooks`"
    )
    cells = code_cells(notebook)
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert [
        output for cell in cells for output in cell["outputs"] if output["output_type"] == "error"
    ] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_outputs_are_small_and_of_no_machine(path):
    assert path.stat().st_size <= LARGEST
    assert sum(one.stat().st_size for one in NOTEBOOKS) <= TOGETHER
    pictures = 0
    for cell in code_cells(content(path)):
        pictures += "image/" in shown(cell)
        for output in cell["outputs"]:
            kinds = set(output.get("data", {}))
            assert kinds <= {"image/png", "image/svg+xml", "text/html", "text/plain"}, kinds
            text = json.dumps(
                {
                    **output,
                    "data": {k: v for k, v in output.get("data", {}).items() if k != "image/png"},
                }
            )
            assert not re.search(r"<iframe|<script| at 0x|/home/|/tmp/tmp|/work/", text), cell["id"]
    assert pictures >= 3


def test_stored_swerves_of_the_emulated_car_keep_their_band():
    path = FOLDER / "06_from_simulation_to_the_car.ipynb"
    (stored,) = (cell for cell in code_cells(content(path)) if "comparison" in tags(cell))
    names = {}
    exec(definitions(path), names)
    lines = shown(stored).splitlines()
    rounding = 0.0015  # of three numbers with three decimals
    for name, band in names["BAND"].items():
        (line,) = (line for line in lines if line.startswith(name))
        simulated, emulated, difference, stored_band = map(float, line.split()[-4:])
        assert stored_band == band
        assert abs(emulated - simulated) <= difference + rounding, line
        assert difference <= band, line


@pytest.mark.parametrize(
    ("changed", "seen"),
    [("1.505", False), ("1.6", True), ("1.5 1.5", True)],
)
def test_an_execution_that_gives_something_else_is_seen(changed, seen):
    def notebook(number, *tags):
        output = {"output_type": "stream", "name": "stdout", "text": f"peak {number} rad\n"}
        cell = {"cell_type": "code", "metadata": {"tags": tags}, "outputs": [output]}
        return {"cells": [cell]}

    assert bool(differences(notebook("1.50"), notebook(changed))) is seen
    assert differences(notebook("1.50", "varies"), notebook(changed)) == []
