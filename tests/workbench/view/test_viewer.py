"""The viewer listens on this machine only, and says what is wrong with a port."""

import gc
import logging
import subprocess
import sys
import threading

import pytest

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.view.viewer import open_meshcat
from tests.refusals import assert_refused


def test_viewer_is_on_this_machine_only_and_quiet(caplog):
    with caplog.at_level(logging.INFO, logger="drake"):
        meshcat = open_meshcat()
    assert meshcat.web_url().startswith("http://127.0.0.1:")
    assert caplog.records == []


def test_a_viewer_may_be_forgotten_while_another_thread_collects_garbage():
    """Drake aborts the process where that thread destroys it."""
    cycle = {"viewer": open_meshcat()}
    cycle["self"] = cycle
    del cycle
    thread = threading.Thread(target=gc.collect)
    thread.start()
    thread.join()


def test_a_process_whose_replays_were_made_in_another_thread_ends_in_order():
    """As a worker process of an engine, whose pieces run in a thread of their own."""
    make = "from aerodima.workbench.view.viewer import open_meshcat"
    code = (
        f"{make}\nfrom threading import Thread\nthread = "
        "Thread(target=open_meshcat)\nthread.start()\nthread.join()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def test_port_in_use_is_one_clear_error():
    first = open_meshcat()
    named = (str(first.port()), "127.0.0.1", "--port")
    assert_refused(lambda: open_meshcat(first.port()), UserError, *named)


@pytest.mark.parametrize("port", [-1, 0, 80, 1023, 65536])
def test_port_that_would_end_the_program_is_refused(port):
    assert_refused(lambda: open_meshcat(port), UserError, "--port", str(port), "1024", "65535")
