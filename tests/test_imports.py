"""Which package may import which: `optimisation` and `hardware` import `workbench`.

And every import is declared.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterable

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.code_measure import PACKAGES, ROOT

TOP_LEVEL = {*PACKAGES, "tests", "notebooks", "models"}
ALLOWED = {("optimisation", "workbench"), ("hardware", "workbench")}
DISTRIBUTION_OF_MODULE = {
    "PIL": "pillow",
    "can": "python-can",
    "distributed": "dask",
    "markupsafe": "jinja2",
    "mcap_protobuf": "mcap-protobuf-support",
    "pydrake": "drake",
    "serial": "pyserial",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}
"""Import names that differ from the name of the distribution that brings them."""


def imported_names(source: str) -> set[str]:
    """What a module imports: the package below `aerodima`, or the top-level name of a module of
    others.

    By statement, or by a call such as `import_module("name.of.module")`.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {_top(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names |= {_top(f"{node.module}.{alias.name}") for alias in node.names}
        elif isinstance(node, ast.Call) and node.args:
            called = (
                node.func.attr
                if isinstance(node.func, ast.Attribute)
                else getattr(node.func, "id", "")
            )
            first = node.args[0]
            if called in {"import_module", "__import__"} and isinstance(first, ast.Constant):
                names.add(_top(str(first.value)))
    return names


def _top(name: str) -> str:
    return name.removeprefix("aerodima.").partition(".")[0]


def arrows(package: str, source: str) -> set[tuple[str, str]]:
    """Imports of a module of `package` that cross the border of a top-level folder and are not
    allowed.
    """
    crossing = {
        (package, name) for name in imported_names(source) if name in TOP_LEVEL and name != package
    }
    return crossing - ALLOWED


@pytest.mark.parametrize("package", PACKAGES)
def test_package_imports_only_what_stands_below_it(package: str) -> None:
    modules = sorted((ROOT / package).rglob("*.py"))
    assert modules, f"no modules in {package}"
    wrong = {
        str(path.relative_to(ROOT)): sorted(found)
        for path in modules
        if (found := arrows(package, path.read_text(encoding="utf-8")))
    }
    assert not wrong


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("workbench", "from aerodima.optimisation.studies import study"),
        ("workbench", "def later():\n    import aerodima.hardware.driving"),
        ("optimisation", "import aerodima.hardware"),
        ("hardware", "from aerodima.optimisation import swing"),
        ("workbench", "from tests.benchmarks import rows"),
        ("hardware", "import importlib\nimportlib.import_module('aerodima.optimisation.commands')"),
    ],
)
def test_forbidden_arrow_is_seen(package: str, source: str) -> None:
    assert arrows(package, source)


@pytest.mark.parametrize(
    ("package", "source"),
    [
        ("optimisation", "from aerodima.workbench.scenario.scenario import load_scenario"),
        ("hardware", "import aerodima.workbench.car.car_station"),
        ("workbench", "from . import resources\nimport numpy\nfrom workbench import ports"),
    ],
)
def test_allowed_arrow_passes(package: str, source: str) -> None:
    assert not arrows(package, source)


def undeclared(folders: Iterable[str], extras: Iterable[str] | None = None) -> set[str]:
    """Imports of distributions that neither the package nor these extras and groups (all extras by
    default) bring.
    """
    content = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = content["project"]
    optional = project["optional-dependencies"] | (content["dependency-groups"] if extras else {})
    lines = [line for name in extras or optional for line in optional[name]] + project[
        "dependencies"
    ]
    declared = {canonicalize_name(Requirement(line).name) for line in lines}
    return {
        f"{path.relative_to(ROOT)}: {name}"
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
        for name in imported_names(path.read_text(encoding="utf-8"))
        - sys.stdlib_module_names
        - TOP_LEVEL
        if DISTRIBUTION_OF_MODULE.get(name, canonicalize_name(name)) not in declared
    }


def test_every_distribution_that_is_imported_is_declared() -> None:
    assert not undeclared(PACKAGES)


def test_make_bench_installs_what_the_benchmarks_import() -> None:
    rules = re.split(r"^(?=[a-z]+:)", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.M)
    installed = {rule.partition(":")[0]: re.findall(r"--group (\w+)", rule) for rule in rules}
    assert not undeclared(["tests/benchmarks"], [*installed["bench"], "dev"])
    assert undeclared(["tests/benchmarks"], ["dev"])


def test_models_hold_data_only() -> None:
    code = [
        path.name
        for suffix in ("py", "pyi", "so", "sh")
        for path in (ROOT / "models").rglob(f"*.{suffix}")
    ]
    assert not code
