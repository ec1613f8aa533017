"""A Matplotlib figure as plain panels: what is drawn is there, and what cannot be is refused."""

import numpy as np
from numpy.testing import assert_allclose

from aerodima.workbench.view.chart_panels import chart_panels
from aerodima.workbench.view.figure_style import (
    BLUE,
    GREY,
    new_figure,
    shade_turn,
)
from tests.refusals import assert_refused

X = np.linspace(0.0, 4.0, 41)


def panel(draw):
    figure, grid = new_figure(6.0, 3.0)
    draw(grid[0, 0])
    (cell,) = chart_panels(figure)["cells"]
    return cell["panels"][0]


def test_named_line_is_a_series_with_its_look():
    found = panel(lambda axes: axes.plot(X, np.sin(X), color=BLUE, linestyle="--", label="sine"))
    (series,) = found["series"]
    assert (series["label"], series["colour"]) == ("sine", BLUE.lower())
    assert series["dash"]
    assert_allclose(series["x"], X, rtol=1e-5)
    assert_allclose(series["y"], np.sin(X), atol=1e-5)
    assert found["shapes"] == []


def test_gap_stays_a_gap():
    y = np.where((X > 1.0) & (X < 2.0), np.nan, X)
    (series,) = panel(lambda axes: axes.plot(X, y, label="broken"))["series"]
    assert [value is None for value in series["y"]] == np.isnan(y).tolist()


def test_stripe_and_rule_reach_from_edge_to_edge():
    def draw(axes):
        shade_turn(axes, (1.0, 2.0))
        axes.axhline(0.5, color=GREY)

    stripe, rule = panel(draw)["shapes"]
    assert set(stripe["y"]) == {"low", "high"}
    assert {min(stripe["x"]), max(stripe["x"])} == {1.0, 2.0}
    assert (rule["x"], rule["y"]) == (["low", "high"], [0.5, 0.5])


def test_bars_and_error_bars_are_where_they_were():
    bar = panel(lambda axes: axes.bar([1.0], [3.0], width=0.5, color=BLUE))["shapes"][0]
    assert (min(bar["x"]), max(bar["x"]), max(bar["y"])) == (0.75, 1.25, 3.0)
    shapes = panel(lambda axes: axes.errorbar([1.0, 2.0], [5.0, 6.0], yerr=0.5, fmt="o"))["shapes"]
    assert any(4.5 in shape["y"] and 5.5 in shape["y"] for shape in shapes)


def test_what_has_no_panel_is_refused():
    assert_refused(lambda: panel(lambda axes: axes.scatter(X, X)), TypeError, "PathCollection")
