"""Modules and files that texts name exist: in the documentation, notebooks, comments, docstrings, messages and data."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

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
    r"(?<![\w/.$}-])(?:workbench|optimisation|hardware|models|tests|docs|notebooks)/[\w/.-]*\w\.(?:" + KINDS + r")\b"
)
PATTERNS = {"models/published/NAME.csv"}
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
    return [p for p in paths if p.suffix in TEXTS and "old_files" not in p.parts and p != Path(__file__)]


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
    assert FILE.findall("see workbench/config/nothing.py and https://a.b/docs/x.md") == ["workbench/config/nothing.py"]
