"""The replay as a file: one page that needs nothing else, with title, outcome and animation."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerodima.workbench.errors import LogError, UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.turn_metrics import Outcome
from aerodima.workbench.replay.captions import caption_of, outcome_in_words
from aerodima.workbench.report.replay_page import replay_page, write_replay_html


@pytest.fixture(scope="module")
def page(short_runs: dict[str, RunLog]) -> str:
    return replay_page(short_runs["swing"])


def messages(page: str) -> list[bytes]:
    """What Drake's Meshcat would have sent to the browser."""
    return [base64.b64decode(code) for code in re.findall(r"base64,([A-Za-z0-9+/=]{40,})", page)]


def test_page_loads_nothing_from_elsewhere(page: str) -> None:
    assert re.findall(r"<(?:script|link|img|iframe|source)\b[^<>]*\b(?:src|href)\s*=", page) == []
    assert re.findall(r"""(?:@import|url\()\s*["']?\s*https?:""", page) == []
    fetched = re.findall(r"""fetch\(["']([^"']{0,40})""", page)
    assert fetched
    assert all(address.startswith("data:") for address in fetched)


def test_page_holds_the_animation_of_every_moving_part(page: str) -> None:
    (animation,) = [message for message in messages(page) if b"set_animation" in message]
    for part in (
        b"car/chassis",
        b"car/front_left_wheel",
        b"tail/tail_rod",
        b"forces/air_on_tail",
        b"forces/ground_on_rear_right",
        b"trace/tail_tip/0",
        b"trace/com/0",
    ):
        assert b"/drake/" in animation
        assert part in animation, part


def test_page_is_small_enough_to_mail(page: str) -> None:
    assert len(page) < 8e6


def test_title_tells_scenario_speed_tail_and_outcome(page: str) -> None:
    title = "published turn: left turn, 1.00 m/s (3.6 km/h), tail swings: survived, clean"
    assert f"<title>{title}</title>" in page
    assert '<b class="survived">survived, clean</b>' in page
    assert "path of the tail tip" in page


@pytest.mark.parametrize(
    ("clean", "touched", "before", "words"),
    [
        (True, (), 0.0, "survived, clean"),
        (True, (), 0.358, "survived, clean, board down 0.36 s before the turn"),
        (False, ("board", "tail"), 0.0, "survived, board and tail touched the ground"),
        (None, (), None, "survived"),
    ],
)
def test_outcome_says_what_the_anti_ramp_board_did(
    clean: bool | None, touched: tuple[str, ...], before: float | None, words: str
) -> None:
    assert outcome_in_words(Outcome("survived", clean, 0.1, 0.0, 4, touched, before)) == words


def test_title_tells_a_swing_from_a_file_from_the_published_one(tailless: RunLog) -> None:
    named = []
    for tail, swing in (
        ("swing", "none"),
        ("swing", "thesis_8_rad_per_s"),
        ("held", "thesis_8_rad_per_s"),
    ):
        scenario = tailless.scenario | {"tail": {"mode": tail}, "controller": {"swing_file": swing}}
        named.append(caption_of(replace(tailless, scenario=scenario)).facts.split(", ")[-1])
    assert named == ["tail swings", "optimised swing", "tail held"]


def test_title_of_a_car_without_tail_has_no_key_for_it(tailless: RunLog) -> None:
    page = replay_page(tailless)
    assert "no tail" in page
    assert "path of the tail tip" not in page
    assert not any(b"air_on_tail" in message for message in messages(page))


def test_flip_is_told(tailed: RunLog) -> None:
    table = tailed.table.copy()
    table["tilt_truth_rad"] = np.linspace(0.0, np.radians(80.0), len(table))
    assert '<b class="flipped">flipped</b>' in replay_page(replace(tailed, table=table))


def test_log_that_ends_too_early_is_replayed_with_its_outcome_unknown(tailed: RunLog) -> None:
    page = replay_page(replace(tailed, table=tailed.table.iloc[:80]))
    assert '<b class="unknown">outcome not known' in page


def test_name_of_a_scenario_cannot_become_a_script(tailed: RunLog) -> None:
    named = replace(tailed, scenario={**tailed.scenario, "name": "<script>alert(1)</script>"})
    page = replay_page(named)
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_clock_of_the_page_runs_from_the_first_to_the_last_log_time(
    tailed: RunLog, rate: float
) -> None:
    data = json.loads(re.search(r"const run = (\{.*?\});", replay_page(tailed, rate)).group(1))
    assert data["time"][0] == tailed.time[0]
    assert data["time"][-1] == pytest.approx(tailed.time[-1])
    assert (len(data["time"]) - 1) / data["frames_per_second"] == pytest.approx(
        tailed.time[-1] / rate
    )
    speed, roll = (reading["values"] for reading in data["readings"])
    assert speed[-1] == pytest.approx(tailed.signal("velocity_x_truth_m_per_s")[-1], abs=0.02)
    assert roll[-1] == pytest.approx(np.degrees(tailed.signal("roll_truth_rad")[-1]), abs=0.005)


def test_existing_file_is_kept_unless_forced(tailed: RunLog, tmp_path: Path) -> None:
    path = tmp_path / "new" / "run.html"
    write_replay_html(tailed, path)
    path.write_text("precious")
    with pytest.raises(UserError, match="exists already"):
        write_replay_html(tailed, path)
    assert path.read_text() == "precious"
    write_replay_html(tailed, path, force=True)
    assert path.stat().st_size > 1e6


def test_nothing_is_written_for_a_log_that_cannot_be_replayed(
    tailed: RunLog, tmp_path: Path
) -> None:
    left_out = ("plant_position_", "speed_m_per_s")
    plain = tailed.table[[name for name in tailed.table.columns if not name.startswith(left_out)]]
    with pytest.raises(LogError):
        write_replay_html(replace(tailed, table=plain), tmp_path / "run.html")
    assert list(tmp_path.iterdir()) == []
