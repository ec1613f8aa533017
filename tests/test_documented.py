"""What a reader of the reference finds: every public name says what it is; numbers say what they count."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")


def modules() -> Iterator[tuple[Path, ast.Module]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path, ast.parse(path.read_text(encoding="utf-8"))


def public(name: str) -> bool:
    return not name.startswith("_")


def is_number(node: ast.expr | None) -> bool:
    """A number, a calculation with numbers, or a tuple of these."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.Tuple):
        return bool(node.elts) and all(map(is_number, node.elts))
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    return isinstance(node, ast.BinOp) and is_number(node.left) and is_number(node.right)


def explained(path: Path, body: list[ast.stmt], place: int) -> bool:
    """A string below (of a group of constants: below the group), or a comment beside or above."""
    lines = path.read_text(encoding="utf-8").splitlines()
    first = place
    while first > 0 and isinstance(body[first - 1], ast.Assign | ast.AnnAssign):
        if body[first].lineno - (body[first - 1].end_lineno or 0) > 1:
            break
        first -= 1
    after = place
    while after < len(body) and isinstance(body[after], ast.Assign | ast.AnnAssign):
        after += 1
    text = body[after].value if after < len(body) and isinstance(body[after], ast.Expr) else None
    if isinstance(text, ast.Constant) and isinstance(text.value, str):
        return True
    return "#" in lines[body[place].lineno - 1] or lines[body[first].lineno - 2].lstrip().startswith("#")


def test_every_public_number_says_what_it_is() -> None:
    missing = []
    for path, tree in modules():
        for place, node in enumerate(tree.body):
            if isinstance(node, ast.Assign):
                targets, value = node.targets, node.value
            elif isinstance(node, ast.AnnAssign) and node.value is not None:
                targets, value = [node.target], node.value
            else:
                continue
            names = [target.id for target in targets if isinstance(target, ast.Name) and public(target.id)]
            if names and is_number(value) and not explained(path, tree.body, place):
                missing.append(f"{path.relative_to(ROOT)}: {names[0]}")
    assert missing == []


def test_every_public_class_and_function_has_a_docstring() -> None:
    missing = []
    for path, tree in modules():
        holders: list[tuple[str, ast.AST]] = [("", tree)]
        holders += [
            (f"{node.name}.", node) for node in tree.body if isinstance(node, ast.ClassDef) and public(node.name)
        ]
        for prefix, holder in holders:
            for node in ast.iter_child_nodes(holder):
                if not isinstance(node, ast.ClassDef | ast.FunctionDef) or not public(node.name):
                    continue
                if any(isinstance(mark, ast.Name) and mark.id == "override" for mark in node.decorator_list):
                    continue
                if ast.get_docstring(node) is None:
                    missing.append(f"{path.relative_to(ROOT)}: {prefix}{node.name}")
    assert missing == []
