"""`aerodima models coefficients`: every embedded set has a picture, and wrong calls end in one
line.
"""

import pytest

from aerodima.workbench.aero.coefficient_files import embedded_sets
from tests.commands import done
from tests.refusals import assert_named

PLOT = ("models", "coefficients", "plot")


def test_the_list_names_every_set_with_its_range_and_source():
    lines = done("models", "coefficients", "list").splitlines()
    assert [line.split(":")[0] for line in lines] == embedded_sets()
    (measured,) = [line for line in lines if "cheetah_tail_1_major" in line]
    assert_named(measured, ("10-30 m/s", "0.000-0.524 rad"))


def test_a_plot_is_written(tmp_path):
    target = tmp_path / "tail.png"
    done(*PLOT, "robot_tail_weighted_average", "--out", target)
    assert target.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_set"], "'no_such_set'"),
        (["half_cylinder", "--out", "a.gif"], ".png, .svg, .pdf"),
    ],
)
def test_wrong_calls_name_what_is_allowed(refused, arguments, message):
    assert message in refused(*PLOT, *arguments)
