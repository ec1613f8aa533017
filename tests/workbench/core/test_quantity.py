"""Numbers with units: read in their own unit, refused in any other by key, value and unit."""

import math
from typing import Literal

import pytest
from pydantic import ValidationError

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.quantity import QuantityModel, quantity, unit_of
from aerodima.workbench.core.ranges import NO_UNIT
from aerodima.workbench.core.yaml_files import checked
from tests.refusals import assert_refused


class Spring(QuantityModel):
    stiffness: float = quantity("N/m", "rate", gt=0, le=100)
    turns: int = quantity("1", "number of turns", ge=1)
    kind: Literal["coil", "leaf"] = quantity("1", "shape")


GOOD = {"stiffness": 5.0, "turns": 3, "kind": "coil"}


@pytest.mark.parametrize("text", ["5 N/m", "5.0 N/m", " 5e0  N/m ", "5.0"])
def test_number_in_its_own_unit_is_read(text):
    assert Spring.model_validate(GOOD | {"stiffness": text}).stiffness == 5.0


def test_section_is_frozen():
    with pytest.raises(ValidationError):
        Spring.model_validate(GOOD).stiffness = 6.0


def test_unit_is_kept_with_the_field():
    assert unit_of(Spring, "stiffness") == "N/m"
    assert unit_of(Spring, "turns") == NO_UNIT == "1"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        *(
            ({"stiffness": f"5 {unit}"}, ("stiffness", f"'{unit}'", "'N/m'"))
            for unit in ("N/mm", "kN/m", "n/m", "N m")
        ),
        ({"stiffness": "soft"}, ("stiffness", "'soft'", "N/m")),
        *(
            ({"stiffness": value}, ("stiffness",))
            for value in (math.nan, math.inf, -math.inf, "nan N/m", "inf N/m", True)
        ),
        ({"stiffness": 101.0}, ("stiffness", "101.0", "100", "N/m")),
        ({"stiffness": 0.0}, ("stiffness", "0", "N/m")),
        ({"turns": 3.0}, ("turns", "3.0")),
        ({"turns": True}, ("turns",)),
        ({"kind": "disc"}, ("kind", "'disc'", "'coil'", "'leaf'")),
        ({"stifness": 5.0}, ("stifness", "'stiffness'")),
        ({"colour": "red"}, ("colour", "kind", "stiffness", "turns")),
        ({"stiffness": -1.0, "turns": 0}, ("stiffness", "-1.0", "turns", "0")),
        ({"stiffness": None}, ("stiffness",)),
    ],
    ids=str,
)
def test_wrong_value_is_refused_by_file_key_and_unit(changes, named):
    wrong = {key: value for key, value in (GOOD | changes).items() if value is not None}
    assert_refused(
        lambda: checked(Spring, wrong, "spring.yaml"), ScenarioError, "spring.yaml", *named
    )
