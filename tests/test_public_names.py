"""Names that the packages export: each is there, and importing a package loads no module of it."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")


def public_names(package: str) -> set[str]:
    return set(importlib.import_module(f"aerodima.{package}").__all__)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_exported_name_can_be_imported_and_says_what_it_is(package: str) -> None:
    module = importlib.import_module(f"aerodima.{package}")
    for name in sorted(public_names(package)):
        value = getattr(module, name)
        if callable(value):
            assert value.__doc__, name


@pytest.mark.parametrize("package", PACKAGES)
def test_a_name_stays_what_it_is_when_a_folder_of_that_name_is_imported(package: str) -> None:
    """`simulate` and `fit` may be folders, too."""
    folders = {path.parent.name for path in (ROOT / package).glob("*/__init__.py")}
    script = f"import aerodima.{package} as package\n"
    for name in folders & public_names(package):
        script += f"import aerodima.{package}.{name}\nassert callable(package.{name}), {name!r}\n"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_importing_the_packages_loads_none_of_their_modules() -> None:
    script = (
        "import sys; from aerodima import hardware, optimisation, workbench\n"
        "dir(workbench), dir(optimisation), dir(hardware)\n"
        "print(*sorted(name for name in sys.modules if name.startswith('aerodima.')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == {f"aerodima.{package}" for package in PACKAGES}
