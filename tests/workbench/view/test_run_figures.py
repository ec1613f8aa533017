"""Figures: units on every axis, the turn where it was, runs told apart without colour, the same
bytes every time.
"""

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.view.figure_style import TURN_SHADE, png
from aerodima.workbench.view.run_figures import plot_turn
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import made_up_run


@pytest.mark.parametrize("name", ["none", "swing"])
def test_the_turn_is_shaded_from_steering_command_to_straight_wheels(standard_runs, name):
    # 2 s + 0.5 s of steering + 0.14 s in which the servo comes back.
    for axes in plot_turn(standard_runs[name]).get_axes():
        (shade,) = [patch for patch in axes.patches if to_hex(patch.get_facecolor()) == TURN_SHADE]
        left = shade.get_x()
        right = shade.get_x() + shade.get_width()
        assert (left, right) == pytest.approx((2.0, 2.64))


def test_angles_are_drawn_in_degrees():
    figure = plot_turn(made_up_run({"roll_estimate_rad": np.radians(10.0)}, tail_mode="none"))
    axes = next(a for a in figure.get_axes() if a.get_ylabel() == "roll [deg]")
    line = next(item for item in axes.get_lines() if item.get_label() == "on-board estimate")
    assert np.asarray(line.get_ydata()) == pytest.approx(10.0)


def test_a_log_of_the_real_car_is_drawn_without_truth():
    figure = plot_turn(made_up_run(truth=False, tail_mode="none"))
    labels = {line.get_label() for axes in figure.get_axes() for line in axes.get_lines()}
    assert "as logged" in labels
    assert "truth" not in labels


def test_equal_figures_have_equal_bytes_and_settings_outside_stay():
    before = dict(matplotlib.rcParams)
    run = made_up_run(tail_mode="none")
    assert png(plot_turn(run)) == png(plot_turn(run))
    assert dict(matplotlib.rcParams) == before


def test_a_log_that_ends_in_the_turn_is_refused():
    run = made_up_run()
    cut = type(run)(
        run.table[run.table.time_s < 2.3],
        run.scenario,
        run.seed,
        extra=run.extra,
        source="cut.parquet",
    )
    assert_refused(lambda: plot_turn(cut), LogError, "cut.parquet", "2.298 s")
