"""The notebooks as pages, with the outputs that they are stored with; made when the documentation
is built.
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

NOTEBOOKS = sorted((Path(__file__).resolve().parent.parent / "notebooks").glob("*.ipynb"))
_PICTURES = {"image/png": "png", "image/svg+xml": "svg"}
_STYLE = re.compile(r"<style.*?</style>", re.DOTALL)
_PANDAS = '<table border="1" class="dataframe">'
"""Material for MkDocs gives its look to tables without a class."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages with their pictures, and names them in the navigation."""
    from mkdocs.structure.files import File

    for path in NOTEBOOKS:
        for name, content in page(path).items():
            files.append(File.generated(config, name, content=content))
    for entry in config.nav or []:
        if entry.get("Notebooks") == "notebooks/":
            entry["Notebooks"] = [f"notebooks/{path.stem}.md" for path in NOTEBOOKS]
    return files


def page(path: Path) -> dict[str, str | bytes]:
    """Name of each file and its content: the page in Markdown, and its pictures."""
    made: dict[str, str | bytes] = {}
    lines = []
    for place, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines.append(text)
            continue
        solution = "solution" in cell["metadata"].get("tags", ())
        block = [_fenced(text, "python")]
        for number, output in enumerate(cell["outputs"]):
            block.append(
                _output(
                    output, f"notebooks/{path.stem}_{place}_{number}", made, tables=not solution
                )
            )
        lines.append(_folded("\n\n".join(block)) if solution else "\n\n".join(block))
    opened = (
        f"`notebooks/{path.name}`, as it was stored; `jupyter lab notebooks` opens it, and "
        "the live parts with it."
    )
    title, _, rest = lines[0].partition("\n")
    made[f"notebooks/{path.stem}.md"] = "\n\n".join([title, opened, rest, *lines[1:]]) + "\n"
    return made


def _output(
    output: dict[str, Any], name: str, made: dict[str, str | bytes], *, tables: bool
) -> str:
    """An output in Markdown; a picture becomes a file."""
    if output["output_type"] == "stream":
        return _fenced("".join(output["text"]).rstrip())
    data = {kind: "".join(value) for kind, value in output["data"].items()}
    for kind, ending in _PICTURES.items():
        if kind in data:
            if ending == "png":
                made[f"{name}.{ending}"] = base64.b64decode(data[kind])
            else:
                made[f"{name}.{ending}"] = data[kind]
            return f"![What the cell above draws]({Path(name).name}.{ending})"
    if tables and "text/html" in data:
        return _STYLE.sub("", data["text/html"]).replace(_PANDAS, "<table>")
    return _fenced(data.get("text/plain", ""))


def _fenced(text: str, language: str = "text") -> str:
    return f"```{language}\n{text}\n```"


def _folded(text: str) -> str:
    indented = "\n".join(f"    {line}".rstrip() for line in text.splitlines())
    return f'??? success "A solution"\n\n{indented}'
