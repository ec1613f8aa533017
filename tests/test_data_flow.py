"""The page on data flow is true: its picture is that of the imports, its walks lead through files that do the work."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import yaml

from tests.import_picture import PICTURE, Panel, draw, folder_arrows, reduced

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "concepts" / "data_flow.md").read_text(encoding="utf-8")
STEP = re.compile(r"^\| \[`(?P<file>[\w/.]+)`\]\[(?P<link>\w+)\] \| `(?P<name>[\w.]+)` \|", re.M)
LINKS = dict(re.findall(r"^\[(\w+)\]: (\S+)$", PAGE, re.M))
HOLD = ROOT / "tests" / "data" / "old_files" / "dd7ec6c" / "hold.parquet"
"""Any static log."""


def walk(title: str) -> list[tuple[str, str, str]]:
    """File, link and function of each step of a chapter."""
    chapter = PAGE.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]
    return [(step["file"], LINKS[step["link"]], step["name"]) for step in STEP.finditer(chapter)]


WALKS = {title: walk(title) for title in re.findall(r"^## (.*)$", PAGE, re.M)}
STEPS = [step for steps in WALKS.values() for step in steps]


def holds(tree: ast.AST, name: str) -> bool:
    """Whether a module or class has a function, class or field of this dotted name."""
    first, _, rest = name.partition(".")
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == first:
            return not rest or holds(node, rest)
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
            return True
    return False


def called(work: Callable[[], Any]) -> list[tuple[str, str]]:
    """File and name of every function of ours that some work calls, in the order of the first calls."""
    seen: dict[tuple[str, str], None] = {}

    def look(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and "aerodima" in frame.f_globals.get("__name__", ""):
            file = Path(code.co_filename).resolve()
            seen.setdefault((file.relative_to(ROOT).as_posix(), code.co_qualname))

    sys.setprofile(look)
    try:
        work()
    finally:
        sys.setprofile(None)
    return list(seen)


def test_picture_is_that_of_the_imports() -> None:
    assert PICTURE.read_text(encoding="utf-8") == draw(), "run `python -m tests.import_picture`"


def test_picture_shows_every_folder_below_all_that_it_imports() -> None:
    arrows = {(a[1], b[1]) for a, b in folder_arrows() if a[0] == b[0] == "workbench"}
    panel = Panel("workbench", sorted(arrows))
    assert all(panel.y[start] < panel.y[end] for start, end in arrows)


def test_an_arrow_that_others_imply_is_left_out() -> None:
    a, b, c = ("workbench", "config"), ("workbench", "aero"), ("workbench", "plants")
    assert reduced({(a, b), (b, c), (a, c)}) == {(a, b), (b, c)}


def test_there_are_three_walks() -> None:
    assert [len(steps) >= 8 for steps in WALKS.values()] == [True] * 3


@pytest.mark.parametrize(("file", "link", "name"), STEPS, ids=lambda part: part)
def test_step_of_a_walk_leads_to_a_function_that_is_there(file: str, link: str, name: str) -> None:
    path = ROOT / file
    assert path.is_file()
    if path.suffix == ".yaml":
        assert name in yaml.safe_load(path.read_text(encoding="utf-8"))
        return
    assert holds(ast.parse(path.read_text(encoding="utf-8")), name)
    package, folder, module = file.removesuffix(".py").split("/")
    assert link == f"../reference/aerodima.{package}.{folder}.md#{module}"


def test_height_of_the_centre_of_mass_takes_the_walk() -> None:
    from aerodima.workbench import load_scenario
    from aerodima.workbench.config.scenario import _values_of
    from aerodima.workbench.simulate.simulation import simulate

    _values_of.cache_clear()  # parameter files that another test has read are not read again

    def work() -> None:
        settings = ["car.com_height=0.21", "manoeuvre.duration=2.1", "simulation.step=0.005", "simulation.log_rate=100"]
        simulate(load_scenario("turn_none", settings), record="outcome")

    found = called(work)
    title = next(title for title in WALKS if "centre of mass" in title)
    assert {(file, name) for file, _, name in WALKS[title][1:] if name != "CarParameters.com_height"} <= {*found}


def test_static_log_takes_the_walk() -> None:
    from aerodima.optimisation import fit_static_log

    found = called(lambda: fit_static_log(str(HOLD)))
    title = next(title for title in WALKS if "static log" in title)
    assert {(file, name) for file, _, name in WALKS[title]} <= {*found}
