"""Averages of the published tables recomputed, and which of their rows are distinct."""

import numpy as np
import pytest

from aerodima.optimisation.identify.coefficient_averages import averages, weights
from aerodima.optimisation.identify.published_check import (
    recompute_averages,
    robot_tail_rows,
    static_rows,
)
from aerodima.workbench.core.errors import FitError
from tests.refusals import assert_refused


def test_200_of_210_static_rows_and_160_of_185_robot_rows_are_distinct():
    assert len(static_rows()) == 200  # ERRATA E1
    assert len(robot_tail_rows()) == 160  # ERRATA E24


def test_all_weighted_averages_are_recomputed_and_two_of_sixteen_disagree():
    table = recompute_averages()
    assert len(table) == 16
    assert table[~table.agrees][["table", "quantity"]].to_records(index=False).tolist() == [
        ("Table 11.1", "added_mass_kg tail 2 major 10 m/s"),
        ("Table 11.2", "added_mass_kg tail 1 major 20 m/s"),
    ]
    rows = table.set_index("quantity")
    # ERRATA E23, recomputed column
    assert rows.weighted["added_mass_kg tail 1 major 20 m/s"] == pytest.approx(-0.01670, abs=5e-6)
    bar = table[table["table"] == "Table 4.7"].weighted.to_numpy()
    assert bar == pytest.approx([0.04351, 0.03643], abs=5e-6)


def test_robust_averages_ignore_the_swing_at_the_bound():
    table = recompute_averages()
    row = table.set_index("quantity").loc["added_mass_kg tail 2 minor 20 m/s"]
    assert row["mean"] == pytest.approx(0.13376, abs=5e-6)
    assert row["median"] == pytest.approx(0.0441)
    assert row["huber"] == pytest.approx(0.0436, abs=0.001)


def test_weights_sum_to_one_and_go_with_one_over_the_resnorm():
    w = weights(np.array([1.0, 2.0, 4.0]))
    assert w.tolist() == pytest.approx([4.0 / 7.0, 2.0 / 7.0, 1.0 / 7.0])
    assert_refused(lambda: weights(np.array([1.0, 0.0])), FitError, "0.0", "1")


@pytest.mark.parametrize("apart", [1e-3, 1e-9, 3e-16])
def test_huber_location_of_values_that_hardly_differ_lies_among_them(apart):
    values = 1.0 + apart * np.array([0.0, 1.0, 1.0, 2.0, 40.0])
    assert values.min() <= averages(values, np.ones(5))["huber"] <= values[3]


def test_huber_location_lies_between_mean_and_median_of_lopsided_values():
    found = averages(np.array([1.0, 1.1, 0.96, 1.05, 3.0]), np.ones(5))
    assert found["median"] < found["huber"] < found["mean"]
    assert (found["p10"], found["p90"]) == pytest.approx((0.976, 2.24))
