"""Coefficients: values at the nodes, edges held, files that are the published tables, and bad
files.
"""

import math
from functools import partial

import pytest
import yaml

from aerodima.workbench.aero.coefficient_files import (
    coefficients_from_dict,
    embedded_sets,
    load_coefficients,
)
from aerodima.workbench.aero.polar_law import RegularTable
from aerodima.workbench.aero.section_laws import NormalForceLaw, SpeedTable, speed_line
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import models_dir, published_table
from tests.refusals import assert_refused
from tests.workbench.aero.published_coefficients import (
    cheetah_nodes,
    robot_tail_line,
    robot_tail_nodes,
    robot_tail_rows,
    weighted,
)

VALUES = ((1.0, 2.0, 4.0), (3.0, 6.0, 8.0))
TABLE = RegularTable((10.0, 20.0), (0.0, 0.5, 1.0), VALUES, ((True,) * 3,) * 2)


def test_a_table_is_bilinear_inside_and_holds_its_edge_outside():
    assert TABLE(15.0, 0.25) == pytest.approx((1.0 + 2.0 + 3.0 + 6.0) / 4)
    assert TABLE(10.0, 1.0) == 4.0
    assert TABLE(5.0, 0.0) == 1.0
    assert TABLE(99.0, 1.5) == 8.0
    assert TABLE.covers(20.0, 1.0)
    assert not TABLE.covers(20.1, 1.0)
    assert not TABLE.covers(15.0, 1.01)


def test_a_cell_with_a_seed_corner_is_not_measured():
    table = RegularTable(
        (10.0, 20.0), (0.0, 0.5), ((1.0, 1.0), (1.0, 1.0)), ((True, True), (True, False))
    )
    assert table.covers(10.0, 0.5)
    assert table.covers(20.0, 0.0)
    assert not table.covers(15.0, 0.25)


def test_speed_functions_hold_their_edge_values():
    table = SpeedTable((3.0, 5.0, 9.0), (1.0, 2.0, 0.0))
    assert [table(v) for v in (0.0, 4.0, 7.0, 20.0)] == [1.0, 1.5, 1.0, 0.0]
    line = speed_line(0.1, 1.0, (3.0, 15.0))
    assert [line(v) for v in (0.0, 10.0, 50.0)] == pytest.approx([1.3, 2.0, 2.5])
    assert line.covers(15.0)
    assert not line.covers(2.9)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: SpeedTable((3.0, 3.0), (1.0, 1.0)), ("3",)),
        (
            lambda: RegularTable((10.0, 5.0), (0.0, 0.5, 1.0), VALUES, ()),
            ("speeds[1]", "5.0", "10.0"),
        ),
        (lambda: NormalForceLaw(-1.0), ("coefficient", "-1")),
    ],
)
def test_unsorted_tables_and_a_negative_coefficient_are_refused(make, named):
    assert_refused(make, ModelError, *named)


def content_of(name):
    return yaml.safe_load((models_dir() / "coefficients" / f"{name}.yaml").read_text())


@pytest.mark.parametrize("axis", ["major", "minor"])
@pytest.mark.parametrize("tail", [1, 2, 3])
def test_the_cheetah_sets_are_what_the_published_tables_give(tail, axis):
    content = content_of(f"cheetah_tail_{tail}_{axis}")
    assert content["nodes"] == cheetah_nodes(tail, axis)
    for key, ends in content["range"].items():
        measured = [node[key] for node in content["nodes"] if node["status"] == "measured"]
        assert ends == [min(measured), max(measured)]


def test_the_other_sets_are_what_the_published_tables_give():
    average = content_of("robot_tail_weighted_average")
    line = content_of("robot_tail_line")
    assert average["nodes"] == robot_tail_nodes()
    assert line == line | robot_tail_line()
    speeds = [average["nodes"][0]["speed_m_per_s"], average["nodes"][-1]["speed_m_per_s"]]
    assert (
        average["range"]
        == line["range"]
        == content_of("robot_tail_constant")["range"]
        == {"speed_m_per_s": speeds}
    )
    shapes = published_table("shape_drag")
    drag = shapes[shapes.dimensionality == "2D"].set_index("row_in_table").cd
    plate = content_of("flat_plate")
    shell = content_of("half_cylinder")
    assert [plate["cn"], shell["cn_round_side"], shell["cn_hollow_side"]] == [
        drag[7],
        drag[2],
        drag[9],
    ]


def test_every_embedded_set_names_its_source_and_makes_a_law():
    for name in embedded_sets():
        coefficients = load_coefficients(name)
        assert "Table" in coefficients.source or "section" in coefficients.source
        force = coefficients.law().section_force(
            (0.0, 8.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0.02, 1.225
        )
        assert force[1] > 0.0, name  # pushed with the wind


def test_the_robot_tail_models_agree_with_the_errata():
    """E24: 160 distinct rows; E26: mean 1.996, resnorm-weighted 2.029, line 0.0449 v + 1.581."""
    rows = robot_tail_rows()
    assert len(rows) == 160
    assert rows.cd.mean() == pytest.approx(1.996, abs=5e-4)
    assert weighted(rows.cd, rows.resnorm) == pytest.approx(2.029, abs=5e-4)
    line = load_coefficients("robot_tail_line").law().coefficient
    assert line(10.0) == pytest.approx(0.0449 * 10 + 1.581, abs=2e-3)
    assert load_coefficients("robot_tail_constant").law().coefficient == 2.0


def test_the_cheetah_sets_say_which_nodes_are_measured():
    """ERRATA F: 9 of 18 nodes are seeds, 30 degrees is there for tail 1 only, and without 30 m/s
    (E1).
    """
    one = load_coefficients("cheetah_tail_1_major")
    assert len(one.nodes) == 18
    assert (one.nodes.status == "measured").sum() == 8
    assert (load_coefficients("cheetah_tail_3_minor").nodes.status == "measured").sum() == 6
    law = one.law()
    assert law.covers(10.0, math.radians(30.0))
    assert not law.covers(25.0, math.radians(25.0))
    assert not law.covers(10.0, math.radians(40.0))
    # The seed (0.7) at 30 degrees / 30 m/s is not used; the nearest measured speed is held.
    assert one.table("cd")(30.0, math.radians(30.0)) == pytest.approx(
        one.table("cd")(20.0, math.radians(30.0))
    )


def example():
    return {
        "schema": "aerodima/coefficients/1",
        "name": "example",
        "law": "polar",
        "kind": "table",
        "source": "made for this test",
        "quasi_steady_limit_m_per_s": 10.0,
        "range": {"speed_m_per_s": [5.0, 10.0], "angle_rad": [0.0, 1.0]},
        "nodes": [
            {"speed_m_per_s": v, "angle_rad": g, "cd": 1.0, "cl": 0.1, "status": "measured"}
            for g in (0.0, 1.0)
            for v in (5.0, 10.0)
        ],
    }


def as_normal(kind, **keys):
    """Changes the example to the normal-force law with these keys."""

    def change(content):
        del content["range"]["angle_rad"], content["nodes"]
        content.update(law="normal_force", kind=kind, **keys)

    return change


def test_lift_may_be_negative_and_drag_scatter_below_zero():
    """The lowest C_D of the published fits is -0.012."""
    content = example()
    content["nodes"][1]["cd"] = -0.012
    content["nodes"][0]["cl"] = -0.3
    assert coefficients_from_dict(content, "tail.yaml").law().lift(5.0, 0.0) == -0.3


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (lambda c: c["nodes"].pop(2), ("5.0", "1.0")),
        (lambda c: c["nodes"].reverse(), ("nodes[1]",)),
        (lambda c: c["nodes"][1].update(cd=math.nan), ("nodes.1.cd", "nan")),
        (lambda c: c.update(colour="red"), ("colour",)),
        (lambda c: c.update(source=" "), ("source",)),
        (lambda c: c["range"].update(speed_m_per_s=[10.0, 5.0]), ("range.speed_m_per_s",)),
        (lambda c: c.update(kind="spline"), ("spline",)),
        (
            lambda c: c["nodes"][0].update(status="guessed"),
            ("nodes.0.status", "'guessed'", "'measured'", "'seed'"),
        ),
        (lambda c: c["nodes"][1].update(cd=-3.0), ("nodes.1.cd", "-3.0", "-0.05")),
        (lambda c: c.update(nodes=[]), ("nodes",)),
        *(
            (as_normal("constant", cn=value), ("cn", shown))
            for value, shown in ((True, "True"), (math.inf, "inf"), (-1, "-1"))
        ),
        (as_normal("speed_line", cn_slope_s_per_m=-0.2, cn_intercept=1.5), ("-0.5", "10")),
        (
            as_normal(
                "speed_table",
                nodes=[{"speed_m_per_s": v, "cn": c} for v, c in ((1.0, 2.0), (2.0, -3.0))],
            ),
            ("nodes.1.cn", "-3.0"),
        ),
    ],
)
def test_bad_files_are_refused_with_their_place(spoil, named):
    content = example()
    spoil(content)
    assert_refused(
        lambda: coefficients_from_dict(content, "tail.yaml"), ModelError, "tail.yaml", *named
    )


@pytest.mark.parametrize("largest", [1.6, math.pi, 15.0])
def test_angles_beyond_90_degrees_are_refused(largest):
    """Of a polar over the chord, or in degrees; |gamma| knows no such angle."""
    content = example()
    content["range"]["angle_rad"] = [0.0, largest]
    for node in content["nodes"]:
        node["angle_rad"] *= largest
    named = ("tail.yaml", f"{largest:g} rad", "pi/2")
    assert_refused(lambda: coefficients_from_dict(content, "tail.yaml"), ModelError, *named)


def test_a_csv_table_loads_and_an_unknown_name_lists_the_sets(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text(
        "speed_m_per_s,angle_rad,cd,cl,source\n5,0,1,0,run 1\n9,0,2,0,run 1\n5,0.5,1,0.2,run "
        "2\n9,0.5,2,0.2,run 2\n"
    )
    coefficients = load_coefficients(path)
    assert coefficients.source == "run 1; run 2"
    assert coefficients.law().drag(7.0, 0.25) == pytest.approx(1.5)
    fast = tmp_path / "fast.csv"
    fast.write_text(path.read_text().replace("9,0,2", "fast,0,2"))
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"name: \xe9\xe8\n")
    for wrong, named in (
        ("robot_tale", ("robot_tale", "robot_tail_")),
        (tmp_path / "none.yaml", ("none.yaml",)),
        (fast, ("fast.csv", "'fast'", "'speed_m_per_s'")),
        (latin, ("latin.yaml",)),
    ):
        assert_refused(partial(load_coefficients, wrong), ModelError, *named)
