"""Entry speeds that were made up, whose gains are known."""

import math

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.judge.candidate import HELD, LOW_BALLAST, NO_TAIL, THESIS
from aerodima.optimisation.judge.entry_page import entry_lines, entry_page
from aerodima.optimisation.judge.entry_speed import NO_REFERENCE, NOT_CONFIRMED
from aerodima.optimisation.judge.entry_table import (
    entry_gains,
    has_gain,
    median_interval,
    summarise_entries,
)
from tests.refusals import assert_named

CARS = [f"car{index}" for index in range(5)]


def rows(candidate, speeds, ended_by="two wheels", floor="own", manoeuvre="turn"):
    return [
        {
            "manoeuvre": manoeuvre,
            "candidate": candidate,
            "car": car,
            "floor": floor,
            "entry_speed_m_per_s": speed,
            "at_ceiling": speed == 8.0,
            "course_change_rad": 0.5,
            "ended_by": ended_by,
        }
        for car, speed in zip(CARS, speeds, strict=True)
    ]


def made_up(*parts):
    return pd.DataFrame([row for part in parts for row in part])


def summary_of(candidate, *parts):
    """Row of a candidate in the summary of these rows."""
    return summarise_entries(made_up(*parts)).set_index("candidate").loc[candidate]


NONE = rows(NO_TAIL.name, [2.0, 2.0, 2.0, 2.0, 2.0])


def test_gains_are_over_the_same_car_and_its_worst_is_named():
    row = summary_of("new", NONE, rows("new", [2.1, 2.2, 2.3, 2.4, 1.9]))
    assert row["median_m_per_s"] == 2.2
    assert row["gain_over_no_tail"] == pytest.approx(0.10)
    assert row["worst_over_no_tail"] == pytest.approx(-0.05)
    assert (
        -0.05 - 1e-12 <= row["low_over_no_tail"] < 0.10 < row["high_over_no_tail"] <= 0.20 + 1e-12
    )
    assert math.isnan(row["gain_over_low_mass"])
    assert row["cars_over_low_mass"] == 0


@pytest.mark.parametrize(("speed", "gained"), [(2.1, True), (2.0, False), (math.nan, False)])
def test_verdict_is_whether_a_candidate_is_faster_than_no_tail(speed, gained):
    low = rows(LOW_BALLAST.name, [3.0] * 5)  # a car without a tail, too
    assert has_gain(summarise_entries(made_up(NONE, low, rows("new", [speed] * 5)))) == gained
    assert has_gain(summarise_entries(made_up(NONE, low)))


def test_the_better_of_held_and_published_is_chosen_car_by_car():
    table = made_up(
        NONE,
        rows(HELD.name, [2.5, math.nan, 2.0, 2.0, 2.0]),
        rows(THESIS.name, [2.0, 2.5, 2.0, 2.0, 2.0]),
        rows(LOW_BALLAST.name, [2.4] * 5),
        rows("new", [3.0, 3.0, 3.0, 3.0, 3.0]),
    )
    gains = entry_gains(table, (HELD.name, THESIS.name))[table["candidate"] == "new"]
    assert list(gains) == pytest.approx([0.2, 0.2, 0.5, 0.5, 0.5])
    row = summarise_entries(table).set_index("candidate").loc["new"]
    assert (row["gain_over_better_tail"], row["worst_over_better_tail"]) == (
        pytest.approx(0.5),
        pytest.approx(0.2),
    )
    assert row["gain_over_low_mass"] == pytest.approx(0.25)


def test_no_entry_speed_is_the_worst_gain_but_an_error_is_none():
    nan = math.nan
    failed = rows("new", [nan, 2.2, 2.2, 2.2, 2.2], "lateral")
    row = summary_of("new", NONE, failed)
    assert (row["worst_over_no_tail"], row["cars_over_no_tail"], row["without_entry"]) == (
        -1.0,
        5,
        1,
    )
    for ended_by, speed in (
        ("error: NaN", 9.0),
        (NO_REFERENCE, nan),
        (f"{NOT_CONFIRMED}: lateral", nan),
    ):
        unknown = rows("new", [speed, 2.2, 2.2, 2.2, 2.2])
        unknown[0]["ended_by"] = ended_by
        row = summary_of("new", NONE, unknown)
        assert (row["worst_over_no_tail"], row["cars_over_no_tail"]) == (pytest.approx(0.1), 4)
        assert (row["unknown"], row["median_m_per_s"]) == (1, 2.2)
    without = rows(NO_TAIL.name, [nan, 2.0, 2.0, 2.0, 2.0]), rows("new", [2.2] * 5)
    assert summary_of("new", *without)["cars_over_no_tail"] == 4


def test_a_car_counts_once_on_however_many_floors():
    slippery = rows(NO_TAIL.name, [4.0] * 5, floor="ice")
    new = rows("new", [2.2, 2.2, 2.2, 2.0, 2.0]) + rows(
        "new", [4.0, 4.0, 4.0, 8.0, 8.0], floor="ice"
    )
    row = summary_of("new", NONE, slippery, new)
    assert row["cars_over_no_tail"] == 5
    assert row["gain_over_no_tail"] == pytest.approx(0.05), "of 5 %, 5 %, 5 %, 50 % and 50 %"
    assert row["at_ceiling"] == 2


def test_manoeuvres_are_apart():
    table = made_up(
        NONE,
        rows("new", [2.2] * 5),
        rows(NO_TAIL.name, [4.0] * 5, manoeuvre="slalom"),
        rows("new", [4.2] * 5, manoeuvre="slalom"),
    )
    found = summarise_entries(table).set_index(["manoeuvre", "candidate"])["gain_over_no_tail"]
    assert found["turn", "new"] == pytest.approx(0.1)
    assert found["slalom", "new"] == pytest.approx(0.05)


def test_the_interval_narrows_with_the_cars_and_repeats_with_its_seed():
    few, many = (np.random.default_rng(3).normal(0.1, 0.05, number) for number in (8, 200))
    low, high = median_interval(many, 1)
    assert low < np.median(many) < high
    # The median of n draws from a normal distribution has the standard deviation sigma sqrt(pi / 2
    # n).
    assert high - low == pytest.approx(2 * 1.96 * 0.05 * math.sqrt(math.pi / 400), rel=0.5)
    # Of nine cars the median of a resample is the second at most in 3.0 % of the cases.
    assert median_interval(np.arange(9.0), 1) == (1.0, 7.0)
    assert np.diff(median_interval(few, 1)) > 2.0 * (high - low)
    assert median_interval(many, 1) == (low, high) != median_interval(many, 2)
    assert all(math.isnan(end) for end in median_interval(np.array([]), 1))


def test_lines_and_page_show_every_candidate_of_every_manoeuvre():
    never = rows(NO_TAIL.name, [math.nan] * 5, manoeuvre="corner")
    table = made_up(NONE, rows("new", [2.1, 2.2, 2.3, 2.4, 1.9]), never)
    summary = summarise_entries(table)
    words = " ".join(entry_lines(summary)[3].split())
    assert_named(words, ("new", "2.20", "+10.0 %", "-5.0 %", "+20.0 %"))
    page = entry_page(table, summary)
    assert [section.title for section in page.sections[1:]] == ["turn", "corner"]
    assert page.html().count("<img") == 2
