"""What is installed: packages, data, versions, dependencies, and how little an import costs."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import entry_points

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from aerodima import workbench
from aerodima.workbench.core import resources
from tests.code_measure import PACKAGES, ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, GROUPS = PYPROJECT["project"], PYPROJECT["dependency-groups"]
WHEEL = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
CORE = {
    "dask", "drake", "jinja2", "lazy-loader", "matplotlib", "numpy", "pandas",
    "pillow", "psutil",
    "pyarrow", "pydantic", "pyyaml", "scipy", "typer", "typing-extensions",
}  # fmt: skip
HEAVY = (
    "pydrake", "numpy", "scipy", "pandas", "pyarrow", "matplotlib", "pydantic", "dask", "can",
    "yaml", "rich", "jinja2", "rosbags",
)  # fmt: skip


def declared(group):
    requirements = [Requirement(line) for line in group]
    return {canonicalize_name(requirement.name): requirement for requirement in requirements}


def pins(python):
    """Version of each distribution in constraints.txt for a Python version such as `3.11`."""
    found = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if not line or line.startswith("#"):
            continue
        requirement = Requirement(line)
        if requirement.marker is None or requirement.marker.evaluate({"python_version": python}):
            (specifier,) = requirement.specifier
            assert specifier.operator == "==", line
            assert canonicalize_name(requirement.name) not in found, (
                f"{line}: pinned twice for Python {python}"
            )
            found[canonicalize_name(requirement.name)] = specifier.version
    return found


def test_wheel_lists_every_package_and_the_models():
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert folders == set(PACKAGES)
    own = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "src" / "aerodima").iterdir()
        if path.is_file()
    }
    assert set(WHEEL["only-include"]) == {*PACKAGES, "models", *own}
    assert WHEEL["force-include"] == {"constraints.txt": "aerodima/constraints.txt"}


def test_wheel_puts_models_where_the_package_looks_for_them():
    shipped = resources._SHIPPED.relative_to(ROOT).as_posix()
    packages = {package: f"aerodima/{package}" for package in PACKAGES}
    assert WHEEL["sources"] == {
        "src/aerodima": "aerodima",
        **packages,
        "models": f"aerodima/{shipped}",
    }


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_typed(package):
    assert (ROOT / package / "py.typed").is_file()


def test_version_is_that_of_the_distribution_and_in_the_changelog():
    assert workbench.__version__ == PROJECT["version"]
    assert f"## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"\nversion: {PROJECT['version']}\n" in (ROOT / "CITATION.cff").read_text(
        encoding="utf-8"
    )


def test_constraints_name_no_extra_and_no_group_that_does_not_exist():
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    named = set(re.findall(r"^#.*?[`\[](\w+)[`\]]", text, re.MULTILINE))
    assert "hardware" in named
    assert named <= {*PROJECT["optional-dependencies"], *GROUPS}


@pytest.mark.parametrize("package", PACKAGES)
def test_package_has_one_name(package):
    done = subprocess.run(
        [sys.executable, "-c", f"import {package}"], cwd=ROOT, capture_output=True, text=True
    )
    error, _, message = done.stderr.splitlines()[-1].partition(": ")
    assert error == "ImportError"
    assert f"aerodima.{package}" in message


def test_core_dependencies_are_those_of_the_contract():
    assert set(declared(PROJECT["dependencies"])) == CORE


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_constraints_pin_every_declared_dependency_within_its_bounds(python):
    pinned = pins(python)
    for group in [
        PROJECT["dependencies"],
        *PROJECT["optional-dependencies"].values(),
        *GROUPS.values(),
    ]:
        for name, requirement in declared(group).items():
            assert requirement.specifier.contains(pinned[name]), (
                f"{requirement} but {pinned[name]} is pinned"
            )


def test_both_ends_of_drake_are_pinned():
    assert pins("3.11")["drake"].startswith("1.51.")
    assert tuple(map(int, pins("3.13")["drake"].split("."))) >= (1, 58, 0)


def test_own_commands_are_registered():
    names = PROJECT["entry-points"]["aerodima.commands"]
    found = {point.name: point for point in entry_points(group="aerodima.commands")}
    assert set(names) <= set(found)
    assert all(callable(found[name].load()) for name in names)


@pytest.mark.parametrize(
    "statement",
    [
        "from aerodima import workbench, optimisation, hardware",
        "from aerodima.workbench.core.resources import models_dir; models_dir()",
        "import sys; sys.argv[1:] = ['--help']\n"
        "from aerodima.workbench.cli.program import main\ntry: main()\nexcept SystemExit: pass",
    ],
    ids=["import", "resources", "help"],
)
def test_nothing_heavy_is_loaded_by(statement):
    script = (
        f"{statement}\nimport sys\nprint('loaded:', *sorted(set(sys.modules) & set({HEAVY!r})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1].strip() == "loaded:"
