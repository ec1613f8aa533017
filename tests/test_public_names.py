"""Names that the packages export: each is there, importing a package loads no module of it, and
notebooks and pages import nothing else.
"""

import ast
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.code_measure import PACKAGES, ROOT
from tests.notebook_runs import FOLDER, code_cells, source
from tests.page_blocks import blocks


def public_names(package: str) -> set[str]:
    return set(importlib.import_module(f"aerodima.{package}").__all__)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_can_be_imported_and_says_what_it_is(package: str) -> None:
    module = importlib.import_module(f"aerodima.{package}")
    for name in sorted(public_names(package)):
        value = getattr(module, name)
        if callable(value):
            assert value.__doc__, name


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stays_what_it_is_when_a_folder_of_that_name_is_imported(package: str) -> None:
    """`simulate` and `fit` may be folders, too."""
    folders = {path.parent.name for path in (ROOT / package).glob("*/__init__.py")}
    script = f"import aerodima.{package} as package\n"
    for name in folders & public_names(package):
        script += f"import aerodima.{package}.{name}\nassert callable(package.{name}), {name!r}\n"
    subprocess.run([sys.executable, "-c", script], check=True)


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


def deep_imports(code: str) -> list[str]:
    """Names that a piece of code imports from our packages and that they do not export."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.startswith("aerodima.")]
        elif isinstance(node, ast.ImportFrom) and str(node.module).startswith("aerodima"):
            package = str(node.module).removeprefix("aerodima.")
            public = public_names(package) if package in PACKAGES else set()
            found += [f"{node.module}.{n.name}" for n in node.names if n.name not in public]
    return found


def code_of(path: Path) -> list[str]:
    """Python of a notebook, by cells and without magics, or of a page, by blocks."""
    if path.suffix == ".md":
        return [block["text"] for block in blocks(path) if block["language"] == "python"]
    cells = code_cells(json.loads(path.read_text(encoding="utf-8")))
    return [re.sub(r"^%.*", "", source(cell), flags=re.M) for cell in cells]


@pytest.mark.parametrize(
    "paths",
    [list(FOLDER.glob("*.ipynb")), [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]],
    ids=["notebooks", "pages"],
)
def test_notebooks_and_pages_import_only_exported_names(paths: list[Path]) -> None:
    code = [text for path in paths for text in code_of(path)]
    assert "from aerodima.workbench import" in "".join(code)
    assert [name for text in code for name in deep_imports(text)] == []


def test_an_import_of_a_name_that_is_not_exported_is_seen() -> None:
    assert deep_imports("from aerodima.workbench.scenario.scenario import load_scenario")
    assert deep_imports("from aerodima.workbench import resources")
    assert deep_imports("import aerodima.hardware.driving")
    assert not deep_imports("from aerodima.workbench import load_scenario, simulate\nimport numpy")
