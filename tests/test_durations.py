"""The list of slow tests names tests that exist, and a test that is missing there is found."""

import ast
from types import SimpleNamespace

import pytest

from tests.durations import (
    BUDGETS,
    ROOT,
    machine_factor,
    read_budgets,
    read_durations,
    too_slow,
    write_durations,
)


@pytest.mark.parametrize("name", read_budgets(BUDGETS))
def test_every_entry_names_a_test_that_exists(name: str) -> None:
    path, _, test = name.partition("::")
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    assert test in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_a_slow_test_without_entry_and_one_above_its_entry_are_found() -> None:
    durations = {"a.py::test_new[x]": 3.1, "a.py::test_old[y]": 21.0, "a.py::test_quick": 0.1}
    lines = too_slow(durations, {"a.py::test_old": 10.0})
    assert [line.partition(":: ")[0].partition(": ")[0] for line in lines] == [
        "a.py::test_new[x]",
        "a.py::test_old[y]",
    ]
    assert too_slow(durations, {"a.py::test_old": 11.0, "a.py::test_new": 3.0}) == []


def test_on_a_machine_of_half_the_speed_one_slow_test_is_found_as_before() -> None:
    budgets = {f"a.py::test_{name}": 10.0 for name in "abcde"}
    seconds = zip(budgets, (9.0, 10.0, 9.0, 8.0, 21.0), strict=True)
    usual = {f"{name}[case]": value for name, value in seconds}
    slow = {name: 2.0 * value for name, value in usual.items()}
    assert machine_factor(usual, budgets) == 1.0
    assert machine_factor(slow, budgets) == pytest.approx(1.8)
    assert machine_factor({"b.py::test_new": 9.0}, budgets) == 1.0
    for durations in (usual, slow):
        lines = too_slow(durations, budgets, machine_factor(durations, budgets))
        assert [line.partition("[")[0] for line in lines] == ["a.py::test_e"]


def test_a_test_that_a_clock_or_a_number_of_draws_paces_is_not_timed(tmp_path) -> None:
    reports = [
        SimpleNamespace(nodeid=name, when="call", duration=9.0, keywords={mark: 1})
        for name, mark in (
            ("a.py::test_code", "slow"),
            ("a.py::test_drive", "emulated"),
            ("a.py::test_draws", "nightly"),
        )
    ]
    path = tmp_path / "durations.csv"
    write_durations({"passed": reports}, path)
    assert read_durations(path) == {"a.py::test_code": 9.0}
