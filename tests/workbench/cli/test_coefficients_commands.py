"""`aerodima models coefficients`: every embedded set has a picture, and wrong calls end in one
line.
"""

from __future__ import annotations

import pytest
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from typer.testing import CliRunner

from aerodima.workbench.aero.coefficient_files import embedded_sets, load_coefficients
from aerodima.workbench.cli.model_commands import register
from aerodima.workbench.errors import UserError
from aerodima.workbench.figures.coefficient_figures import plot_coefficients

RUNNER = CliRunner()


def app() -> typer.Typer:
    program = typer.Typer()
    program.callback()(lambda: None)
    register(program)
    return program


def test_the_list_names_every_set_with_its_range_and_source() -> None:
    lines = RUNNER.invoke(app(), ["models", "coefficients", "list"]).output.splitlines()
    assert [line.split(":")[0] for line in lines] == embedded_sets()
    assert "measured 10-30 m/s, |gamma| 0.000-0.524 rad" in next(
        line for line in lines if "cheetah_tail_1_major" in line
    )


def test_a_plot_is_written_and_not_overwritten_unasked(tmp_path) -> None:
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


@pytest.mark.parametrize("name", embedded_sets())
def test_every_set_can_be_drawn_with_its_bands(name) -> None:
    """A set with single fits shows a band (one collection per speed)."""
    coefficients = load_coefficients(name)
    figure = plot_coefficients(coefficients)
    bands = [c for axes in figure.axes for c in axes.collections]
    assert bool(bands) == (coefficients.law_kind == "polar" or coefficients.kind == "speed_table")


@pytest.mark.slow
@pytest.mark.parametrize("name", embedded_sets())
def test_legend_covers_no_node(name) -> None:
    figure = plot_coefficients(load_coefficients(name))
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        legend = axes.get_legend()
        marked = [line for line in axes.lines if line.get_marker() == "o"]
        for line in marked if legend else []:
            for point in axes.transData.transform(line.get_xydata()):
                assert not legend.get_window_extent().contains(*point)


def test_curve_and_limit_beyond_the_measured_speeds_stand_within_the_frame(tmp_path) -> None:
    path = tmp_path / "sail.yaml"
    path.write_text(
        "schema: aerodima/coefficients/1\nlaw: normal_force\nquasi_steady_limit_m_per_s: "
        "15.0\nname: sail\n"
        "source: mine\nkind: speed_line\nrange: {speed_m_per_s: [3.0, 12.0]}\n"
        "cn_slope_s_per_m: 0.02\ncn_intercept: 1.8\n"
    )
    figure = plot_coefficients(load_coefficients(path))
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    (limit,) = [line for line in axes.lines if line.get_label() == "quasi-steady limit"]
    assert limit.get_xdata()[0] == 15.0 < axes.get_xlim()[1]
    assert max(axes.lines[0].get_ydata()) < 0.95 * axes.get_ylim()[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no_such_set"], "'no_such_set': models/coefficients has none of this name"),
        (["half_cylinder", "--out", "a.gif"], "allowed: .png, .svg, .pdf"),
    ],
)
def test_wrong_calls_name_what_is_allowed(arguments, message) -> None:
    error = RUNNER.invoke(app(), ["models", "coefficients", "plot", *arguments]).exception
    assert isinstance(error, UserError)
    assert message in str(error)
