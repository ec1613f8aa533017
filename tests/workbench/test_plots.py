"""Figures: units on every axis, the turn where it was, runs told apart without colour, the same bytes every time."""

import itertools
import re
from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.comparison_figures import plot_metrics, plot_outcomes
from aerodima.workbench.figures.figure_style import MODE_STYLES, TURN_SHADE, png
from aerodima.workbench.figures.run_figures import plot_turn
from aerodima.workbench.logs.schema import RunLog
from tests.workbench.made_up_runs import made_up_run
from tests.workbench.made_up_summaries import made_up_summary

SUMMARIES = [
    made_up_summary(mode, speed, result="flipped" if mode == "none" and speed > 3.5 else "survived")
    for mode in ("none", "held", "swing")
    for speed in (3.33, 3.61, 3.89)
]


def _axes_with_data(figure: Figure) -> list[Any]:
    return [axes for axes in figure.get_axes() if axes.axison]


FIGURES: dict[str, Callable[[dict[str, RunLog]], Figure]] = {
    "turn, no tail": lambda runs: plot_turn(runs["none"]),
    "turn, swing": lambda runs: plot_turn(runs["swing"], "swing"),
    "outcomes": lambda runs: plot_outcomes(SUMMARIES),
    "metrics": lambda runs: plot_metrics(SUMMARIES),
}


@pytest.fixture(scope="module")
def figures(standard_runs: dict[str, RunLog]) -> dict[str, Figure]:
    return {name: make(standard_runs) for name, make in FIGURES.items()}


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_names_its_unit(figures: dict[str, Figure], name: str) -> None:
    figure = figures[name]
    below = figure.get_supxlabel()
    for axes in _axes_with_data(figure):
        shared_x = axes.get_shared_x_axes().get_siblings(axes)
        shared_y = axes.get_shared_y_axes().get_siblings(axes)
        x = [other.get_xlabel() for other in shared_x] + [below]
        y = [other.get_ylabel() for other in shared_y]
        assert any(re.search(r"\[.+\]", label) for label in x), (name, x)
        if name != "outcomes":  # its rows are tail modes, written out
            assert any(re.search(r"\[.+\]", label) for label in y), (name, y)


@pytest.mark.parametrize("name", ["turn, no tail", "turn, swing"])
def test_the_turn_is_shaded_from_steering_command_to_straight_wheels(figures: dict[str, Figure], name: str) -> None:
    # 2 s + 0.5 s of steering + 0.14 s in which the servo comes back.
    for axes in _axes_with_data(figures[name]):
        if axes.get_ylabel().startswith("roll motor"):
            continue
        (shade,) = [patch for patch in axes.patches if to_hex(patch.get_facecolor()) == TURN_SHADE]
        left, right = shade.get_x(), shade.get_x() + shade.get_width()
        assert (left, right) == pytest.approx((2.0, 2.64))


def test_modes_differ_in_marker_and_line_not_only_in_colour() -> None:
    for a, b in itertools.combinations(MODE_STYLES.values(), 2):
        assert a.marker != b.marker
        assert a.line != b.line
        assert a.colour != b.colour


def test_outcomes_have_symbols_of_their_own() -> None:
    runs = [
        made_up_summary("none", 3.0),
        made_up_summary("none", 4.0, touched=("board",)),
        made_up_summary("none", 5.0, result="flipped"),
    ]
    figure = plot_outcomes(runs)
    marks = {float(line.get_xdata()[0]): line for line in figure.get_axes()[0].get_lines()}
    assert marks[3.0].get_marker() == marks[4.0].get_marker() == "o"
    assert marks[5.0].get_marker() == "X"
    assert marks[4.0].get_markerfacecolor() == "white"
    assert marks[3.0].get_markerfacecolor() != "white"


def test_stars_stand_at_the_published_figures() -> None:
    published = {
        "simulated": {(3.30, 2.17), (4.36, 1.24)},
        "physical": {(3.37, 1.91), (6.10, 1.98)},
    }  # Tables 7.1 to 7.4
    for platform, expected in published.items():
        drawn = plot_metrics(SUMMARIES, platform).get_axes()
        axes = next(a for a in drawn if a.get_ylabel().startswith("largest yaw rate"))
        stars = {(float(s.get_xdata()[0]), float(s.get_ydata()[0])) for s in axes.get_lines() if s.get_marker() == "*"}
        assert stars == expected


def test_angles_are_drawn_in_degrees() -> None:
    figure = plot_turn(made_up_run({"roll_estimate_rad": np.radians(10.0)}, tail_mode="none"))
    axes = next(a for a in figure.get_axes() if a.get_ylabel() == "roll [deg]")
    line = next(item for item in axes.get_lines() if item.get_label() == "on-board estimate")
    assert np.asarray(line.get_ydata()) == pytest.approx(10.0)


def test_a_log_of_the_real_car_is_drawn_without_truth() -> None:
    figure = plot_turn(made_up_run(truth=False, tail_mode="none"))
    labels = {line.get_label() for axes in figure.get_axes() for line in axes.get_lines()}
    assert "as logged" in labels
    assert "truth" not in labels


def test_equal_figures_have_equal_bytes_and_settings_outside_stay() -> None:
    before = dict(matplotlib.rcParams)
    assert png(plot_outcomes(SUMMARIES)) == png(plot_outcomes(SUMMARIES))
    assert dict(matplotlib.rcParams) == before


def test_figures_need_no_display_and_open_no_window(figures: dict[str, Figure]) -> None:
    import matplotlib.pyplot as plt

    assert plt.get_fignums() == []


def test_a_log_that_ends_in_the_turn_is_refused() -> None:
    run = made_up_run()
    cut = type(run)(run.table[run.table.time_s < 2.3], run.scenario, run.seed, extra=run.extra, source="cut.parquet")
    with pytest.raises(LogError, match=r"cut\.parquet: ends at 2\.298 s, before its turn does"):
        plot_turn(cut)
