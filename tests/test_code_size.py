"""The product stays within its limits: nodes, lines of a function and a file, and docstrings that
begin with a verb or a noun.
"""

import ast

import pytest

from tests.code_measure import LONG_FILE, MAX_NODES, PACKAGES, ROOT, measure_folder, product_nodes

FRAGMENT_STARTS = (
    *("as", "at", "by", "for", "from", "how", "in", "of", "on", "to", "until", "what", "when"),
    *("where", "whether", "which", "who", "whose", "why", "with", "without"),
)
"""Words with which a docstring starts in mid-air."""
MAX_FRAGMENTS = {"workbench": 9, "optimisation": 14, "hardware": 0}
"""Docstrings of a package that still do so; the numbers only fall."""


def test_product_is_within_its_limit_of_nodes() -> None:
    assert product_nodes(ROOT) <= MAX_NODES


@pytest.mark.parametrize("package", PACKAGES)
def test_no_function_and_no_file_is_long(package: str) -> None:
    long = set()
    for module in measure_folder(ROOT / package, ROOT):
        long |= {f"{module.path}: {name}" for name, _ in module.long_functions}
        if module.lines > LONG_FILE:
            long.add(str(module.path))
    assert not long


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_do_not_start_in_mid_air(package: str) -> None:
    fragments = []
    for path in sorted((ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                first = (ast.get_docstring(node) or "-").split()[0]
                if first.lower() in FRAGMENT_STARTS:
                    fragments.append(f"{path.relative_to(ROOT)}: {getattr(node, 'name', '')}")
    assert len(fragments) <= MAX_FRAGMENTS[package], "\n".join(fragments)
