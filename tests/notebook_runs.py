"""Executes notebooks and stores what they show: `python -m tests.notebook_runs [--check] NOTEBOOK
...`.

What is stored is as far as possible the same each time: counters begin at 1, pictures have at most
128 colours, a slider stands as what it shows at its start, a live page as its line. `--check`
writes nothing and complains where an execution gives something else than what is stored, but for
cells tagged `varies`.
"""

import argparse
import base64
import hashlib
import io
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.code_measure import ROOT

FOLDER = ROOT / "notebooks"
SIGNATURE = "executed"
"""Key of the notebook's metadata: hash of the code that made the outputs."""
VARIES = "varies"
"""Tag of cells whose output depends on the machine."""
DEFINITION = "definition"
"""Tag of cells that tests of what a notebook shows run as well."""
COLOURS = 128
SILENCE = 400
"""Longest time of a cell, s."""
TOLERANCE = 0.01
"""Relative, of numbers in texts: other processors round other ways, and a run carries that on."""
_STARTUP = """import warnings
for kind in (DeprecationWarning, FutureWarning):
    warnings.simplefilter("error", kind)
"""
_WIDGET, _STATE = (
    "application/vnd.jupyter.widget-view+json",
    "application/vnd.jupyter.widget-state+json",
)
_NUMBER = re.compile(r"[-−+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")

Cell = dict[str, Any]


def source(cell):
    """Text of a cell."""
    return "".join(cell["source"])


def code_cells(notebook):
    """In the order of the story."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def signature(notebook):
    """Hash of the code."""
    return hashlib.sha256(
        "\0".join(source(cell) for cell in code_cells(notebook)).encode()
    ).hexdigest()[:16]


def tags(cell):
    """Of a cell."""
    return list(cell["metadata"].get("tags", ()))


def definitions(path):
    """Python of the cells of a notebook that are tagged as definitions."""
    cells = code_cells(json.loads(path.read_text(encoding="utf-8")))
    lines = [
        line
        for cell in cells
        if DEFINITION in tags(cell)
        for line in source(cell).splitlines()
        if not line.startswith("%")
    ]
    return "\n".join(lines) + "\n"


def text_of(value):
    """A text as a notebook holds it: whole, or by lines."""
    return value if isinstance(value, str) else "".join(value)


def execute(path):
    """The notebook with fresh outputs, ready to be stored; deprecation warnings are errors from the
    first cell on.
    """
    try:
        return _executed(path)
    # Seen twice in sixteen executions on a busy machine: the kernel waits, and the client too.
    except TimeoutError:
        print(f"{path.name}: nothing came from the kernel for {SILENCE} s; once more")
        return _executed(path)


def _executed(path):
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as profile:
        startup = Path(profile) / "profile_default" / "startup"
        startup.mkdir(parents=True)
        (startup / "00-deprecations.py").write_text(_STARTUP, encoding="utf-8")
        os.environ["IPYTHONDIR"] = profile
        NotebookClient(
            notebook,
            timeout=SILENCE,
            kernel_name="python3",
            resources={"metadata": {"path": profile}},
        ).execute()
    return cleaned(json.loads(nbformat.writes(notebook)))


def cleaned(notebook):
    """Without what differs from one execution to the next, and with small pictures."""
    widgets = notebook["metadata"].pop("widgets", {}).get(_STATE, {}).get("state", {})
    for number, cell in enumerate(code_cells(notebook), start=1):
        cell["execution_count"] = number
        cell["metadata"].pop("execution", None)
        outputs = []
        for output in _without_widgets(cell["outputs"], widgets):
            _add(outputs, _stable(output, number))
        cell["outputs"] = outputs
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook["metadata"] = {
        "kernelspec": kernel,
        "language_info": {"name": "python"},
        SIGNATURE: signature(notebook),
    }
    return notebook


def _without_widgets(outputs, widgets):
    """What the sliders of an output show in their place."""
    found = []
    for output in outputs:
        view = output.get("data", {}).get(_WIDGET)
        if view is None:
            found.append(output)
            continue
        children = widgets[view["model_id"]]["state"]["children"]
        for child in (widgets[name.removeprefix("IPY_MODEL_")] for name in children):
            found += child["state"].get("outputs", [])
    return found


def _stable(output, number):
    if output["output_type"] == "stream":
        return output | {"text": _plain(text_of(output["text"]))}
    data = {kind: text_of(value) for kind, value in output["data"].items() if kind != _WIDGET}
    if "<iframe" in data.get("text/html", ""):
        del data["text/html"]
    for kind in ("text/plain", "text/html"):
        if kind in data:
            data[kind] = _plain(data[kind])
    if "image/png" in data:
        data["image/png"] = _small(data["image/png"])
    if any(kind.startswith("image/") for kind in data):
        data["text/plain"] = "picture"
    counted = {"execution_count": number} if output["output_type"] == "execute_result" else {}
    return {"output_type": output["output_type"], "metadata": {}, "data": data} | counted


def _add(outputs, output):
    """Lines of one stream that follow one another are one output."""
    last = outputs[-1] if outputs else {}
    if output["output_type"] == "stream" and last.get("name") == output["name"]:
        last["text"] += output["text"]
    else:
        outputs.append(output)


def _plain(text):
    """Without addresses in memory and names of temporary folders."""
    text = re.sub(re.escape(tempfile.gettempdir()) + r"/\w+", "/tmp/folder", text)
    return re.sub(r" at 0x[0-9a-f]+", "", text)


def _small(png):
    from PIL import Image

    stream = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(png))) as picture:
        picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
            stream, "PNG", optimize=True
        )
    return base64.b64encode(stream.getvalue()).decode()


def differences(stored, found):
    """Cells whose execution gave something else than what is stored: kinds, words, or numbers
    beyond the tolerance.
    """
    complaints = []
    for number, (old, new) in enumerate(
        zip(code_cells(stored), code_cells(found), strict=True), start=1
    ):
        if VARIES not in tags(old) and not _alike(shown(old), shown(new)):
            complaints.append(
                f"cell [{number}]:\n--- stored\n{shown(old)}\n--- executed\n{shown(new)}"
            )
    return complaints


def shown(cell):
    """Outputs of a cell as text, pictures as their kind."""
    lines = []
    for output in cell["outputs"]:
        if output["output_type"] == "stream":
            lines.append(text_of(output["text"]))
        else:
            kinds = " ".join(sorted(output["data"]))
            lines.append(f"{kinds}\n{text_of(output['data'].get('text/plain', ''))}")
    return "\n".join(lines)


def _alike(old, new):
    if _NUMBER.sub("#", old).split() != _NUMBER.sub("#", new).split():
        return False
    pairs = zip(
        _NUMBER.findall(old.replace("−", "-")), _NUMBER.findall(new.replace("−", "-")), strict=True
    )
    return all(abs(float(a) - float(b)) <= TOLERANCE * max(abs(float(a)), 0.1) for a, b in pairs)


def main(arguments=None):
    """Status of the program: 1 when a stored notebook is not what an execution gives."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("notebooks", nargs="*", type=Path, help="all when none is named")
    parser.add_argument(
        "--check", action="store_true", help="compare with what is stored, write nothing"
    )
    asked = parser.parse_args(arguments)
    status = 0
    for path in asked.notebooks or sorted(FOLDER.glob("*.ipynb")):
        found = execute(path)
        if asked.check:
            for complaint in differences(json.loads(path.read_text(encoding="utf-8")), found):
                print(f"{path.name}: {complaint}")
                status = 1
        else:
            path.write_text(
                json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
            )
            print(f"stored {path.name}: {path.stat().st_size / 1000:.0f} kB")
    return status


if __name__ == "__main__":
    sys.exit(main())
