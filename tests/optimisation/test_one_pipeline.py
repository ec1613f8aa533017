"""Every fit is a least-squares problem in `MathematicalProgram`: no other optimiser, no second
way.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram

from aerodima.optimisation.identify import least_squares_solvers
from aerodima.optimisation.identify.published_check import fit_line, robot_tail_line

ROOT = Path(least_squares_solvers.__file__).parent


def _imports(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_identification_uses_no_other_optimiser() -> None:
    modules = [*ROOT.glob("*.py")]
    assert len(modules) > 10
    for path in modules:
        # The root of an equation in one unknown is no fit.
        others = [
            name
            for name in _imports(path) - {"scipy.optimize.brentq"}
            if name.startswith("scipy.optimize")
        ]
        assert not others, path.name
    users = {path.name for path in modules if "MathematicalProgram" in path.read_text()}
    assert users <= {"least_squares.py", "least_squares_solvers.py"}


@pytest.mark.parametrize(
    "act",
    [
        robot_tail_line,
        lambda: fit_line(
            np.arange(9.0), np.arange(9.0) ** 1.1, ("a", "1"), ("b", "1"), name="", channel="y"
        ),
    ],
    ids=["robot tail", "line"],
)
def test_a_fit_is_solved_in_mathematical_program(
    monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]
) -> None:
    programs = []

    class Counted(MathematicalProgram):
        def __init__(self) -> None:
            super().__init__()
            programs.append(self)

    monkeypatch.setattr(least_squares_solvers, "MathematicalProgram", Counted)
    act()
    assert programs
