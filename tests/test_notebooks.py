"""Notebooks as they are stored: a story with the outputs of its code, small; `.ci/run` executes
them again.
"""

import ast
import base64
import io
import json
import re
from tempfile import gettempdir

import pytest
from PIL import Image

from tests.notebook_runs import (
    COLOURS,
    FOLDER,
    SIGNATURE,
    SOLUTION,
    cleaned,
    code_cells,
    differences,
    shown,
    signature,
    source,
)
from tests.notebook_runs import tags as tags_of

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


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_imports_only_public_names(path):
    code = [source(cell) for cell in code_cells(content(path)) if SOLUTION not in tags_of(cell)]
    text = "\n".join(
        line for cell in code for line in cell.splitlines() if not line.startswith("%")
    )
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            assert not any(part.startswith("_") for part in (node.module or "").split("."))
            assert not any(alias.name.startswith("_") for alias in node.names)


def picture():
    stream = io.BytesIO()
    Image.radial_gradient("L").save(stream, "PNG")
    return base64.b64encode(stream.getvalue()).decode()


def executed(**changes):
    """A notebook as nbclient leaves it: a slider with a picture, a page, a stream in two pieces, an
    address.
    """
    view = {
        "application/vnd.jupyter.widget-view+json": {"model_id": "box"},
        "text/plain": "interactive()",
    }
    drawn = {
        "output_type": "display_data",
        "metadata": {},
        "data": {"image/png": picture(), "text/plain": "<Figure>"},
    }
    pieces = [
        {"output_type": "stream", "name": "stdout", "text": text}
        for text in ("peak 1.", "50 rad\n")
    ]
    frame = {
        "text/html": "<iframe srcdoc='...'></iframe>",
        "text/plain": f"live at 0x7f00 in {gettempdir()}/tmpab12/x",
    }
    outputs = [
        {"output_type": "display_data", "metadata": {}, "data": view},
        *pieces,
        {"output_type": "execute_result", "execution_count": 7, "metadata": {}, "data": frame},
    ]
    state = {
        "box": {"state": {"children": ["IPY_MODEL_out"]}},
        "out": {"state": {"outputs": [drawn]}},
    }
    cell = {
        "cell_type": "code",
        "id": "a",
        "metadata": {"execution": {"x": 1}},
        "execution_count": 7,
    } | changes
    return {
        "cells": [{"source": ["sliders(f)"], "outputs": outputs, **cell}],
        "metadata": {"widgets": {"application/vnd.jupyter.widget-state+json": {"state": state}}},
    }


def test_what_is_stored_is_the_same_each_time():
    (cell,) = cleaned(executed())["cells"]
    slider, text, frame = cell["outputs"]
    assert set(slider["data"]) == {"image/png", "text/plain"}
    with Image.open(io.BytesIO(base64.b64decode(slider["data"]["image/png"]))) as stored:
        assert len(stored.getcolors()) <= COLOURS
    assert text["text"] == "peak 1.50 rad\n"
    assert frame["data"] == {"text/plain": "live in /tmp/folder/x"}
    assert cell["execution_count"] == frame["execution_count"] == 1


@pytest.mark.parametrize(
    ("changed", "seen"),
    [("1.505", False), ("1.6", True), ("1.5 1.5", True)],
)
def test_an_execution_that_gives_something_else_is_seen(changed, seen):
    stored = cleaned(executed())
    found = cleaned(executed())
    found["cells"][0]["outputs"][1]["text"] = f"peak {changed} rad\n"
    assert bool(differences(stored, found)) is seen
    stored["cells"][0]["metadata"]["tags"] = ["varies"]
    assert differences(stored, found) == []


def test_a_picture_that_is_gone_is_seen():
    stored = cleaned(executed())
    found = cleaned(executed())
    del found["cells"][0]["outputs"][0]
    assert differences(stored, found)
