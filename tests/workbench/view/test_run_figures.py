"""Figures: units on every axis, the turn where it was, runs told apart without colour, the same
bytes every time.
"""

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex

from aerodima.workbench.view.figure_style import TURN_SHADE, png
from aerodima.workbench.view.run_figures import plot_overlay
from tests.workbench.made_up_runs import made_up_run


@pytest.mark.parametrize("name", ["none", "swing"])
def test_the_turn_is_shaded_from_steering_command_to_straight_wheels(standard_runs, name):
    # 2 s + 0.5 s of steering + 0.14 s in which the servo comes back.
    for axes in plot_overlay([standard_runs[name]], [name]).get_axes():
        (shade,) = [patch for patch in axes.patches if to_hex(patch.get_facecolor()) == TURN_SHADE]
        left = shade.get_x()
        right = shade.get_x() + shade.get_width()
        assert (left, right) == pytest.approx((2.0, 2.64))


def test_angles_are_drawn_in_degrees_of_a_log_of_the_real_car_too():
    run = made_up_run({"roll_estimate_rad": np.radians(10.0)}, truth=False, tail_mode="none")
    figure = plot_overlay([run], ["car"])
    axes = next(a for a in figure.get_axes() if a.get_ylabel() == "roll of the car [deg]")
    (line,) = (item for item in axes.get_lines() if len(item.get_xdata()) > 2)
    assert np.asarray(line.get_ydata()) == pytest.approx(10.0)


def test_equal_figures_have_equal_bytes_and_settings_outside_stay():
    before = dict(matplotlib.rcParams)
    run = made_up_run(tail_mode="none")
    first, second = (png(plot_overlay([run], ["car"])) for _ in range(2))
    assert first == second
    assert dict(matplotlib.rcParams) == before
