"""Coefficients: values at the nodes, edges held, files that are the published tables, and bad
files.
"""

from __future__ import annotations

import math
from copy import deepcopy

import pytest
import yaml

from aerodima.workbench.aero.coefficient_files import (
    coefficients_from_dict,
    embedded_sets,
    load_coefficients,
)
from aerodima.workbench.aero.laws import NormalForceLaw, SpeedLine, SpeedTable
from aerodima.workbench.aero.polar_law import PolarLaw, RegularTable
from aerodima.workbench.errors import ModelError
from aerodima.workbench.resources import models_dir, published_table
from tests.workbench.aero.published_coefficients import (
    cheetah_nodes,
    robot_tail_line,
    robot_tail_nodes,
    robot_tail_rows,
    weighted,
)

TABLE = RegularTable((10.0, 20.0), (0.0, 0.5, 1.0), ((1.0, 2.0, 4.0), (3.0, 6.0, 8.0)))


def test_a_table_is_bilinear_inside_and_holds_its_edge_outside() -> None:
    assert TABLE(15.0, 0.25) == pytest.approx((1.0 + 2.0 + 3.0 + 6.0) / 4)
    assert TABLE(10.0, 1.0) == 4.0
    assert TABLE(5.0, 0.0) == 1.0
    assert TABLE(99.0, 1.5) == 8.0
    assert TABLE.covers(20.0, 1.0)
    assert not TABLE.covers(20.1, 1.0)
    assert not TABLE.covers(15.0, 1.01)


def test_a_cell_with_a_seed_corner_is_not_measured() -> None:
    table = RegularTable(
        (10.0, 20.0), (0.0, 0.5), ((1.0, 1.0), (1.0, 1.0)), ((True, True), (True, False))
    )
    assert table.covers(10.0, 0.5)
    assert table.covers(20.0, 0.0)
    assert not table.covers(15.0, 0.25)


def test_speed_functions_hold_their_edge_values() -> None:
    table = SpeedTable((3.0, 5.0, 9.0), (1.0, 2.0, 0.0))
    assert [table(v) for v in (0.0, 4.0, 7.0, 20.0)] == [1.0, 1.5, 1.0, 0.0]
    line = SpeedLine(0.1, 1.0, (3.0, 15.0))
    assert [line(v) for v in (0.0, 10.0, 50.0)] == pytest.approx([1.3, 2.0, 2.5])
    assert line.covers(15.0)
    assert not line.covers(2.9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SpeedTable((3.0, 3.0), (1.0, 1.0)), "increase strictly"),
        (lambda: SpeedTable((3.0, 4.0), (1.0, math.nan)), r"values\[1\]"),
        (lambda: SpeedTable((3.0,), (1.0,)), "at least 2"),
        (
            lambda: RegularTable((10.0, 5.0), (0.0, 1.0), ((1.0, 1.0), (1.0, 1.0))),
            r"speeds\[1\] = 5.0 follows 10.0",
        ),
        (
            lambda: RegularTable((5.0, 10.0), (0.0, 1.0), ((1.0, math.nan), (1.0, 1.0))),
            r"values\[0\]\[1\]",
        ),
        (lambda: RegularTable((5.0, 10.0), (0.0, 1.0), ((1.0,), (1.0, 1.0))), "2 rows"),
        (lambda: NormalForceLaw(-1.0), "coefficient: -1; allowed: >= 0"),
        (
            lambda: PolarLaw(RegularTable((5.0, 9.0), (0.0, 1.0), ((1.0, -1.0), (1.0, 1.0)))),
            "-1.0.*add energy",
        ),
    ],
)
def test_unsorted_tables_holes_and_nan_are_refused(make, message) -> None:
    with pytest.raises(ModelError, match=message):
        make()


def content_of(name: str) -> dict:
    return yaml.safe_load((models_dir() / "coefficients" / f"{name}.yaml").read_text())


@pytest.mark.parametrize("axis", ["major", "minor"])
@pytest.mark.parametrize("tail", [1, 2, 3])
def test_the_cheetah_sets_are_what_the_published_tables_give(tail: int, axis: str) -> None:
    content = content_of(f"cheetah_tail_{tail}_{axis}")
    assert content["nodes"] == cheetah_nodes(tail, axis)
    for key, ends in content["range"].items():
        measured = [node[key] for node in content["nodes"] if node["status"] == "measured"]
        assert ends == [min(measured), max(measured)]


def test_the_other_sets_are_what_the_published_tables_give() -> None:
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


def test_every_embedded_set_names_its_source_and_makes_a_law() -> None:
    for name in embedded_sets():
        coefficients = load_coefficients(name)
        assert "Table" in coefficients.source or "section" in coefficients.source
        force = coefficients.law().section_force(
            (0.0, 8.0, 1.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0.02, 1.225
        )
        assert force[1] > 0.0, name  # pushed with the wind


def test_the_robot_tail_models_agree_with_the_errata() -> None:
    """E24: 160 distinct rows; E26: mean 1.996, resnorm-weighted 2.029, line 0.0449 v + 1.581."""
    rows = robot_tail_rows()
    assert len(rows) == 160
    assert rows.cd.mean() == pytest.approx(1.996, abs=5e-4)
    assert weighted(rows.cd, rows.resnorm) == pytest.approx(2.029, abs=5e-4)
    line = load_coefficients("robot_tail_line").law().coefficient
    assert line(10.0) == pytest.approx(0.0449 * 10 + 1.581, abs=2e-3)
    assert load_coefficients("robot_tail_constant").law().coefficient == 2.0


def test_the_cheetah_sets_say_which_nodes_are_measured() -> None:
    """ERRATA F: 9 of 18 nodes are seeds, 30 degrees is there for tail 1 only, and without 30 m/s
    (E1).
    """
    one = load_coefficients("cheetah_tail_1_major")
    assert len(one.nodes) == 18
    assert len(one.measured_nodes()) == 8
    assert len(load_coefficients("cheetah_tail_3_minor").measured_nodes()) == 6
    law = one.law()
    assert law.covers(10.0, math.radians(30.0))
    assert not law.covers(25.0, math.radians(25.0))
    assert not law.covers(10.0, math.radians(40.0))
    # The seed (0.7) at 30 degrees / 30 m/s is not used; the nearest measured speed is held.
    assert one.table("cd")(30.0, math.radians(30.0)) == pytest.approx(
        one.table("cd")(20.0, math.radians(30.0))
    )


def example() -> dict:
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


def as_normal(kind: str, **keys):
    """Changes the example to the normal-force law with these keys."""

    def change(content: dict) -> None:
        del content["range"]["angle_rad"], content["nodes"]
        content.update(law="normal_force", kind=kind, **keys)

    return change


def test_lift_may_be_negative_and_drag_scatter_below_zero() -> None:
    """The lowest C_D of the published fits is -0.012."""
    content = example()
    content["nodes"][1]["cd"] = -0.012
    content["nodes"][0]["cl"] = -0.3
    assert coefficients_from_dict(content, "tail.yaml").law().lift(5.0, 0.0) == -0.3


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda c: c["nodes"].pop(2), "hole in the table: no node at 5.0 m/s, 1.0 rad"),
        (lambda c: c["nodes"].reverse(), "must increase by angle"),
        (lambda c: c["nodes"][1].update(cd=math.nan), r"nodes\.1\.cd: nan"),
        (lambda c: c["nodes"][1].update(cd="much"), r"nodes\.1\.cd: 'much'.*number"),
        (lambda c: c.update(colour="red"), "colour: unknown key"),
        (lambda c: c.pop("source"), "source: missing"),
        (lambda c: c.update(source=" "), "source: is empty"),
        (lambda c: c.update(schema="other"), "schema: 'other'"),
        (lambda c: c["range"].update(speed_m_per_s=[10.0, 5.0]), "range.speed_m_per_s"),
        (lambda c: c.update(kind="spline"), "polar/spline"),
        (
            lambda c: c["nodes"][0].update(status="guessed"),
            "nodes.0.status: 'guessed'.*'measured' or 'seed'",
        ),
        (lambda c: c["nodes"][0].update(status=["seed"]), "'measured' or 'seed'"),
        (
            lambda c: c["nodes"][1].update(cd=-3.0),
            r"nodes\.1\.cd: -3.0; allowed: >= -0.05.*add energy",
        ),
        (lambda c: c.update(nodes=3), "nodes: 3 is not allowed.*tuple"),
        (lambda c: c.update(nodes=[]), "nodes: .* at least 1 item"),
        (lambda c: c["nodes"].append(4), r"nodes\.4: 4 is not allowed.*dictionary"),
        (
            lambda c: c["range"].update(speed_m_per_s=[[1.0], 2.0]),
            r"range.speed_m_per_s.0: \[1.0\].*a valid number",
        ),
        (
            lambda c: c.update(quasi_steady_limit_m_per_s=[1.0]),
            r"limit_m_per_s: \[1.0\].*a valid number",
        ),
        (as_normal("constant", cn=[1, 2]), r"cn: \[1, 2\].*a valid number"),
        (as_normal("constant", cn="2"), "cn: '2'.*a valid number"),
        (as_normal("constant", cn=True), "cn: True.*a valid number"),
        (as_normal("constant", cn=math.inf), "cn: inf.*finite"),
        (as_normal("constant", cn=-1), "cn: -1.*add energy"),
        (
            as_normal("speed_line", cn_slope_s_per_m=-0.2, cn_intercept=1.5),
            "give -0.5 at 10 m/s.*add energy",
        ),
        (
            as_normal(
                "speed_table",
                nodes=[{"speed_m_per_s": v, "cn": c} for v, c in ((1.0, 2.0), (2.0, -3.0))],
            ),
            r"nodes\.1\.cn: -3.0.*add energy",
        ),
    ],
)
def test_bad_files_are_refused_with_their_place(spoil, message) -> None:
    content = deepcopy(example())
    spoil(content)
    with pytest.raises(ModelError, match=message) as caught:
        coefficients_from_dict(content, "tail.yaml")
    assert "tail.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_angles_in_degrees_warn_and_name_the_file() -> None:
    content = example()
    content["range"]["angle_rad"] = [0.0, 15.0]
    for node in content["nodes"]:
        node["angle_rad"] *= 15.0
    with pytest.warns(UserWarning, match=r"tail\.yaml.*15\.0 rad.*degrees"):
        coefficients_from_dict(content, "tail.yaml")


def test_a_csv_table_loads_and_an_unknown_name_lists_the_sets(tmp_path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(
        "speed_m_per_s,angle_rad,cd,cl,source\n5,0,1,0,run 1\n9,0,2,0,run 1\n5,0.5,1,0.2,run "
        "2\n9,0.5,2,0.2,run 2\n"
    )
    coefficients = load_coefficients(path)
    assert coefficients.source == "run 1; run 2"
    assert coefficients.law().drag(7.0, 0.25) == pytest.approx(1.5)
    with pytest.raises(
        ModelError, match="models/coefficients has none of this name; did you mean 'robot_tail_"
    ):
        load_coefficients("robot_tale")
    with pytest.raises(ModelError, match="no such file"):
        load_coefficients(tmp_path / "none.yaml")
    path.write_text(path.read_text().replace("9,0,2", "fast,0,2"))
    with pytest.raises(ModelError, match=r"mine\.csv: .*'fast'.*'speed_m_per_s'"):
        load_coefficients(path)
    (tmp_path / "latin.yaml").write_bytes(b"name: \xe9\xe8\n")
    with pytest.raises(ModelError, match=r"latin\.yaml: cannot be read"):
        load_coefficients(tmp_path / "latin.yaml")
