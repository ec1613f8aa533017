"""What the thesis states about the built car, beside what the model has: what a row says is ours is
found again.
"""

import pytest

from aerodima.optimisation.calibrate.calibration_plan import figures_of, load_plan
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.metrics.published_values import published_values
from aerodima.workbench.metrics.run_summary import KM_PER_H
from tests.built.found import CHECKS, RUNS, SLOW
from tests.built.statements import (
    Statement,
    load_statements,
    parameter_entry,
    published_row,
    statements_page,
)
from tests.refusals import assert_refused

FILE = load_statements()
WHOLE_STUDIES = {
    "largest_acceleration_same",
    "physical_acceleration_constant",
    "slope_with_tail",
    "yaw_rate_constant",
}
"""Rows of ten runs and more, which are measured at night."""


def marks_of(statement: Statement) -> list[pytest.MarkDecorator]:
    if statement.kind == "check":
        return []
    if statement.id in WHOLE_STUDIES:
        return [pytest.mark.slow, pytest.mark.nightly]
    return [pytest.mark.slow]


FOUND = [
    pytest.param(s, id=s.id, marks=marks_of(s))
    for s in FILE.statements
    if s.kind in ("check", "run")
]
AGAIN = 0.01
"""A run is found again within this share of its figure: the last digits depend on the versions of
Drake and NumPy."""


@pytest.mark.parametrize("statement", FOUND)
def test_what_a_row_says_is_ours_is_found_again(statement: Statement) -> None:
    found = (CHECKS if statement.kind == "check" else RUNS)[statement.source]()
    if isinstance(found, bool | str):
        assert found == statement.measured
    else:
        assert found == pytest.approx(statement.measured, rel=AGAIN, abs=1e-3)
        assert statement.holds(found) == (statement.verdict != "differs"), found


def test_there_is_a_row_for_everything_that_is_measured() -> None:
    assert {s.source for s in FILE.statements if s.kind == "check"} == set(CHECKS)
    assert {s.source for s in FILE.statements if s.kind == "run"} <= set(RUNS)
    assert set(RUNS) >= SLOW
    assert len(FILE.statements) >= 40


def test_units_of_both_sides_are_the_same() -> None:
    for statement in FILE.statements:
        if statement.kind == "parameter" and not isinstance(statement.our_value, bool | str):
            assert parameter_entry(statement.source).unit == statement.unit, statement.id


def row(**changes: object) -> dict[str, object]:
    good = {
        "id": "a",
        "section": "1",
        "says": "x",
        "published": 2.0,
        "unit": "m",
        "ours": "check b",
        "measured": 2.0,
    }
    return {**good, "verdict": "agrees", **changes}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"measured": 3.0, "compare": "at least"},
        {"measured": -2.0, "verdict": "differs", "reason": "sign"},
        {"ours": None, "measured": None, "verdict": "not checkable", "reason": "a picture"},
    ],
)
def test_a_verdict_that_follows_from_the_values_is_taken(changes) -> None:
    Statement.model_validate(row(**changes))


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"measured": -2.0}, ("-2.0", "2.0")),
        ({"measured": 2000.0}, ("2000.0",)),
        ({"verdict": "differs", "reason": "none"}, ("differs",)),
        ({"measured": 1.0, "compare": "at least"}, ("1.0", "at least")),
        ({"measured": True}, ("True",)),
        ({"measured": 3.0, "verdict": "differs"}, ("differs",)),
        ({"ours": None, "measured": None}, ("agrees",)),
        ({"ours": "parameter car.mass"}, ("measured",)),
        ({"measured": None}, ("measured",)),
    ],
)
def test_a_verdict_that_does_not_follow_is_refused(changes, named) -> None:
    assert_refused(lambda: Statement.model_validate(row(**changes)), ValueError, *named)


@pytest.mark.parametrize(
    ("find", "named"),
    [
        (lambda: parameter_entry("car.weight"), ("car.weight", "mass")),
        (lambda: published_row("constants/holdkp"), ("constants", "holdkp")),
    ],
)
def test_an_unknown_name_is_refused(find, named) -> None:
    assert_refused(find, ModelError, *named)


def test_the_page_has_every_row() -> None:
    page = statements_page()
    assert [s.id for s in FILE.statements if s.says.replace("|", "\\|") not in page] == []


def test_what_the_cars_are_calibrated_to_is_no_evidence() -> None:
    plan = load_plan()
    platforms = {
        figures.source: f"{figures.platform}_{figures.configuration}_"
        for figures in published_values()
    }
    fitted = {platforms[figure.turn.table] + figure.metric for figure in figures_of(plan)}
    fitted |= {
        f"outcome_{turn.tail}_{round(KM_PER_H * turn.speed)}_km_per_h"
        for turn in plan.turns
        if turn.system == "simulated"
    }
    fitted |= {
        "outcome_swing_at_6_10",
        "outcome_held_at_55_percent",
        "yaw_rate_when_an_inner_wheel_lifts",
        "change_of_the_mean_yaw_rate",
        "straightness_of_the_mean_acceleration",
    }
    rows = [s for s in FILE.statements if s.kind == "run" and s.source in fitted]
    assert len(rows) >= 20
    assert [s.id for s in rows if s.verdict == "agrees"] == []
