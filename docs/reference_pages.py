"""The reference: what the three packages export, a page per folder, made when the documentation is
built.

A page has each exported name of a folder with its docstring, read from the source by mkdocstrings
without importing it, and a line for every module of the folder: what is not exported may move, and
is read in the source.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages, and names them in the navigation."""
    from mkdocs.structure.files import File

    pages = reference()
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for part in config.nav or []:
        for entries in part.values():
            for entry in entries:
                if isinstance(entry, dict) and entry.get("Packages") == "reference/":
                    entry["Packages"] = _navigation(pages)
    return files


def reference() -> dict[str, str]:
    """Name of each page and its text."""
    pages = {}
    for package in PACKAGES:
        exported = _exported(package)
        folders = sorted(path.parent for path in (ROOT / package).glob("*/__init__.py"))
        pages[_page(package)] = _package_page(package, folders, exported)
        for folder in folders:
            pages[_page(package, folder.name)] = _folder_page(
                package, folder, exported.get(folder.name, {})
            )
    return pages


def _page(package: str, folder: str = "") -> str:
    if folder:
        return f"reference/aerodima.{package}.{folder}.md"
    return f"reference/aerodima.{package}.md"


def _exported(package: str) -> dict[str, dict[str, str]]:
    """Folder -> where an exported name stands -> first line of its docstring; the folder is empty
    beside the folders.

    `simulate` and `fit` are folders, too, so that `aerodima.workbench.simulate` would not do as a
    place.
    """
    found: dict[str, dict[str, str]] = {}
    stub = ast.parse((ROOT / package / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    for node in sorted(imports, key=lambda node: node.names[0].name.lower()):
        folder, _, _ = str(node.module).rpartition(".")
        path = ROOT / package / f"{str(node.module).replace('.', '/')}.py"
        name = node.names[0].name
        place = f"aerodima.{package}.{node.module}.{name}"
        found.setdefault(folder, {})[place] = _summary_of(_parsed(path), name)
    return found


def _package_page(package: str, folders: list[Path], exported: dict[str, dict[str, str]]) -> str:
    """Tables of what the package exports, by folder, and the pages of the folders that export
    nothing.
    """
    title = f"aerodima.{package}"
    lines = [
        f"# {title}",
        "",
        _docstring(ROOT / package / "__init__.py"),
        "",
        f"`from {title} import ...`",
        "",
    ]
    for folder in folders:
        names = exported.get(folder.name)
        if names:
            lines += ["", f"## {folder.name}", "", *_table(package, folder.name, names)]
    outside = exported.get("")
    if outside:
        lines += ["", "## Beside the folders", "", *_table(package, "", outside), ""]
        lines += [f"::: {place}\n    options: {{heading_level: 3}}\n" for place in outside]
    lines += ["", "## Folders that export nothing", ""]
    for folder in folders:
        if folder.name not in exported:
            summary = _summary(_docstring(folder / "__init__.py"))
            lines.append(f"- [{folder.name}]({title}.{folder.name}.md): {summary}")
    return "\n".join(lines) + "\n"


def _table(package: str, folder: str, names: dict[str, str]) -> list[str]:
    page = Path(_page(package, folder)).name
    rows = [
        f"| [`{place.rpartition('.')[2]}`]({page}#{place}) | {text} |"
        for place, text in names.items()
    ]
    return ["| name | what |", "|---|---|", *rows]


def _folder_page(package: str, folder: Path, names: dict[str, str]) -> str:
    """What the folder exports, and a line for each of its modules."""
    title = f"aerodima.{package}.{folder.name}"
    lines = [f"# {title}", "", _docstring(folder / "__init__.py"), ""]
    if names:
        imported = ", ".join(place.rpartition(".")[2] for place in names)
        lines += [
            f"`from aerodima.{package} import {imported}`",
            "",
            *(f"::: {place}\n" for place in names),
        ]
    lines += [
        "## Modules",
        "",
        f"Files of `{package}/{folder.name}`:",
        "",
        "| file | what |",
        "|---|---|",
    ]
    for path in sorted(folder.rglob("*.py")):
        if not path.name.startswith("_"):
            name = path.relative_to(folder).as_posix()
            anchor = name.removesuffix(".py").replace("/", ".")
            summary = _summary(_docstring(path)).replace("|", "\\|")
            lines.append(f'| <span id="{anchor}">`{name}`</span> | {summary} |')
    return "\n".join(lines) + "\n"


def _navigation(pages: dict[str, str]) -> list[dict[str, Any]]:
    """One entry per package, its folders below."""
    navigation: list[dict[str, Any]] = []
    for package in PACKAGES:
        own = [
            name
            for name in pages
            if name.startswith(f"reference/aerodima.{package}.") and name != _page(package)
        ]
        entries = [{Path(name).stem.rpartition(".")[2]: name} for name in own]
        navigation.append({package: [{"what it exports": _page(package)}, *entries]})
    return navigation


def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _docstring(path: Path) -> str:
    return ast.get_docstring(_parsed(path)) or ""


def _summary(docstring: str) -> str:
    """First paragraph of a docstring, in one line."""
    return " ".join(docstring.split("\n\n")[0].split())


def _summary_of(module: ast.Module, name: str) -> str:
    """Summary of a class or function, or of the string below a constant; empty without one."""
    for node, after in zip(module.body, [*module.body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return _summary(ast.get_docstring(node) or "")
        names = [
            target.id for target in getattr(node, "targets", ()) if isinstance(target, ast.Name)
        ]
        if name in names and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return _summary(str(after.value.value))
    return ""
