"""What a reader of a fit's report sees: digits, order of the parameters, axes of the figures."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg

from aerodima.optimisation.identify.coefficient_averages import robot_tail_set, write_sets
from aerodima.optimisation.identify.fit_report import format_estimate, write_report
from aerodima.optimisation.identify.fit_result import Estimate, FitResult, make_curve
from aerodima.workbench.aero.coefficient_files import load_coefficients
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused


def result(name, *names, curves=None):
    estimates = tuple(Estimate(n, "1", 2.0, 0.1, 1.8, 2.2, noise_deviation=0.04) for n in names)
    return FitResult(
        name, estimates, ((0.01,),), 1.0, {"angle": 0.1}, True, "done", (), curves=curves or {}
    )


@pytest.mark.parametrize(
    ("value", "lower", "upper", "words"),
    [
        (0.0475021, 0.0474671, 0.0475371, "0.047502 (0.047467 .. 0.047537) kg"),
        (1.5407912, 1.5406, 1.54098, "1.54079 (1.54060 .. 1.54098) kg"),
        (1.25e-13, 1.1e-13, 1.4e-13, "1.25e-13 (1.1e-13 .. 1.4e-13) kg"),
    ],
)
def test_an_interval_keeps_two_digits_of_its_width(value, lower, upper, words):
    assert format_estimate(Estimate("mass", "kg", value, 1.0, lower, upper), unit=True) == words


def test_every_parameter_of_every_fit_has_a_row_with_what_noise_alone_would_give(
    tmp_path,
):
    write_report(
        tmp_path, "Robot tail", [result("logs/a.parquet", "cn"), result("Tables 11.4-11.7", "cn")]
    )
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("2.00 (1.80 .. 2.20)") == 2
    table = pd.read_csv(tmp_path / "fits.csv")
    assert table.cn_noise_std.tolist() == [0.04, 0.04]
    assert table.cn_std.tolist() == [0.1, 0.1]


def test_an_infinite_interval_is_in_every_file_of_the_report(tmp_path):
    known = result("a", "cd")
    unknown = Estimate("cd", "1", 0.03, math.inf, -math.inf, math.inf, identifiable=False)
    results = [known, replace(known, name="b", estimates=(unknown,), unidentifiable=("cd",))]
    write_report(tmp_path, "Static fits", results)
    assert pd.read_csv(tmp_path / "fits.csv").cd_upper95.tolist() == [2.2, math.inf]
    fits = yaml.safe_load((tmp_path / "fits.yaml").read_text(encoding="utf-8"))["fits"]
    assert fits[1]["estimates"][0]["lower"] == -math.inf
    assert "not determined" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "estimates.png").is_file()


def test_a_report_that_cannot_be_finished_leaves_the_earlier_one_whole(tmp_path, monkeypatch):
    curves = {"angle": make_curve(*np.eye(3), "t, s", "q, rad")}
    write_report(tmp_path, "Robot tail", [result("a", "cn", curves=curves)])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert {"fits.csv", "fits.yaml", "report.html", "curves.png"} <= set(before)

    def stopped(self, *args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(FigureCanvasAgg, "print_png", stopped)
    with pytest.raises(KeyboardInterrupt):
        write_report(tmp_path, "Robot tail", [result("b", "cn", curves=curves)])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_coefficient_file_that_the_aerodynamics_refuse_is_not_left(tmp_path):
    bins = tuple(Estimate(f"cn_at_{v}", "1", 2.0, 0.1, 1.8, 2.2) for v in (5.0, 7.5))
    good = robot_tail_set([replace(result("a"), estimates=bins)])
    (path,) = write_sets(tmp_path, {"good": good})
    assert load_coefficients(path).name == good["name"]
    bad = {"bad": {**good, "nodes": good["nodes"][::-1]}}
    assert_refused(lambda: write_sets(tmp_path, bad), ModelError, "bad.yaml")
    assert [found.name for found in tmp_path.iterdir()] == ["good.yaml"]
