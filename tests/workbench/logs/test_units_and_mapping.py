import math

import numpy as np
import pandas as pd
import pytest

from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.logs.importers import import_log
from aerodima.workbench.logs.mapping import load_mapping, mapping_from, unit_factor, unit_in_name
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

MAPPING = {
    "schema": "aerodima/log-mapping/1",
    "kind": "swing",
    "time": {"from": "t"},
    "columns": {
        "angle_rad": {"from": "theta", "unit": "deg"},
        "current_a": {"from": "I", "unit": "mA"},
    },
}


def changed(**parts):
    return {**MAPPING, **parts}


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("deg", "rad", math.pi / 180),
        ("°/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("rev/s", "rad/s", 2 * math.pi),
        ("rev", "rad", 2 * math.pi),
        ("min", "s", 60.0),
        ("ns", "s", 1e-9),
        ("kgf cm", "N m", 0.0980665),
        ("mN m", "N m", 1e-3),
        ("Ncm", "N m", 1e-2),
        ("gf", "N", 9.80665e-3),
        ("mg", "m/s2", 9.80665e-3),
        ("mA", "A", 1e-3),
        ("ms", "s", 1e-3),
        ("g", "m/s2", 9.80665),
        ("g", "kg", 1e-3),
        ("km/h", "m/s", 1 / 3.6),
        ("mph", "m/s", 0.44704),
        ("kn", "m/s", 0.514444),
        ("Nmm", "N m", 1e-3),
        ("kgf", "N", 9.80665),
        ("%", "", 0.01),
    ],
)
def test_a_unit_has_its_factor(unit, si, factor):
    assert unit_factor(unit, si, "here") == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize(
    ("unit", "si", "named"), [("deg", "N", ["deg", "N"]), ("degs", "rad", ["degs", "'deg'"])]
)
def test_a_unit_of_another_quantity_is_refused_by_name(unit, si, named):
    assert_refused(lambda: unit_factor(unit, si, "here"), LogError, "here", *named)


def test_the_unit_at_the_end_of_a_name():
    assert unit_in_name("wind_speed_m_per_s") == "m/s"
    assert unit_in_name("torque_x_n_m") == "N m"
    assert unit_in_name("lift_impulse_n_s") == "N s"
    assert unit_in_name("axis") == ""


def test_metadata_become_si():
    mapping = mapping_from(
        changed(
            metadata={
                "tail": 2,
                "wind_speed_m_per_s": {"value": 36, "unit": "km/h"},
                "rest_s": [0, 2.5],
            }
        )
    )
    assert mapping.facts == {
        "tail": 2,
        "wind_speed_m_per_s": pytest.approx(10.0),
        "rest_s": (0.0, 2.5),
    }


ANGLE = {"from": "a"}
CONSTANT = {"constant": 5, "unit": "deg", "scale": 1, "zero": 0, "time": "t", "time_unit": "s"}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"kinds": 1}, ["kinds", "'kind'"]),
        ({"schema": "aerodima/log-mapping/9"}, ["schema", "aerodima/log-mapping/9"]),
        ({"kind": "flight"}, ["kind", "'flight'", "'static'"]),
        ({"time": {"from": "t", "unit": "deg"}}, ["time", "'deg'"]),
        ({"columns": {}}, ["columns"]),
        ({"columns": {"angle_deg": ANGLE}}, ["columns.angle_deg", "'angle_rad'"]),
        ({"columns": {"angle_rad": {"form": "a"}}}, ["columns.angle_rad.form", "'from'"]),
        ({"columns": {"angle_rad": {**ANGLE, "constant": 1}}}, ["`from`", "`constant`"]),
        (
            {"columns": {"angle_rad": CONSTANT}},
            ["columns.angle_rad", "constant", "scale, time, time_unit, unit, zero"],
        ),
        ({"columns": {"angle_rad": {**ANGLE, "unit": "mA"}}}, ["columns.angle_rad", "'mA'"]),
        ({"columns": {"angle_rad": {**ANGLE, "scale": 0}}}, ["columns.angle_rad.scale", "0"]),
        (
            {"columns": {"angle_rad": {**ANGLE, "zero": float("nan")}}},
            ["columns.angle_rad.zero", "nan"],
        ),
        ({"columns": {"time_s": {"from": "t"}}}, ["columns.time_s", "`time`"]),
        ({"columns": {"current_a": {"from": "I"}}}, ["'swing'", "angle_rad"]),
        (
            {"columns": {"angle_deg": ANGLE, "time_s": ANGLE, "current_a": {**ANGLE, "unit": "m"}}},
            ["columns.angle_deg", "columns.time_s", "columns.current_a", "needs angle_rad"],
        ),
        (
            {"metadata": {"wind_speed_m_per_s": {"value": 1, "unit": "mA"}}},
            ["metadata.wind_speed_m_per_s", "'mA'"],
        ),
    ],
)
def test_a_wrong_mapping_names_the_place(change, named):
    assert_refused(lambda: mapping_from(changed(**change), "f.yaml"), LogError, "f.yaml", *named)


def test_a_scenario_file_is_found_from_the_mapping_that_names_it(tmp_path, monkeypatch):
    """Also from another working folder, where a file of that name is another car."""
    folder = tmp_path / "logs"
    elsewhere = tmp_path / "elsewhere"
    for place, mass in ((folder / "cars", 3.9), (elsewhere / "cars", 2.0)):
        place.mkdir(parents=True)
        (place / "mine.yaml").write_text(f"base: f1tenth\ncar: {{mass: {mass}}}\n")
    pd.DataFrame({"t": np.arange(50) / 50.0, "v": 3.0}).to_csv(folder / "log.csv", index=False)
    head = "schema: aerodima/log-mapping/1\nkind: car_log\ntime: {from: t}\n"
    columns = "columns: {speed_m_per_s: {from: v}}\n"
    mapping = folder / "mapping.yaml"
    monkeypatch.chdir(elsewhere)

    def mass_of(base):
        mapping.write_text(f"{head}{columns}scenario: {{base: {base}}}\n")
        log = import_log(folder / "log.csv", load_mapping(mapping)).run_log
        return log.scenario["car"]["mass"]

    assert mass_of("cars/mine.yaml") == 3.9
    assert mass_of(elsewhere / "cars/mine.yaml") == 2.0
    assert mass_of("f1tenth") == load_scenario("f1tenth").car.mass
    assert_refused(lambda: mass_of("none.yaml"), UserError, str(folder / "none.yaml"))


def test_a_file_that_is_missing_or_not_yaml_is_named(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("a: [1")
    for path in (tmp_path / "none.yaml", broken):
        assert_refused(lambda path=path: load_mapping(path), LogError, path.name)
