"""Numbers with units: read in their own unit, refused in any other, and errors that say what is
allowed.
"""

from typing import Literal

import pytest
from pydantic import ValidationError

from aerodima.workbench.config.checked_files import (
    NO_UNIT,
    QuantityModel,
    checked,
    nearest,
    quantity,
    unit_of,
)
from aerodima.workbench.errors import ScenarioError


class Spring(QuantityModel):
    stiffness: float = quantity("N/m", "rate", gt=0, le=100)
    turns: int = quantity("1", "number of turns", ge=1)
    kind: Literal["coil", "leaf"] = quantity("1", "shape")


GOOD = {"stiffness": 5.0, "turns": 3, "kind": "coil"}


def refusal(**changes) -> str:
    with pytest.raises(ScenarioError) as caught:
        checked(Spring, GOOD | changes, "spring.yaml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("text", ["5 N/m", "5.0 N/m", " 5e0  N/m ", "5.0"])
def test_number_in_its_own_unit_is_read(text):
    assert Spring.model_validate(GOOD | {"stiffness": text}).stiffness == 5.0


@pytest.mark.parametrize("text", ["5 N/mm", "5 kN/m", "5 n/m", "5 N m"])
def test_other_unit_is_refused_and_not_converted(text):
    unit = text.split(" ", 1)[1]
    assert (
        refusal(stiffness=text)
        == f"spring.yaml: stiffness: {text!r} has the unit {unit!r}; allowed is 'N/m'"
    )


def test_text_that_is_no_number_is_refused_with_the_unit():
    assert refusal(stiffness="soft") == (
        "spring.yaml: stiffness: 'soft' is not allowed; input should be a valid number (N/m)"
    )


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), "nan N/m", "inf N/m"])
def test_numbers_that_are_not_finite_are_refused(value):
    assert "stiffness" in refusal(stiffness=value)
    assert "finite" in refusal(stiffness=value)


def test_range_is_named_with_its_unit():
    assert refusal(stiffness=101.0) == (
        "spring.yaml: stiffness: 101.0 is not allowed; input should be less than or equal to 100 "
        "(N/m)"
    )
    assert "greater than 0 (N/m)" in refusal(stiffness=0.0)


def test_types_are_strict():
    assert "stiffness" in refusal(stiffness=True)
    assert "turns" in refusal(turns=3.0)
    assert "turns" in refusal(turns=True)
    assert "'coil' or 'leaf'" in refusal(kind="disc")


def test_unknown_key_is_answered_with_the_nearest():
    assert refusal(stifness=5.0) == "spring.yaml: stifness: unknown key; did you mean 'stiffness'?"
    assert refusal(colour="red").endswith("unknown key; allowed: kind, stiffness, turns")


def test_every_fault_is_told_at_once():
    assert refusal(stiffness=-1.0, turns=0).count("spring.yaml: ") == 2


def test_missing_key_is_named():
    with pytest.raises(ScenarioError, match=r"^spring\.yaml: stiffness: missing$"):
        checked(Spring, {"turns": 3, "kind": "coil"}, "spring.yaml")


def test_section_is_frozen():
    with pytest.raises(ValidationError):
        Spring.model_validate(GOOD).stiffness = 6.0


def test_unit_is_kept_with_the_field():
    assert unit_of(Spring, "stiffness") == "N/m"
    assert unit_of(Spring, "turns") == NO_UNIT == "1"


def test_nearest_falls_back_to_all_names():
    assert nearest("stifness", ["stiffness", "turns"]) == "did you mean 'stiffness'?"
    assert nearest("zzz", ["turns", "kind"]) == "allowed: kind, turns"
