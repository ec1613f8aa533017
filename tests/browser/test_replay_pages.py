"""Replays in a real browser, with the network off: they show the car, play, and keep car, slider
and signals in step.

A browser that draws in software has deadlines of its own, so these tests run alone (`make
realtime`).
"""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.replay_page import comparison_page, write_replay_html

pytestmark = [pytest.mark.realtime, pytest.mark.nightly]

SHORT = ("speed=1.0", "turn_start=0.2", "speed_ramp=0.1", "turn_hold=0.1", "duration=0.7")
READY = "() => typeof replay !== 'undefined' && replay.duration > 0"


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser_runs")
    settings = [f"manoeuvre.{setting}" for setting in SHORT]
    return {
        mode: simulate(load_scenario(f"turn_{mode}", settings), folder / f"{mode}.parquet")
        for mode in ("none", "held")
    }


@pytest.fixture(scope="module")
def replay_file(runs, tmp_path_factory):
    return write_replay_html(runs["held"], tmp_path_factory.mktemp("page") / "held.html")


def open_offline(page, path):
    page.context.set_offline(True)
    page.goto(path.as_uri())


def picture(page, path):
    page.screenshot(path=path, timeout=60_000)
    return imread(path)[..., :3]


def test_replay_shows_the_car_and_plays(page, replay_file, tmp_path):
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    page.wait_for_function("() => replay.time > 0.1")
    page.get_by_role("button", name="Pause").click()
    stopped = page.evaluate("replay.time")
    blue_body = picture(page, tmp_path / "shown.png")
    red, green, blue = np.moveaxis(blue_body, -1, 0)
    assert np.count_nonzero((blue > 0.4) & (blue > 2.0 * red) & (blue > 1.5 * green)) > 50, (
        "no blue car body"
    )
    page.wait_for_timeout(200)
    assert page.evaluate("replay.time") == stopped
    assert page.get_by_role("button", name="Play").is_visible()


def test_slider_and_its_keys_move_the_replay(page, replay_file):
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    slider = page.get_by_role("slider", name="Time of the replay, s")
    slider.fill("0.4")
    assert page.evaluate("replay.time") == pytest.approx(0.4)
    page.wait_for_function(
        "() => document.getElementById('run-now').textContent.includes('0.40 s')"
    )
    assert page.evaluate("viewer.animator.time") == pytest.approx(0.4)
    slider.press("ArrowRight")
    assert page.evaluate("replay.time") == pytest.approx(0.41)


CURSOR = """(() => {
  const chart = replay.signals.charts[0], line = chart.root.querySelector(".u-cursor-x");
  return chart.posToVal(new DOMMatrix(getComputedStyle(line).transform).m41, "x");
})()"""
"""Time at which the line of the cursor stands in the first chart, s."""
PIXEL = (
    "(replay.signals.window[1] - replay.signals.window[0]) / "
    "replay.signals.charts[0].over.clientWidth"
)
FRAME = 0.02


def drag(page, start, end):
    """Presses at a share of the width of the first chart and lets go at another."""
    box = page.locator(".signals .u-over").first.bounding_box()
    page.mouse.move(box["x"] + start * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], box["y"] + 20, steps=4)
    page.mouse.up()


def test_playing_moves_the_cursor_with_the_car(page, replay_file):
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    page.wait_for_function("() => replay.time > 0.1")
    for _ in range(5):
        animation, cursor, pixel = page.evaluate(f"[viewer.animator.time, {CURSOR}, {PIXEL}]")
        assert abs(cursor - animation) <= max(FRAME, pixel)
        page.evaluate("new Promise(requestAnimationFrame)")
    assert max(FRAME, pixel) == FRAME


def test_dragging_the_cursor_seeks_the_animation(page, replay_file):
    page.set_viewport_size({"width": 900, "height": 800})
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    drag(page, 0.1, 0.5)
    assert page.get_by_role("button", name="Play").is_visible()
    end = page.evaluate("replay.signals.window[1]")
    assert page.evaluate("viewer.animator.time") == pytest.approx(0.5 * end, abs=FRAME)
    assert page.evaluate("replay.time") == page.evaluate("viewer.animator.time")
    assert page.evaluate(CURSOR) == pytest.approx(0.5 * end, abs=FRAME)


def comparison_of(runs, path):
    names = [f"run {number}" for number in range(len(runs))]
    path.write_text(comparison_page(runs, names).html(), encoding="utf-8")
    return path


def cut(run, length, step=1):
    """Its first seconds, every so many rows."""
    return replace(run, table=run.table[run.time <= length].iloc[::step].reset_index(drop=True))


def all_loaded(page, count):
    page.wait_for_function(
        f"() => comparison.views.size === {count} && [...comparison.views.values()].every((view) "
        "=> view.replay)",
        timeout=120_000,
    )


def test_comparison_keeps_replays_and_signals_in_step(page, runs, tmp_path):
    longer = runs["none"]
    shorter = cut(runs["held"], 0.63, step=3)
    open_offline(page, comparison_of([longer, shorter], tmp_path / "comparison.html"))
    all_loaded(page, 2)
    for seconds, last in ((0.3, 0.3), (0.68, shorter.time[-1])):
        page.locator("#both").get_by_role("slider").fill(str(seconds))
        lines = [frame.locator("#run-now").text_content() for frame in page.frames[1:]]
        assert sorted(lines)[-1].startswith(f"t = \u2007{seconds:.2f} s")
        assert any(f"{last:.2f} s" in line for line in lines)
        assert page.evaluate("comparison.signals.time") == pytest.approx(seconds)
    assert not any(frame.locator("#replay-bar").is_visible() for frame in page.frames[1:])
    assert page.evaluate("comparison.signals.window") == pytest.approx([0.0, longer.time[-1]])
    lines = "comparison.signals.charts.map((chart) => chart.series.length - 1)"
    assert page.evaluate(lines) == [1, 1, 2, 2, 2, 2], "the tail of one car first"
    page.locator(".runs .line").first.uncheck()
    assert page.evaluate(lines) == [1] * 6
