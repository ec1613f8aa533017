"""Size and density of the product, as a table: `python -m tests.code_measure [FOLDER]`.

FOLDER is a checkout, this one if none is named; so a version is compared with another one that was
cloned beside it. Size is the number of nodes of the syntax trees (`ast.walk`); lines and words do
not count. A statement is any statement but a docstring.
"""

import ast
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")
MAX_NODES = 352_000
"""Nodes of the product; `tests/test_code_size.py` holds it."""
LONG_FUNCTION = 60
"""Lines above which a function is listed."""
LONG_FILE = 450
"""Lines above which a file is listed."""
DENSEST = 5
"""Modules that are listed for their density."""
MIN_STATEMENTS = 20
"""Statements below which a module's density says nothing."""


@dataclass(frozen=True)
class Module:
    """Size of one file of the product."""

    path: Path
    nodes: int
    statements: int
    lines: int
    long_functions: tuple[tuple[str, int], ...]

    @property
    def density(self) -> float:
        """Nodes a statement."""
        return self.nodes / max(self.statements, 1)


def is_statement(node: ast.AST) -> bool:
    """Whether a node is a statement and not a docstring or the string below a constant."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return False
    return isinstance(node, ast.stmt)


def measure(path: Path, root: Path) -> Module:
    """Counts one file."""
    text = path.read_text(encoding="utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    long_functions = []
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            if length > LONG_FUNCTION:
                long_functions.append((node.name, length))
    return Module(
        path.relative_to(root),
        len(nodes),
        sum(map(is_statement, nodes)),
        len(text.splitlines()),
        tuple(long_functions),
    )


def measure_folder(folder: Path, root: Path) -> list[Module]:
    """Counts all Python files below a folder; models that a wheel brings are no code."""
    paths = [path for path in sorted(folder.rglob("*.py")) if "_models" not in path.parts]
    return [measure(path, root) for path in paths]


def product_nodes(root: Path) -> int:
    """Nodes of the three packages."""
    return sum(
        module.nodes for package in PACKAGES for module in measure_folder(root / package, root)
    )


def main() -> None:
    """Prints the tables."""
    root = Path(sys.argv[1] if sys.argv[1:] else ".").resolve()
    missing = [name for name in (*PACKAGES, "tests") if not (root / name).is_dir()]
    if missing:
        sys.exit(f"error: {root} is no checkout of the workbench: it has no {', '.join(missing)}")
    folders = {name: measure_folder(root / name, root) for name in (*PACKAGES, "tests")}
    folders["product"] = [module for package in PACKAGES for module in folders[package]]
    print("| folder | nodes | statements | nodes a statement |\n|---|---|---|---|")
    for name, modules in folders.items():
        nodes = sum(module.nodes for module in modules)
        statements = sum(module.statements for module in modules)
        print(f"| {name} | {nodes:,} | {statements:,} | {nodes / max(statements, 1):.2f} |")
    product = folders["product"]
    print(f"\nlimit of the product: {MAX_NODES:,} nodes")
    print("\n| densest modules | nodes a statement |\n|---|---|")
    dense = [module for module in product if module.statements >= MIN_STATEMENTS]
    for module in sorted(dense, key=lambda module: -module.density)[:DENSEST]:
        print(f"| {module.path} | {module.density:.1f} |")
    print(f"\n| functions above {LONG_FUNCTION} lines | lines |\n|---|---|")
    for module in product:
        for name, length in module.long_functions:
            print(f"| {module.path}: {name} | {length} |")
    print(f"\n| files above {LONG_FILE} lines | lines |\n|---|---|")
    for module in product:
        if module.lines > LONG_FILE:
            print(f"| {module.path} | {module.lines} |")


if __name__ == "__main__":
    main()
