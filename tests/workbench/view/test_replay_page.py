"""The replay as a file: one page that needs nothing else, with title, outcome and animation."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.view.replay_page import replay_page, write_replay_html


@pytest.fixture(scope="module")
def page(short_runs):
    return replay_page(short_runs["swing"])


def messages(page):
    """What Drake's Meshcat would have sent to the browser."""
    return [base64.b64decode(code) for code in re.findall(r"base64,([A-Za-z0-9+/=]{40,})", page)]


def test_page_loads_nothing_from_elsewhere(page):
    assert re.findall(r"<(?:script|link|img|iframe|source)\b[^<>]*\b(?:src|href)\s*=", page) == []
    assert re.findall(r"""(?:@import|url\()\s*["']?\s*https?:""", page) == []
    fetched = re.findall(r"""fetch\(["']([^"']{0,40})""", page)
    assert fetched
    assert all(address.startswith("data:") for address in fetched)


def test_no_message_of_a_server_is_seen_while_the_page_loads(page):
    head, _, body = page.partition("<body>")
    assert "No connection to server" in body
    assert "#status-message { display: none; }" in head


def test_page_holds_the_animation_of_every_moving_part(page):
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


def test_log_that_ends_too_early_is_replayed_with_its_outcome_unknown(tailed):
    assert '<b class="unknown">' in replay_page(replace(tailed, table=tailed.table.iloc[:80]))


def test_name_of_a_scenario_cannot_become_a_script(tailed):
    named = replace(tailed, scenario={**tailed.scenario, "name": "<script>alert(1)</script>"})
    page = replay_page(named)
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.parametrize("rate", [1.0, 0.5])
def test_clock_of_the_page_runs_from_the_first_to_the_last_log_time(tailed, rate):
    data = json.loads(re.search(r"const run = (\{.*?\});", replay_page(tailed, rate)).group(1))
    assert data["time"][0] == tailed.time[0]
    assert data["time"][-1] == pytest.approx(tailed.time[-1])
    assert (len(data["time"]) - 1) / data["frames_per_second"] == pytest.approx(
        tailed.time[-1] / rate
    )
    speed, roll = (reading["values"] for reading in data["readings"])
    assert speed[-1] == pytest.approx(tailed.signal("velocity_x_truth_m_per_s")[-1], abs=0.02)
    assert roll[-1] == pytest.approx(np.degrees(tailed.signal("roll_truth_rad")[-1]), abs=0.005)


def test_nothing_is_written_for_a_log_that_cannot_be_replayed(tailed, tmp_path):
    left_out = ("plant_position_", "speed_m_per_s")
    plain = tailed.table[[name for name in tailed.table.columns if not name.startswith(left_out)]]
    with pytest.raises(LogError):
        write_replay_html(replace(tailed, table=plain), tmp_path / "run.html")
    assert list(tmp_path.iterdir()) == []
