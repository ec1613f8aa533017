"""The face of the three packages: what they promise is there, documented, and all that notebooks
and pages import.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")
PROSE = sorted(
    path
    for path in (
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "models").rglob("*.md"),
    )
    if path.name not in ("CHANGELOG.md", "design.md")
) + [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def face(package: str) -> set[str]:
    return set(importlib.import_module(f"aerodima.{package}").__all__)


def deep(source: str) -> list[str]:
    """What a piece of code imports from our packages beside what they promise."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.startswith("aerodima.")]
        elif (
            isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "aerodima"
        ):
            package = str(node.module).removeprefix("aerodima.")
            promised = face(package) if package in PACKAGES else set()
            found += [
                f"{node.module}.{alias.name}" for alias in node.names if alias.name not in promised
            ]
    return found


def code_of(path: Path) -> list[str]:
    if path.suffix == ".md":
        return re.findall(
            r"^```python[^\n]*\n(.*?)^```",
            path.read_text(encoding="utf-8"),
            re.MULTILINE | re.DOTALL,
        )
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return [
        "\n".join(line for line in cell.splitlines() if not line.startswith("%")) for cell in code
    ]


def test_an_import_behind_the_face_is_seen() -> None:
    assert deep("from aerodima.workbench.config.scenario import load_scenario")
    assert deep("from aerodima.workbench import resources")
    assert deep("import aerodima.hardware.driving")
    assert not deep("from aerodima.workbench import load_scenario, simulate\nimport numpy")


@pytest.mark.parametrize(
    "path", [*NOTEBOOKS, *PROSE], ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_notebooks_and_pages_import_from_the_face_alone(path: Path) -> None:
    assert [name for code in code_of(path) for name in deep(code)] == []


@pytest.mark.parametrize("path", PROSE, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_pages_name_what_the_face_has(path: Path) -> None:
    """In prose: `aerodima.workbench.simulate(...)` is a name of the face, not a module behind
    it.
    """
    text = re.sub(
        r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    named = re.findall(r"`aerodima\.(workbench|optimisation|hardware)\.(\w+(?:\.\w+)*)", text)
    assert [
        f"{package}.{name}"
        for package, name in named
        if name.partition(".")[0] not in face(package)
    ] == []


@pytest.mark.slow
@pytest.mark.parametrize("package", PACKAGES)
def test_every_promised_name_is_there_and_says_what_it_is_on_the_reference_page(
    package: str,
) -> None:
    spec = importlib.util.spec_from_file_location(
        "reference_pages", ROOT / "docs" / "reference_pages.py"
    )
    assert spec is not None
    assert spec.loader is not None
    generator = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generator)
    pages = generator.reference()
    rows = re.findall(
        r"^\| \[`(\w+)`\]\((.+?\.md)#(.+?)\) \| (.+) \|$",
        pages[f"reference/aerodima.{package}.md"],
        re.M,
    )
    assert {name for name, *_ in rows} == face(package)
    module = importlib.import_module(f"aerodima.{package}")
    for name, page, anchor, text in rows:
        home, _, own = anchor.rpartition(".")
        assert f"\n::: {anchor}\n" in pages[f"reference/{page}"]
        assert getattr(importlib.import_module(home), own) is getattr(module, name)
        assert len(text.split()) > 2, name
        assert not text.startswith("See"), name


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stays_what_it_is_when_a_folder_of_that_name_is_imported(package: str) -> None:
    """`simulate` and `fit` are folders, too."""
    folders = {path.parent.name for path in (ROOT / package).glob("*/__init__.py")} & face(package)
    script = f"import aerodima.{package} as face\n"
    for name in folders:
        script += f"import aerodima.{package}.{name}\nassert callable(face.{name}), {name!r}\n"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_every_promised_name_is_used_by_a_notebook_an_example_or_a_page() -> None:
    texts = [code for path in NOTEBOOKS for code in code_of(path)]
    texts += [
        path.read_text(encoding="utf-8") for path in (ROOT / "hardware" / "examples").glob("*.py")
    ]
    for path in PROSE:
        texts += code_of(path) + re.findall(r"`([^`\n]+)`", path.read_text(encoding="utf-8"))
    used = set(re.findall(r"\w+", " ".join(texts)))
    assert {package: sorted(face(package) - used) for package in PACKAGES} == {
        package: [] for package in PACKAGES
    }


def test_importing_the_packages_loads_none_of_their_modules() -> None:
    script = (
        "import sys; from aerodima import hardware, optimisation, workbench\n"
        "dir(workbench), dir(optimisation), dir(hardware)\n"
        "print(*sorted(name for name in sys.modules if name.startswith('aerodima.')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == {f"aerodima.{package}" for package in PACKAGES}
