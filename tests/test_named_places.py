"""Modules, files and commands that texts name exist: in documentation, notebooks, comments,
docstrings and data.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
import typer.main

from aerodima.workbench.cli.program import build_app

ROOT = Path(__file__).resolve().parent.parent
MODULE = re.compile(r"\baerodima(?:\.(?!md\b)\w+)+")
KINDS = "|".join(
    [
        "py",
        "md",
        "ipynb",
        "ya?ml",
        "csv",
        "sdf",
        "urdf",
        "obj",
        "dbc",
        "png",
        "svg",
        "json",
        "h",
        "cpp",
        "ino",
        "js",
        "html",
    ]
)
FILE = re.compile(
    r"(?<![\w/.$}-])(?:workbench|optimisation|hardware|models|tests|docs|notebooks)/[\w/.-]*\w\.(?:"
    + KINDS
    + r")\b"
)
DOTTED = re.compile(r"`((?:\w+\.)*[a-z]\w*)\.([A-Za-z]\w*)`")
"""`module.name`, also with folders before."""
OTHERS = {"matplotlib", "plant", "pydrake", "typer"}
"""First parts of names that are not ours."""
BARE = re.compile(r"`(\w+\.py)`")
PATTERNS = {"models/published/NAME.csv", "my_law.py"}
"""Names with a part for the reader to put in."""
TEXTS = {
    ".md",
    ".py",
    ".pyi",
    ".ipynb",
    ".yaml",
    ".yml",
    ".toml",
    ".h",
    ".cpp",
    ".ino",
    ".js",
    ".html",
    ".sdf",
    ".urdf",
}


FOLDERS = ("docs", "workbench", "optimisation", "hardware", "models", "notebooks", "tests", ".")
"""Where the texts are; of the last, what stands beside the folders."""


def texts(folder: str) -> list[Path]:
    """Texts below a folder, without this one and what earlier versions wrote."""
    paths = (ROOT / folder).glob("*") if folder == "." else (ROOT / folder).rglob("*")
    return [
        p for p in paths if p.suffix in TEXTS and "old_files" not in p.parts and p != Path(__file__)
    ]


@cache
def top_level(path: Path) -> set[str]:
    """Names that a module, or the stub of a face, defines or imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.alias):
            names.add((node.asname or node.name).split(".")[0])
    return names


def exists(dotted: str) -> bool:
    """Whether a module of this name exists, or one that has the rest as a name in it."""
    parts = dotted.split(".")[1:]
    place = ROOT
    for depth, part in enumerate(parts):
        if (place / part).is_dir():
            place = place / part
            continue
        file = place / f"{part}.py"
        if file.is_file():
            rest = parts[depth + 1 :]
            return not rest or rest[0] in top_level(file)
        return any(part in top_level(stub) for stub in place.glob("__init__.py*"))
    return True


@pytest.mark.parametrize("folder", FOLDERS)
def test_modules_that_are_named_exist(folder: str) -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in texts(folder)
        for name in MODULE.findall(path.read_text(encoding="utf-8"))
        if name.split(".")[1] in {"workbench", "optimisation", "hardware"} and not exists(name)
    }
    assert not missing


@cache
def names_of_modules() -> dict[str, set[str]]:
    """Stem -> names in all modules of our packages and tests that have it."""
    found: dict[str, set[str]] = {}
    for folder in ("workbench", "optimisation", "hardware", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            found.setdefault(path.stem, set()).update(top_level(path))
    return found


def stale(dotted: str, name: str) -> bool:
    """Whether `dotted.name` names a class or constant, or a function of a module of ours, that is
    not there.

    A module of one word, such as `tail`, may also be a section of a scenario or a variable:
    `tail.mode` passes.
    """
    first = dotted.split(".")[0]
    module = dotted.split(".")[-1]
    if first in {"aerodima", *OTHERS} or re.fullmatch(KINDS, name):
        return False
    if name[0].isupper() or ("_" in module and module in names_of_modules()):
        return name not in names_of_modules().get(module, set())
    return False


@pytest.mark.slow
@pytest.mark.parametrize("folder", FOLDERS)
def test_names_of_modules_exist(folder: str) -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {dotted}.{name}"
        for path in texts(folder)
        for dotted, name in DOTTED.findall(path.read_text(encoding="utf-8"))
        if stale(dotted, name)
    }
    assert not missing


@pytest.mark.parametrize("folder", FOLDERS)
def test_modules_that_are_named_without_a_folder_stand_below_the_text(folder: str) -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in texts(folder)
        for name in BARE.findall(path.read_text(encoding="utf-8"))
        if name not in PATTERNS and not any(path.parent.rglob(name))
    }
    assert not missing


def test_table_of_commands_has_them_all() -> None:
    rows = re.findall(
        r"^\| (`aerodima .*?) \|", (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"), re.M
    )
    commands = set(typer.main.get_group(build_app()).commands)
    assert commands <= {
        word for row in rows for word in re.findall(r"`(?:aerodima )?([\w-]+)", row)
    }
    assert {word for row in rows for word in re.findall(r"`aerodima ([\w-]+)", row)} <= commands


@pytest.mark.parametrize("folder", FOLDERS)
def test_files_that_are_named_exist(folder: str) -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in texts(folder)
        for name in FILE.findall(path.read_text(encoding="utf-8"))
        if name not in PATTERNS and not (ROOT / name).exists()
    }
    assert not missing


def test_a_name_that_is_gone_is_seen() -> None:
    assert not exists("aerodima.workbench.no_such_folder.module")
    assert not exists("aerodima.workbench.config.scenario.no_such_function")
    assert exists("aerodima.workbench.config.scenario.load_scenario")
    assert exists("aerodima.workbench.load_scenario")
    assert stale("ports", "IMU")
    assert stale("aero.tail_force", "make_tail_force")
    assert not stale("aero.tail_force", "add_tail_force")
    assert FILE.findall("see workbench/config/nothing.py and https://a.b/docs/x.md") == [
        "workbench/config/nothing.py"
    ]
