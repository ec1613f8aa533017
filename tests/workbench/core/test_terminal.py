"""Lines for a terminal that is stopped: the program goes on, and nothing is lost once it reads."""

import contextlib
import os
import pty
import resource
import socket
import subprocess
import sys
import termios
import time

import pytest

from aerodima.workbench.core.terminal import say

PROGRAM = """
import sys
from aerodima.workbench.core.terminal import say
for number in range(3):
    say(str(number), err=number == 1)
print("done", file=open(sys.argv[1], "w"))
sys.exit(3)
"""


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_terminal_that_takes_nothing_holds_up_no_program(tmp_path, goes_on):
    reader, terminal = pty.openpty()
    termios.tcflow(terminal, termios.TCOOFF)
    done = tmp_path / "done"
    command = [sys.executable, "-c", PROGRAM, str(done)]
    process = subprocess.Popen(command, stdout=terminal, stderr=terminal)
    end = time.monotonic() + 60.0
    while process.poll() is None and not done.exists() and time.monotonic() < end:
        time.sleep(0.01)
    if goes_on:
        termios.tcflow(terminal, termios.TCOON)
    assert process.wait(20.0) == 3
    if goes_on:
        assert sorted(os.read(reader, 100).split()) == [b"0", b"1", b"2"]


@pytest.mark.parametrize("reader", ["reads", "stops", "gone"])
def test_a_socket_holds_up_no_program(reader):
    ours, theirs = socket.socketpair()
    if reader == "stops":
        theirs.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                theirs.send(bytes(4096))
        theirs.setblocking(True)
    elif reader == "gone":
        ours.close()
    command = [sys.executable, "-c", PROGRAM, os.devnull]
    assert subprocess.call(command, stdout=theirs, stderr=theirs, timeout=60.0) == 3
    if reader == "reads":
        assert sorted(ours.recv(100).split()) == [b"0", b"1", b"2"]


def test_a_full_disk_costs_the_lines_alone(tmp_path):
    def fill():
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    command = [sys.executable, "-c", PROGRAM, os.devnull]
    with (tmp_path / "said").open("w") as file:
        assert subprocess.call(command, stdout=file, stderr=file, preexec_fn=fill) == 3


def test_lines_go_where_the_streams_go(capsys):
    say("line")
    say("fault", err=True)
    assert capsys.readouterr() == ("line\n", "fault\n")
