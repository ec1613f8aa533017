import math
from pathlib import Path
from typing import Any

import pytest

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.mapping import load_mapping, mapping_from, unit_factor, unit_in_name

MAPPING: dict[str, Any] = {
    "schema": "aerodima/log-mapping/1",
    "kind": "swing",
    "time": {"from": "t"},
    "columns": {
        "angle_rad": {"from": "theta", "unit": "deg"},
        "current_a": {"from": "I", "unit": "mA"},
    },
}


def changed(**parts: Any) -> dict[str, Any]:
    return {**MAPPING, **parts}


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("deg", "rad", math.pi / 180),
        ("°/s", "rad/s", math.pi / 180),
        ("rpm", "rad/s", 2 * math.pi / 60),
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
def test_a_unit_has_its_factor(unit: str, si: str, factor: float) -> None:
    assert unit_factor(unit, si, "here") == pytest.approx(factor, rel=1e-6)


def test_a_unit_of_another_quantity_is_refused_by_name() -> None:
    with pytest.raises(
        LogError, match=r"here: unit 'deg' does not measure what is in N; allowed: N, mN"
    ):
        unit_factor("deg", "N", "here")
    with pytest.raises(LogError, match=r"here: unknown unit 'degs'; did you mean 'deg'"):
        unit_factor("degs", "rad", "here")


def test_the_unit_at_the_end_of_a_name() -> None:
    assert unit_in_name("wind_speed_m_per_s") == "m/s"
    assert unit_in_name("torque_x_n_m") == "N m"
    assert unit_in_name("axis") == "1"


def test_metadata_become_si() -> None:
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kinds": 1}, r"f\.yaml: kinds: unknown key; did you mean 'kind'"),
        (
            {"schema": "aerodima/log-mapping/9"},
            r"f\.yaml: schema: 'aerodima/log-mapping/9' is not allowed",
        ),
        ({"kind": "flight"}, r"f\.yaml: kind: 'flight' is not allowed; .*'static'"),
        (
            {"time": {"from": "t", "unit": "deg"}},
            r"f\.yaml: time: unit 'deg' does not measure what is in s",
        ),
        ({"columns": {}}, r"f\.yaml: columns: .* not allowed"),
        (
            {"columns": {"angle_deg": {"from": "a"}}},
            r"columns\.angle_deg: no such column; did you mean 'angle_rad'",
        ),
        (
            {"columns": {"angle_rad": {"form": "a"}}},
            r"columns\.angle_rad\.form: unknown key; did you mean 'from'",
        ),
        ({"columns": {"angle_rad": {}}}, r"columns\.angle_rad: needs either `from` or `constant`"),
        (
            {"columns": {"angle_rad": {"from": "a", "constant": 1}}},
            r"needs either `from` or `constant`",
        ),
        (
            {"columns": {"angle_rad": {"from": "a", "unit": "mA"}}},
            r"columns\.angle_rad: unit 'mA' does not measure",
        ),
        (
            {"columns": {"angle_rad": {"from": "a", "scale": 0}}},
            r"columns\.angle_rad\.scale: a scale of 0",
        ),
        (
            {"columns": {"angle_rad": {"from": "a", "zero": float("nan")}}},
            r"columns\.angle_rad\.zero: nan is not",
        ),
        ({"columns": {"time_s": {"from": "t"}}}, r"times are mapped under `time`"),
        ({"columns": {"current_a": {"from": "I"}}}, r"kind 'swing' needs angle_rad"),
        (
            {"metadata": {"wind_speed_m_per_s": {"value": 1, "unit": "mA"}}},
            r"metadata\.wind_speed_m_per_s: unit 'mA'",
        ),
        ({"csv": {"delimeter": ";"}}, r"csv\.delimeter: unknown key; did you mean 'delimiter'"),
    ],
)
def test_a_wrong_mapping_is_one_line_that_names_the_place(
    change: dict[str, Any], message: str
) -> None:
    with pytest.raises(LogError, match=message) as caught:
        mapping_from(changed(**change), "f.yaml")
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing_or_not_yaml_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.yaml: no such file"):
        load_mapping(tmp_path / "none.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("a: [1")
    with pytest.raises(LogError, match=r"broken\.yaml: not YAML"):
        load_mapping(broken)
