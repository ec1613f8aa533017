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
from tests.code_measure import ROOT

PAGE = ROOT / "docs" / "swerves.md"
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


def page_rows(everything):
    """Rows of the tables of the page of swerves, one for each kind of car, floor and aim: the
    median without tail in m, of all others the gain over it with its interval, and how many cars
    complete the swerve where one does not.
    """
    for _, own in everything.groupby(["plant", "floor", "aim"], sort=False):
        summary = summarise_swerves(own)
        for candidate, rows in summary.groupby("candidate", sort=False):
            cells = [str(candidate)]
            for row in rows.sort_values("speed_m_per_s").to_dict("records"):
                gain, low, high = (100.0 * row[key] for key in ("gain", "gain_low", "gain_high"))
                cell = f"{gain:+.0f} % ({low:+.0f} to {high:+.0f})"
                if candidate == "no tail":
                    cell = f"{row['median']:.3f} m"
                if row["with_value"] < row["cars"]:
                    cell += f", {row['with_value']} of {row['cars']}"
                cells.append(cell if row["with_value"] else "none")
            yield f"| {' | '.join(cells)} |"


def test_the_page_has_the_figures_of_the_stored_table():
    page = PAGE.read_text(encoding="utf-8")
    rows = list(page_rows(stored_swerves()))
    assert len(rows) >= 8
    for row in rows:
        assert row in page


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
