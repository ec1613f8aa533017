"""Aims of a user's file: what is wrong with one is said in a line, before anything is searched."""

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.reduced_swerves import check_aims
from aerodima.workbench.core.errors import UserError
from tests.commands import refused
from tests.refusals import assert_refused

AIMS = """from aerodima.workbench import aside


def good(swerve):
    return aside(swerve) + 0.1


def raises(swerve):
    return 1 // 0


def scalar(swerve):
    return 3.25


def rows(swerve):
    return swerve.time[:2, None] * aside(swerve)


def text(swerve):
    return "far"


def two(swerve, other):
    return aside(swerve)


def nothing(swerve):
    return float("nan") * aside(swerve)
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "aims.py"
    path.write_text(AIMS)
    return path


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("raises", ("ZeroDivisionError", "aims.py, line 9", "number per car")),
        ("scalar", ("3.25", "number per car, (2,)")),
        ("rows", ("[[", "number per car, (2,)")),
        ("text", ("'far'", "number per car")),
        ("two", ("other", "take a Swerve")),
        ("nothing", ("nan", "finite")),
        ("absent", ("no function absent",)),
    ],
)
def test_a_wrong_aim_is_refused_with_its_place_and_value(file, name, named):
    assert_refused(lambda: check_aims([f"{file}:{name}"]), UserError, "aims.py", *named)


@pytest.mark.parametrize(
    ("text", "named"),
    [("def f(s:\n", "line 1"), ("one = 1\ntwo = three\n", "aims.py, line 2")],
)
def test_a_file_that_cannot_be_run_is_refused_with_its_line(file, text, named):
    file.write_text(text)
    assert_refused(lambda: check_aims([f"{file}:f"]), UserError, "aims.py", named)
    with pytest.raises(UserError) as caught:
        check_aims([f"{file}:f"])
    assert "importlib" not in str(caught.value)


def test_the_command_refuses_an_aim_before_it_makes_a_folder(file, tmp_path):
    out = tmp_path / "out"
    assert "line 9" in refused("swing", "search", "--aim", f"{file}:raises", "--out", out)
    assert not out.exists()


def test_the_command_says_at_once_what_compiles_reduced_cars_and_how_to_get_it(
    tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    message = refused("swing", "search", "--out", tmp_path / "out")
    assert "llvmlite" in message
    assert "pip install" in message
    assert "[search]" in message


@dataclass(frozen=True)
class Item:
    """An item of a search, as far as its key goes."""

    aim: str


def size_of_file(item):
    return Path(item.aim.partition(":")[0]).stat().st_size


def test_results_of_an_aim_are_made_again_when_its_file_has_changed(file):
    runs = CachedRunner()
    items = [Item(f"{file}:good")]
    (before,) = runs.map(size_of_file, items)
    assert runs.map(size_of_file, items) == [before]
    file.write_text(AIMS.replace("0.1", "0.25"))
    assert runs.map(size_of_file, items) == [before + 1]
    assert runs.ran == 2


def test_an_aim_that_is_named_twice_is_refused_and_does_not_count_twice(tmp_path):
    twice = ("--aim", "course", "--aim", "course", "--out", tmp_path / "out")
    for command in ("judge", "train"):
        assert "aim 'course': duplicate" in refused("swing", command, *twice)
