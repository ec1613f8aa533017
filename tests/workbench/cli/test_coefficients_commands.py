"""`aerodima models coefficients`: every embedded set has a picture, and wrong calls end in one
line.
"""

import pytest
import typer
from typer.testing import CliRunner

from aerodima.workbench.aero.coefficient_files import embedded_sets
from aerodima.workbench.cli.model_commands import register
from aerodima.workbench.core.errors import UserError

RUNNER = CliRunner()


def app():
    program = typer.Typer()
    program.callback()(lambda: None)
    register(program)
    return program


def test_the_list_names_every_set_with_its_range_and_source():
    lines = RUNNER.invoke(app(), ["models", "coefficients", "list"]).output.splitlines()
    assert [line.split(":")[0] for line in lines] == embedded_sets()
    (measured,) = [line for line in lines if "cheetah_tail_1_major" in line]
    assert all(told in measured for told in ("10-30 m/s", "0.000-0.524 rad"))


def test_a_plot_is_written_and_not_overwritten_unasked(tmp_path):
    target = tmp_path / "tail.png"
    command = [
        "models",
        "coefficients",
        "plot",
        "robot_tail_weighted_average",
        "--out",
        str(target),
    ]
    assert RUNNER.invoke(app(), command).exit_code == 0
    assert target.read_bytes().startswith(b"\x89PNG")
    assert isinstance(RUNNER.invoke(app(), command).exception, UserError)
    assert RUNNER.invoke(app(), [*command, "--force"]).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_set"], "'no_such_set'"),
        (["half_cylinder", "--out", "a.gif"], ".png, .svg, .pdf"),
    ],
)
def test_wrong_calls_name_what_is_allowed(arguments, message):
    error = RUNNER.invoke(app(), ["models", "coefficients", "plot", *arguments]).exception
    assert isinstance(error, UserError)
    assert message in str(error)
