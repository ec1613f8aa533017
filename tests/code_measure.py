"""Size and shape of the code, as a table: `python -m tests.code_measure [FOLDER]`.

`tests/size.toml` has the limits.

FOLDER is a checkout, this one if none is named; so a version is compared with another one that was
cloned beside it. Lines of code are lines that hold a token other than a comment, a docstring or a
line end. Two places repeat each other when at least `REPEATED` statements in a row have the same
tree, names and constants left out.
"""

from __future__ import annotations

import ast
import io
import json
import re
import subprocess
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

PACKAGES = ("workbench", "optimisation", "hardware")
LONG_FILE = 300
LONG_FUNCTION = 40
REPEATED = 8
_BLANK = (
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
)
_NAMES = re.compile(
    r"(id|attr|arg|name|value|module)=('[^']*'|\"[^\"]*\"|[-\d.e+]+|True|False|None)"
)
_Function = ast.FunctionDef | ast.AsyncFunctionDef


def modules(root: Path) -> dict[Path, ast.Module]:
    """Product modules and their trees."""
    paths = sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))
    return {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for path in paths
        if "_models" not in path.parts
    }


def docstring_lines(tree: ast.Module) -> set[int]:
    """Lines of strings that stand alone: docstrings, and those below constants."""
    alone = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    return {
        line for node in alone for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }


def lines_of_code(path: Path, tree: ast.Module) -> int:
    """See the docstring of the module."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    lines = {
        line
        for token in tokens
        if token.type not in _BLANK
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(lines - docstring_lines(tree))


def bodies(tree: ast.AST) -> Iterator[list[ast.stmt]]:
    """Every run of statements of one block."""
    for node in ast.walk(tree):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list) and block and isinstance(block[0], ast.stmt):
                yield [each for each in block if not isinstance(each, ast.Import | ast.ImportFrom)]


def weight(statement: ast.stmt) -> int:
    """Statements in a statement, itself included."""
    return sum(isinstance(node, ast.stmt) for node in ast.walk(statement))


def repeated_places(trees: dict[Path, ast.Module]) -> set[tuple[str, str]]:
    """Pairs of blocks, as `file:number of the block`, that have at least `REPEATED` statements of
    equal structure.
    """
    places: dict[str, set[str]] = defaultdict(set)
    for path, tree in trees.items():
        for number, block in enumerate(bodies(tree)):
            shapes = [_NAMES.sub("", ast.dump(statement)) for statement in block]
            for first in range(len(block)):
                size = 0
                for last in range(first, len(block)):
                    size += weight(block[last])
                    if size >= REPEATED:
                        key = "\n".join(shapes[first : last + 1])
                        places[key].add(f"{path}:{number}")
                        break
    pairs = set()
    for found in places.values():
        pairs |= set(combinations(sorted(found), 2))
    return pairs


def functions(trees: dict[Path, ast.Module]) -> Iterator[tuple[Path, _Function]]:
    """Every function with its file."""
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, _Function):
                yield path, node


def loaded_by(root: Path, statement: str) -> int:
    """Product modules with functions or classes in them that a statement loads, in a process of its
    own.
    """
    code = (
        f"{statement}\nimport sys\nprint(sum(1 for name, module in list(sys.modules.items()) "
        f"if name.removeprefix('aerodima.').partition('.')[0] in {PACKAGES!r} "
        "and not (getattr(module, '__file__', None) or '').endswith('__init__.py')))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=root,
        env={"PYTHONPATH": f"{root / 'src'}:{root}", "PATH": ""},
        check=False,
    )
    return int(found.stdout) if found.returncode == 0 else -1


def built_station(module: str, prefix: str = "aerodima.") -> str:
    """Statements that load a scenario and build its station."""
    return (
        f"from {prefix}workbench.config.scenario import load_scenario\n"
        f"from {module} import make_car_station\nmake_car_station(load_scenario('turn_swing'))"
    )


def judged_turn(prefix: str = "aerodima.") -> str:
    """Statements that load manoeuvres, candidates and their judge, and what drives one of the
    runs.
    """
    return (
        f"from {prefix}optimisation.entry.entry_speed import climb\n"
        f"from {prefix}optimisation.entry.suite import candidates, manoeuvres\n"
        f"from {prefix}optimisation.sweep.runs import RunTask, evaluate\n"
        "who, (turn,) = candidates(['published'])[-1], manoeuvres(['turn'], 'designed')\n"
        "settings = ('simulation.step=0.004', 'manoeuvre.duration=1.2', "
        "'simulation.log_rate=250')\n"
        "evaluate(RunTask('', turn.scenario, (*turn.settings, *who.settings, *settings)))"
    )


def deep_imports(root: Path) -> set[str]:
    """Modules below a package that the notebooks import from."""
    found = set()
    for path in (root / "notebooks").glob("*.ipynb"):
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            found |= set(
                re.findall(
                    r"^from ((?:aerodima\.)?\w+\.[\w.]+) import",
                    "".join(cell["source"]),
                    re.MULTILINE,
                )
            )
    return {
        name
        for name in found
        if name.startswith("aerodima.") and name.removeprefix("aerodima.").count(".")
    }


def exported_names(root: Path) -> int:
    """Names that the three packages export: imports of their `__init__.pyi`."""
    faces = [(root / package / "__init__.pyi").read_text(encoding="utf-8") for package in PACKAGES]
    return sum(line.startswith("from ") for text in faces for line in text.splitlines())


def words_of_documentation(root: Path) -> int:
    """Words of all pages in `docs` and of every README."""
    pages = {*(root / "docs").rglob("*.md"), root / "README.md"}
    pages |= {
        path for folder in (*PACKAGES, "models") for path in (root / folder).rglob("README.md")
    }
    return sum(len(path.read_text(encoding="utf-8").split()) for path in pages)


def lines_of_data(root: Path, suffixes: tuple[str, ...]) -> int:
    """Lines that are not blank of the packages' and models' files with these endings."""
    texts = [
        path.read_text(encoding="utf-8")
        for folder in (*PACKAGES, "models")
        for path in (root / folder).rglob("*")
        if path.suffix in suffixes
    ]
    return sum(bool(line.strip()) for text in texts for line in text.splitlines())


def measures(root: Path) -> dict[str, object]:
    """Name of each measure and its value."""
    trees = modules(root)
    lengths = [(node.end_lineno or node.lineno) - node.lineno + 1 for _, node in functions(trees)]
    names = {
        package: Counter(path.stem for path in trees if path.is_relative_to(root / package))
        for package in PACKAGES
    }
    static = "optimisation.identify.static_fit"
    prefix = "aerodima." if (root / "src").is_dir() else ""
    found = (path for path in (root / "workbench").rglob("*station.py") if "rig" not in path.name)
    station = next(found).relative_to(root).with_suffix("")
    return {
        "lines of code": sum(lines_of_code(path, tree) for path, tree in trees.items()),
        "lines that are not blank": sum(
            bool(line.strip())
            for path in trees
            for line in path.read_text(encoding="utf-8").splitlines()
        ),
        "statements (AST)": sum(
            isinstance(node, ast.stmt) for tree in trees.values() for node in ast.walk(tree)
        ),
        "modules": len(trees),
        "files directly in workbench/": len(list((root / "workbench").glob("*.py"))),
        "modules loaded by the fit of a static log": loaded_by(
            root, f"from {prefix}{static} import fit_static_log"
        ),
        "modules loaded by the station": loaded_by(
            root, built_station(f"{prefix}{'.'.join(station.parts)}", prefix)
        ),
        "modules loaded by judging a swing": loaded_by(root, judged_turn(prefix)),
        "deep modules that notebooks import": len(deep_imports(root)),
        "names that the packages export": exported_names(root),
        f"pairs of places with {REPEATED} statements alike": len(repeated_places(trees)),
        f"files over {LONG_FILE} lines": sum(
            len(path.read_text(encoding="utf-8").splitlines()) > LONG_FILE for path in trees
        ),
        f"functions over {LONG_FUNCTION} lines": sum(length > LONG_FUNCTION for length in lengths),
        "lines of templates, JavaScript, CSS": lines_of_data(root, (".html", ".j2", ".js", ".css")),
        "words of documentation": words_of_documentation(root),
        "lines of YAML": lines_of_data(root, (".yaml",)),
        "basenames that occur twice in a package": sum(
            count > 1 and not stem.startswith("__")
            for found in names.values()
            for stem, count in found.items()
        ),
    }


def main() -> None:
    """Prints the table."""
    root = Path(sys.argv[1] if sys.argv[1:] else ".").resolve()
    print("| measure | value |\n|---|---|")
    for name, value in measures(root).items():
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    main()
