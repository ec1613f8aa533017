"""Replays in a real browser, with the network off: they show the car, play, and follow the slider.

A browser that draws in software has deadlines of its own, so these tests run alone (`make realtime`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.report.replay_page import comparison_page, write_replay_html
from aerodima.workbench.simulate.simulation import simulate
from tests.browser.contrast import too_faint

pytestmark = pytest.mark.realtime

SHORT = ("speed=1.0", "turn_start=0.2", "speed_ramp=0.1", "turn_hold=0.1", "duration=0.7")
READY = "() => typeof replay !== 'undefined' && replay.duration > 0"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunLog]:
    folder = tmp_path_factory.mktemp("browser_runs")
    settings = [f"manoeuvre.{setting}" for setting in SHORT]
    return {
        mode: simulate(load_scenario(f"turn_{mode}", settings), folder / f"{mode}.parquet") for mode in ("none", "held")
    }


@pytest.fixture(scope="module")
def replay_file(runs: dict[str, RunLog], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_replay_html(runs["held"], tmp_path_factory.mktemp("page") / "held.html")


def open_offline(page: Any, path: Path) -> None:
    page.context.set_offline(True)
    page.goto(path.as_uri())


def picture(page: Any, path: Path) -> np.ndarray:
    page.screenshot(path=path, timeout=60_000)
    return imread(path)[..., :3]


def test_replay_shows_the_car_and_plays(page: Any, replay_file: Path, tmp_path: Path) -> None:
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    page.wait_for_function("() => replay.time > 0.1")
    page.get_by_role("button", name="Pause").click()
    stopped = page.evaluate("replay.time")
    blue_body = picture(page, tmp_path / "shown.png")
    red, green, blue = np.moveaxis(blue_body, -1, 0)
    assert np.count_nonzero((blue > 0.4) & (blue > 2.0 * red) & (blue > 1.5 * green)) > 50, "no blue car body"
    page.wait_for_timeout(200)
    assert page.evaluate("replay.time") == stopped
    assert page.get_by_role("button", name="Play").is_visible()


def test_slider_and_its_keys_move_the_replay(page: Any, replay_file: Path) -> None:
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    slider = page.get_by_role("slider", name="Time of the replay, s")
    slider.fill("0.4")
    assert page.evaluate("replay.time") == pytest.approx(0.4)
    page.wait_for_function("() => document.getElementById('run-now').textContent.includes('0.40 s')")
    assert page.evaluate("viewer.animator.time") == pytest.approx(0.4)
    slider.press("ArrowRight")
    assert page.evaluate("replay.time") == pytest.approx(0.41)


def test_replay_is_worked_by_keyboard_alone_and_its_text_can_be_read(page: Any, replay_file: Path) -> None:
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    assert too_faint(page) == []
    in_bar = (
        "() => document.getElementById('replay-bar').contains(document.activeElement) && document.activeElement.tagName"
    )
    reached: list[str] = []
    for _ in range(20):
        page.keyboard.press("Tab")
        if tag := page.evaluate(in_bar):
            reached.append(tag)
        if reached[-1:] == ["BUTTON"]:
            page.keyboard.press("Space")
            assert page.get_by_role("button", name="Play").is_visible()
        if reached[-1:] == ["SELECT"]:
            break
    assert reached == ["BUTTON", "INPUT", "SELECT"]
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("replay.time") == pytest.approx(0.01)


def test_slow_motion_is_slower(page: Any, replay_file: Path) -> None:
    open_offline(page, replay_file)
    page.wait_for_function(READY)
    page.get_by_role("combobox", name="Rate of the replay").select_option("0.1")
    page.get_by_role("slider").fill("0")
    page.get_by_role("button", name="Play").click()
    began = page.evaluate("performance.now()")
    page.wait_for_function("() => replay.time > 0.01")
    shown, now = page.evaluate("[replay.time, performance.now()]")
    assert shown <= 0.11 * (now - began) / 1000.0


def test_browser_without_webgl_is_told_so(page: Any, failures: list[str], replay_file: Path) -> None:
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    open_offline(page, replay_file)
    page.wait_for_function("() => document.getElementById('run-now').textContent.includes('WebGL')")
    failures.clear()  # Meshcat's own


def test_comparison_keeps_both_replays_in_step(page: Any, runs: dict[str, RunLog], tmp_path: Path) -> None:
    path = tmp_path / "comparison.html"
    path.write_text(comparison_page([runs["none"], runs["held"]], ["none", "held"]).html(), encoding="utf-8")
    open_offline(page, path)
    page.locator("#both").get_by_role("slider").fill("0.3")
    lines = [frame.locator("#run-now") for frame in page.frames[1:]]
    assert len(lines) == 2
    for line in lines:
        page.wait_for_timeout(100)
        assert "0.30 s" in line.text_content()
    assert not any(frame.locator("#replay-bar").is_visible() for frame in page.frames[1:])
