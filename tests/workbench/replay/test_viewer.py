"""The viewer listens on this machine only, and says what is wrong with a port."""

from __future__ import annotations

import gc
import logging
import subprocess
import sys
import threading

import numpy as np
import pytest

from aerodima.workbench.errors import UserError
from aerodima.workbench.replay.viewer import _grid_lines, area_around, open_meshcat


def test_viewer_is_on_this_machine_only_and_quiet(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="drake"):
        meshcat = open_meshcat()
    assert meshcat.web_url().startswith("http://127.0.0.1:")
    assert caplog.records == []


def test_a_viewer_may_be_forgotten_while_another_thread_collects_garbage() -> None:
    """Drake aborts the process where that thread destroys it."""
    cycle: dict[str, object] = {"viewer": open_meshcat()}
    cycle["self"] = cycle
    del cycle
    thread = threading.Thread(target=gc.collect)
    thread.start()
    thread.join()


def test_a_process_whose_replays_were_made_in_another_thread_ends_in_order() -> None:
    """As a worker process of an engine, whose pieces run in a thread of their own."""
    make = "from aerodima.workbench.replay.viewer import open_meshcat"
    code = (
        f"{make}\nfrom threading import Thread\nthread = "
        "Thread(target=open_meshcat)\nthread.start()\nthread.join()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_port_in_use_is_one_clear_error() -> None:
    first = open_meshcat()
    with pytest.raises(
        UserError, match=rf"port {first.port()} of 127\.0\.0\.1 is in use; choose another --port"
    ):
        open_meshcat(first.port())


@pytest.mark.parametrize("port", [-1, 0, 80, 1023, 65536])
def test_port_that_would_end_the_program_is_refused(port: int) -> None:
    with pytest.raises(UserError, match=f"--port: {port}; allowed: 1024 to 65535"):
        open_meshcat(port)


def test_log_level_of_drake_is_as_before() -> None:
    before = logging.getLogger("drake").level
    open_meshcat()
    assert logging.getLogger("drake").level == before


def test_floor_covers_the_path_with_whole_metres() -> None:
    path = np.array([[0.0, 0.0, 0.0], [9.4, -2.2, 0.1], [3.0, 4.1, 0.0]])
    assert area_around(path, margin=3.0) == (-3.0, 13.0, -6.0, 8.0)


def test_grid_has_a_line_each_way_at_every_step() -> None:
    start, end = _grid_lines((0.0, 2.0, -1.0, 2.0), 0.25, -0.001)
    across_x = start[0] == end[0]
    assert sorted(set(start[0, across_x])) == pytest.approx(np.arange(0.0, 2.01, 0.25))
    assert sorted(set(start[1, ~across_x])) == pytest.approx(np.arange(-1.0, 2.01, 0.25))
    total = np.linalg.norm(end - start, axis=0).sum()
    assert total == pytest.approx(9 * 3.0 + 13 * 2.0)
    assert (start[2] == -0.001).all()
