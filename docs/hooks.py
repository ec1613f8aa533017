"""Pages that are made when the documentation is built: the model card, and texts that stand
elsewhere.

The model card is made of `models/parameters` and `models/coefficients`, and the page on the built
car of `models/published/statements.yaml`, so that no number is typed twice; explanations and the
errata of the thesis are the texts beside the code and the tables. The reference has a module of its
own, `reference_pages.py`.
"""

from __future__ import annotations

import csv
import io
import posixpath
import re
import sys
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import yaml
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
TEXTS = {
    "plant.md": "workbench/car/README.md",
    "rig.md": "workbench/rig/README.md",
    "aerodynamics.md": "workbench/aero/README.md",
    "optimiser.md": "optimisation/swing/README.md",
    "safety.md": "hardware/README.md",
    "reduced_cars.md": "workbench/car/reduced/README.md",
    "logs.md": "workbench/logs/README.md",
    "contributing.md": "CONTRIBUTING.md",
    "errata.md": "models/published/ERRATA.md",
}
"""Page -> text of the repository; what it names of the repository stays a name."""
MADE = {
    "models/parameters": "parameters/parameters.md",
    "models/coefficients": "parameters/coefficients.md",
    "models/published/statements.yaml": "built.md",
    "hardware/emulator/fault_table.csv": "safety.md#table-of-faults",
    "workbench/aero/signs.png": "signs.png",
}
"""Folder or file of the repository -> page that is made of it."""
_LINK = re.compile(
    r"^ *(?P<fence>```|~~~).*?^ *(?P=fence)|`[^`\n]*`|"  # code, which is left as it is
    r"!?\[(?P<text>[^\[\]]*)\]\((?!\w+:|#)(?P<path>[^)\s#]+)(?P<anchor>#[^)\s]*)?\)",
    re.MULTILINE | re.DOTALL,
)
_ERRATUM = re.compile(r"\bERRATA ((?:E\d+)(?:(?:, | and )E\d+)*)")
_NUMBER = re.compile(r"E(\d+)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages to those of the folder."""
    from mkdocs.structure.files import File

    sys.path.insert(0, str(ROOT))  # tests are not installed
    from tests.built.statements import statements_page

    texts = {name: (ROOT / path).read_text(encoding="utf-8") for name, path in TEXTS.items()}
    texts["safety.md"] = texts["safety.md"].replace(
        "\n## When the computer dies", f"{_fault_table()}\n## When the computer dies"
    )
    texts["errata.md"] = re.sub(
        r"^### (E\d+)\. (.*)$", r"### \1. \2 { #\1 }", texts["errata.md"], flags=re.MULTILINE
    )
    pages = {**_model_card(), "built.md": statements_page(), **texts}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for name, picture in _pictures().items():
        files.append(File.generated(config, name, content=picture))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Leads links to pages, and makes a link of every number of the errata (`ERRATA E28`)."""
    uri = page.file.src_uri
    if uri.startswith("reference/"):
        return markdown
    up = "../" * uri.count("/")
    if uri.endswith(".md") and "parameters/" not in uri:
        home = PurePosixPath(_home_of(uri)).parent

        def lead(link: re.Match[str]) -> str:
            if link["path"] is None:
                return link[0]
            path = posixpath.normpath(home / link["path"])
            target, _, anchor = _page_of(path, link["anchor"] or "").partition("#")
            if files.get_file_from_path(target) is None:  # a file of the repository only
                return link["text"]
            mark = link[0].partition("(")[0]
            return f"{mark}({up}{target}{'#' if anchor else ''}{anchor})"

        markdown = _LINK.sub(lead, markdown)
    if uri == "errata.md":
        return markdown
    return _ERRATUM.sub(
        lambda found: "ERRATA " + _NUMBER.sub(rf"[E\1]({up}errata.md#E\1)", found.group(1)),
        markdown,
    )


def _home_of(uri: str) -> str:
    """Names the file of the repository that a page is made of."""
    if uri.startswith("notebooks/"):
        return f"{uri.removesuffix('.md')}.ipynb"
    return TEXTS.get(uri, f"docs/{uri}")


def _page_of(path: str, anchor: str) -> str:
    """Names the page, with its anchor, of what a text links to in the repository.

    Links of all texts lead to files of the repository, so that they work where this documentation
    is not built. A text and a notebook become their pages, and a module its place in the reference.
    """
    pages = {home: page for page, home in TEXTS.items()} | MADE
    *folders, name = path.split("/")
    if path in pages:
        page = pages[path]
    elif path.startswith("docs/"):
        page = path.removeprefix("docs/")
    elif name.endswith(".ipynb"):
        page = f"{path.removesuffix('.ipynb')}.md"
    elif path.startswith("models/parameters/"):
        page = f"parameters/parameters.md#{name.removesuffix('.yaml')}"
    elif name == "__init__.pyi":
        page = f"reference/aerodima.{folders[0]}.md"
    elif name.endswith(".py"):
        page = f"reference/aerodima.{'.'.join(folders[:2])}.md#{name.removesuffix('.py')}"
    else:
        page = path
    return page + anchor


def _fault_table() -> str:
    """Faults of the emulated car: what acts, and motors off (ms), throttle neutral (ms), exit
    frames per wiring.
    """
    with (ROOT / "hardware" / "emulator" / "fault_table.csv").open(
        encoding="utf-8", newline=""
    ) as file:
        rows = list(csv.DictReader(file))
    wirings = ("watched_can", "teensy_bridge")
    numbers = {
        (row["fault"], row["wiring"]): " / ".join(
            row[key] for key in ("motors_off_ms", "throttle_neutral_ms", "exit_frames")
        )
        for row in rows
    }
    lines = [
        f"| {fault} | {numbers.get((fault, wirings[0]), '')} | "
        f"{numbers.get((fault, wirings[1]), '')} | {acts} |"
        for fault, acts in dict.fromkeys((row["fault"], row["what_acts"]) for row in rows)
    ]
    head = [f"| fault | {wirings[0]} | {wirings[1]} | what acts |", "|---|---|---|---|"]
    said = "Cells: motors off, ms / throttle neutral, ms / exit frames."
    return "\n".join(["", "### Table of faults", "", said, "", *head, *lines, ""])


def _pictures() -> dict[str, bytes]:
    """The signs of the aerodynamic law, and a plot of each coefficient set."""
    from aerodima.workbench.aero.coefficient_files import embedded_sets, load_coefficients
    from aerodima.workbench.view.coefficient_figures import plot_coefficients

    pictures = {"signs.png": (ROOT / "workbench" / "aero" / "signs.png").read_bytes()}
    for name in embedded_sets():
        pictures[f"parameters/{name}.png"] = _png(plot_coefficients(load_coefficients(name)))
    return pictures


def _png(figure: Figure) -> bytes:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    return stream.getvalue()


def _model_card() -> dict[str, str]:
    return {
        "parameters/parameters.md": _parameters(),
        "parameters/coefficients.md": _coefficients(),
    }


def _parameters() -> str:
    folder = ROOT / "models" / "parameters"
    lines = [
        "# Model card: every parameter",
        "",
        "Made from `models/parameters`; each number stands there once. A *prior* is the range that "
        "an assumed number may have, and that the calibration searches.",
    ]
    for path in sorted(folder.rglob("*.yaml")):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        entries = {
            key: entry
            for key, entry in content.items()
            if isinstance(entry, dict) and "value" in entry
        }
        if not entries:
            continue
        section = path.relative_to(folder).with_suffix("").as_posix()
        lines += [
            "",
            f"## {section}",
            "",
            "| parameter | value | unit | source | prior | reason |",
            "|---|---|---|---|---|---|",
        ]
        for key, entry in entries.items():
            if entry.get("prior"):
                prior = " to ".join(f"{bound:g}" for bound in entry["prior"])
            else:
                prior = ""
            cells = (
                f"`{key}`",
                _shown(entry["value"]),
                entry["unit"],
                entry["source"],
                prior,
                entry.get("reason") or "",
            )
            lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)


def _coefficients() -> str:
    lines = [
        "# Coefficient sets",
        "",
        "The aerodynamic coefficient sets that ship in `models/coefficients`; `aerodima models "
        "coefficients plot NAME` draws one. C_N is the normal-force coefficient: the drag "
        "coefficient of a surface broadside to the wind. Formula, signs and where the laws hold: "
        "[Aerodynamic law](../aerodynamics.md). Which set the car uses is `coefficients` and "
        "`normal_force_coefficient` of its [tail](parameters.md#tail): by default C_N = 2, "
        "constant (thesis section 6.3.3, ERRATA E26).",
    ]
    for path in sorted((ROOT / "models" / "coefficients").glob("*.yaml")):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        nodes = content.pop("nodes", [])
        lines += [
            "",
            f"## {path.stem}",
            "",
            f"![{content['name']}]({path.stem}.png)",
            "",
            "| key | content |",
            "|---|---|",
        ]
        for key, value in content.items():
            text = (
                yaml.safe_dump(value, default_flow_style=True, width=10**6)
                .removesuffix("...\n")
                .strip()
            )
            lines.append(f"| `{key}` | {text if isinstance(value, list | dict) else value} |")
        if nodes:
            lines += [
                "",
                f'??? "{len(nodes)} nodes"',
                "",
                *(f"    {line}" for line in _node_table(nodes)),
            ]
    return "\n".join(lines) + "\n"


def _node_table(nodes: list[dict[str, Any]]) -> list[str]:
    keys = list(dict.fromkeys(key for node in nodes for key in node))
    rows = [[_shown(node.get(key, "")) for key in keys] for node in nodes]
    return ["| " + " | ".join(cells) + " |" for cells in (keys, ["---"] * len(keys), *rows)]
