"""The strip: five labelled pictures in one PNG, equal for equal runs."""

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from aerodima.workbench.view.filmstrip import FRAME, STRIP, filmstrip_figure, write_strip
from aerodima.workbench.view.force_arrows import WHEEL_COLOUR

pytestmark = pytest.mark.usefixtures("renderer")


@pytest.fixture(scope="module")
def strip(short_runs, tmp_path_factory):
    return write_strip(short_runs["swing"], tmp_path_factory.mktemp("strip") / "run.png")


@pytest.mark.slow
def test_strip_holds_five_pictures_of_the_car(strip):
    pixels = matplotlib.image.imread(strip)
    assert pixels.shape[:2] == (STRIP[1], STRIP[0])
    yellow = (pixels[..., 0] > 0.5) & (pixels[..., 2] < 0.3) & (pixels[..., 1] > 0.4)  # the sail
    columns = np.nonzero(yellow.any(axis=0))[0]
    width = (STRIP[0] - 8) / 5
    assert {int((column - 8) // width) for column in columns} == {0, 1, 2, 3, 4}


def test_equal_runs_give_equal_bytes(strip, tailed, tmp_path):
    again = write_strip(replace(tailed, created="another day"), tmp_path / "again.png")
    assert again.read_bytes() == strip.read_bytes()


def loaded(run_log, force):
    """The run with `force` (N) upward on the front right wheel and nothing on the others."""
    table = run_log.table.copy()
    table[[name for name in table.columns if name.startswith("wheel_force_")]] = 0.0
    table["wheel_force_front_right_z_truth_n"] = force
    return replace(run_log, table=table)


def green_rows(run_log):
    """Height of what has the colour of a wheel's arrow in each of the five pictures, pixels."""
    heights = []
    for axes in filmstrip_figure(run_log).axes:
        pixels = np.asarray(axes.images[0].get_array())[..., :3] / 255.0
        rows = np.flatnonzero((np.abs(pixels - WHEEL_COLOUR).max(axis=-1) < 0.02).any(axis=1))
        heights.append(int(np.ptp(rows)) + 1 if rows.size else 0)
    return heights


@pytest.mark.slow
def test_arrow_of_a_heavily_loaded_wheel_is_drawn_whole(tailless):
    """At 37 N, as of the outer wheels of a car that tips, it is as much longer as the force is than
    at 15 N.
    """
    light, heavy = (np.array(green_rows(loaded(tailless, force))) for force in (15.0, 37.0))
    # The camera looks down, so that the point of the longer arrow is nearer to it and seen a little
    # larger.
    assert heavy / light == pytest.approx(np.full(5, 37.0 / 15.0), rel=0.25)
    assert np.all(heavy < FRAME[1])
