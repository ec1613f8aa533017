"""Summary of a comparison over its cars."""

import math

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation import summarise_swerves
from aerodima.optimisation.swerve.swerve_table import (
    has_gain,
    median_interval,
    swerve_lines,
    swerve_page,
)
from aerodima.workbench import stored_swerves
from tests.swerve_page import (
    BEGIN,
    END,
    FIRST_BEGIN,
    FIRST_END,
    FIRST_PAGES,
    PAGE,
    first_table,
    page_tables,
    part_of,
)

NONE = [0.40, 0.30, 0.50, 0.20]
VALUES = {
    "no tail": NONE,
    "low ballast": [0.44, 0.33, 0.50, None],
    "bound": [0.60, 0.36, 0.45, 0.30],
}


def table(values=VALUES):
    rows = []
    for candidate, own in values.items():
        for number, value in enumerate(own):
            place = {"plant": "full", "tail": "built", "floor": "x 1", "aim": "aside-0.5"}
            place["speed_m_per_s"] = 6.0
            rows.append(place | {"candidate": candidate, "car": f"car{number}", "value": value})
    return pd.DataFrame(rows).astype({"value": float})


def test_the_page_has_the_tables_of_the_stored_comparison():
    assert part_of(PAGE, (BEGIN, END)) == page_tables(stored_swerves()).strip()


@pytest.mark.parametrize("page", FIRST_PAGES, ids=lambda page: page.name)
def test_a_first_page_has_the_gains_of_the_stored_comparison(page):
    assert part_of(page, (FIRST_BEGIN, FIRST_END)) == first_table(stored_swerves()).strip()


def test_gains_are_over_the_same_car_without_tail():
    summary = summarise_swerves(table()).set_index("candidate")
    bound = summary.loc["bound"]
    assert bound["gain"] == pytest.approx(np.median([0.5, 0.2, -0.1, 0.5]))
    assert bound["gain_worst"] == pytest.approx(-0.1)
    assert bound["gain_low"] <= bound["gain"] <= bound["gain_high"]
    assert bound["above_low_ballast"] == 2
    ballast = summary.loc["low ballast"]
    assert (ballast["cars"], ballast["with_value"]) == (4, 3)
    assert ballast["gain"] == pytest.approx(0.1)
    assert summary.loc["no tail", "gain"] == 0.0


def test_more_of_an_aim_below_zero_is_a_gain():
    """Such as energy, which an aim counts as negative."""
    summary = summarise_swerves(table({"no tail": [-2.0] * 4, "bound": [-1.0] * 4}))
    assert summary.set_index("candidate").loc["bound", "gain"] == 0.5


def test_nobody_is_above_low_ballast_that_was_not_compared():
    summary = summarise_swerves(table({"no tail": NONE, "bound": VALUES["bound"]}))
    assert summary["above_low_ballast"].isna().all()
    assert swerve_lines(summary)[-1].split()[-1] == "–"


def test_a_control_without_tail_is_no_gain_of_a_tail():
    better = [2.0 * value for value in NONE]
    control = {"no tail, rollover control": better}
    worse = {"feedback": [0.5 * value for value in NONE]}
    assert not has_gain(summarise_swerves(table({"no tail": NONE} | control | worse)))


def test_the_interval_is_that_of_the_median_of_cars_drawn_again():
    values = np.arange(12.0)
    generator = np.random.default_rng(7)
    medians = np.median(generator.choice(values, (20000, 12)), axis=1)
    expected = np.quantile(medians, [0.025, 0.975])
    assert median_interval(values, 1) == pytest.approx(expected, abs=1e-9)
    assert all(map(math.isnan, median_interval(np.array([]), 1)))


def test_terminal_and_page_have_every_candidate():
    everything = table()
    summary = summarise_swerves(everything)
    lines = "\n".join(swerve_lines(summary))
    page = swerve_page(everything, summary).html()
    for candidate in VALUES:
        assert candidate in lines
        assert candidate in page
    assert "3 of 4" in lines


@pytest.mark.parametrize(("bound", "gain"), [(0.9, False), (1.1, True)])
def test_a_gain_is_that_of_a_tail(bound, gain):
    values = {"no tail": NONE, "low ballast": [2.0 * one for one in NONE]}
    assert has_gain(summarise_swerves(table(values)))
    values["bound"] = [bound * one for one in NONE]
    assert has_gain(summarise_swerves(table(values))) == gain
