"""Lines for a terminal that is stopped: the program goes on, and nothing is lost once it reads."""

import os
import pty
import subprocess
import sys
import termios

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
    while process.poll() is None and not done.exists():
        pass
    if goes_on:
        termios.tcflow(terminal, termios.TCOON)
    assert process.wait(20.0) == 3
    if goes_on:
        assert sorted(os.read(reader, 100).split()) == [b"0", b"1", b"2"]


def test_lines_go_where_the_streams_go(capsys):
    say("line")
    say("fault", err=True)
    assert capsys.readouterr() == ("line\n", "fault\n")
