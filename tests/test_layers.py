"""Which folder of a package may import which: every import goes down the list of layers."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.code_measure import PACKAGES, ROOT

LAYERS = {
    "workbench": (
        "core",
        "scenario",
        "aero",
        "logs",
        "control",
        "car",
        "rig",
        "metrics",
        "batch",
        "view",
        "cli",
    ),
    "optimisation": ("identify", "studies", "swerve", "swing", "calibrate", "commands"),
    "hardware": (
        "protocol",
        "transport",
        "devices",
        "car",
        "firmware",
        "driving",
        "emulator",
        "console",
        "examples",
        "commands",
    ),
}
"""Folders of each package; one imports those before it."""


def imports(source: str) -> Iterator[tuple[str, ...]]:
    """Parts of the names that a module imports from our packages, lazily or not: package, folder,
    module, name.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("aerodima."):
            yield from ((*node.module.split(".")[1:], alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (
                tuple(alias.name.split(".")[1:])
                for alias in node.names
                if alias.name.startswith("aerodima.")
            )


def upward(package: str, folder: str, source: str) -> list[str]:
    """Imports of a module in `folder` that do not go down the layers of its package."""
    order = LAYERS[package]
    below = order.index(folder) if folder else 0
    return [
        ".".join(name)
        for name in imports(source)
        if name[0] == package
        and name[1] in order
        and name[1] != folder
        and order.index(name[1]) >= below
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_layers_are_the_folders_of_the_package_and_a_basename_occurs_once(package: str) -> None:
    folders = {path.parent.name for path in (ROOT / package).glob("*/*.py")}
    assert sorted(LAYERS[package]) == sorted(folders)
    stems = [path.stem for path in (ROOT / package).rglob("*.py") if path.stem != "__init__"]
    assert sorted(stems) == sorted(set(stems))


@pytest.mark.parametrize("package", PACKAGES)
def test_folders_import_only_what_stands_below_them(package: str) -> None:
    wrong = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        folder = path.relative_to(ROOT / package).parts[0] if path.parent != ROOT / package else ""
        if found := upward(package, folder, path.read_text(encoding="utf-8")):
            wrong[str(path.relative_to(ROOT))] = found
    assert not wrong


def file_arrows(root: Path) -> dict[Path, set[Path]]:
    """Every file of the packages and those that it imports, also inside functions."""
    files = {path for package in PACKAGES for path in (root / package).rglob("*.py")}
    return {
        path: {
            target
            for *module, name in imports(path.read_text(encoding="utf-8"))
            for target in (
                root.joinpath(*module, f"{name}.py"),
                root.joinpath(*module).with_suffix(".py"),
            )
            if target in files
        }
        for path in files
    }


def circles(arrows: dict[Path, set[Path]]) -> list[tuple[str, str]]:
    """Pairs of files that reach each other."""

    def reached(start: Path) -> set[Path]:
        found = set[Path]()
        waiting = [start]
        while waiting:
            new = arrows[waiting.pop()] - found
            found |= new
            waiting += new
        return found

    ways = {path: reached(path) for path in arrows}
    return sorted((a.stem, b.stem) for a in ways for b in ways[a] if a <= b and a in ways[b])


def test_no_files_import_each_other() -> None:
    assert circles(file_arrows(ROOT)) == []


def test_a_circle_of_files_is_seen(tmp_path: Path) -> None:
    for folder, name, text in (
        ("aero", "section_laws", "from aerodima.workbench.aero import sail"),
        (
            "aero",
            "sail",
            "def later():\n    from aerodima.workbench.car import tail_plant",
        ),
        ("car", "tail_plant", "from aerodima.workbench.aero.section_laws import NormalForceLaw"),
    ):
        (tmp_path / "workbench" / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / "workbench" / folder / f"{name}.py").write_text(text, encoding="utf-8")
    assert ("sail", "section_laws") in circles(file_arrows(tmp_path))


def test_an_arrow_upwards_is_seen() -> None:
    assert upward(
        "workbench", "aero", "from aerodima.workbench.car.car_plant import make_car_plant"
    )
    assert upward("hardware", "devices", "def later():\n    from aerodima.hardware import car")
    assert not upward(
        "workbench", "car", "from aerodima.workbench.aero.section_laws import NormalForceLaw"
    )
    assert not upward("optimisation", "swing", "from aerodima.workbench.cli import program")
