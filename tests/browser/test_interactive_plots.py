"""Interactive plots of a report in a real browser, with the network off: drawn, zoomed, read,
printed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.identify.fit_pipeline import Estimate, FitResult
from aerodima.optimisation.identify.fit_report import write_report

pytestmark = pytest.mark.realtime

TIME = np.linspace(0.0, 10.0, 400)


@pytest.fixture(scope="module")
def report_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of a fit with two curves, each with its residual below."""
    curves = {
        name: {
            "x": TIME,
            "measured": size * np.sin(TIME),
            "model": size * np.sin(TIME + 0.1),
            "labels": ("time [s]", y),
        }
        for name, size, y in (("angle", 1.0, "angle, rad"), ("force", 5.0, "force, N"))
    }
    estimate = Estimate("cd", "1", 1.2, 0.1, 1.0, 1.4)
    result = FitResult(
        "log.parquet",
        (estimate,),
        ((0.01,),),
        1.0,
        {"angle": 0.1},
        True,
        "solved",
        (),
        curves=curves,
    )
    folder = tmp_path_factory.mktemp("fit")
    write_report(folder, "Fit of a swing", [result])
    return folder / "report.html"


@pytest.fixture
def report(page: Any, report_file: Path) -> Any:
    page.set_viewport_size({"width": 1280, "height": 800})
    page.context.set_offline(True)
    page.goto(report_file.as_uri())
    return page


SCALES = "figures[0].charts.map((chart) => [chart.scales.x.min, chart.scales.x.max])"


def test_drag_zooms_a_curve_with_its_residual_and_double_click_shows_the_whole(report: Any) -> None:
    whole = report.evaluate(SCALES)
    over = report.locator(".interactive .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    report.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 30)
    report.mouse.down()
    report.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 32, steps=4)
    report.mouse.up()
    report.wait_for_function(f"() => ({SCALES})[1][0] > 1")
    (low, high), below, other, _ = report.evaluate(SCALES)
    width = whole[0][1] - whole[0][0]
    assert (low, high) == pytest.approx(
        (whole[0][0] + 0.25 * width, whole[0][0] + 0.75 * width), abs=0.01 * width
    )
    assert below == [low, high]
    assert other == whole[2], "the other curve is left as it is"
    over.dblclick()
    report.wait_for_function(f"() => ({SCALES})[1][0] < 1")
    assert report.evaluate(SCALES) == whole


def test_values_are_read_at_the_mouse_and_a_click_on_a_name_hides_its_line(report: Any) -> None:
    over = report.locator(".interactive .u-over").first
    over.scroll_into_view_if_needed()
    over.hover()
    legend = report.locator(".interactive .u-legend").first
    time, measured = (
        float(text.replace("\u2212", "-"))
        for text in legend.locator(".u-value").all_inner_texts()[:2]
    )
    assert measured == pytest.approx(np.interp(time, TIME, np.sin(TIME)), abs=1e-3)
    legend.get_by_text("model").click()
    assert report.evaluate("figures[0].charts[0].series.map((series) => series.show)") == [
        True,
        True,
        False,
    ]


def test_without_scripts_the_picture_is_shown(browser: Any, report_file: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report_file.as_uri())
    assert page.locator(".interactive img").is_visible()
    context.close()
