"""The program `aerodima` seen from outside: commands found by entry point, exit statuses, one line per user error."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from aerodima.workbench.cli.options import SECTIONS

PROBE = '''
import time
import typer
from aerodima.workbench.errors import ScenarioError, UserError


def register(app):
    @app.command()
    def probe(kind: str, times: int = 1):
        """A command of another package."""
        if kind == "user":
            raise UserError("car.yaml: mass: -1 kg; allowed: 4.5 to 8 kg")
        if kind == "scenario":
            raise ScenarioError("speed: nan m/s is not a number")
        if kind == "unwritable":
            open("/no/such/folder/file", "w")
        if kind == "nameless":
            raise OSError(5, "Input/output error")
        if kind == "bug":
            raise ValueError("a bug")
        if kind == "wait":
            print("waiting", flush=True)
            time.sleep(60)
        print("done", kind, times)
'''

Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A process environment in which another distribution, with one command, is installed."""
    (tmp_path / "probe_commands.py").write_text(PROBE)
    metadata = tmp_path / "probe-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: probe\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[aerodima.commands]\nprobe = probe_commands:register\n")
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


@pytest.fixture
def aerodima(environment: dict[str, str]) -> Run:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "aerodima", *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)

    return run


def test_help_lists_the_commands_of_every_distribution(aerodima: Run) -> None:
    done = aerodima("--help")
    assert done.returncode == 0
    assert re.search(r"^\s+probe\s+A command of another package\.$", done.stdout, re.MULTILINE)


def test_help_begins_with_what_a_newcomer_runs_and_gives_every_command_a_section(aerodima: Run) -> None:
    sections = re.findall(r"^(\S[^\n]*):\n((?:  .*\n)+)", aerodima("--help").stdout, re.MULTILINE)
    titles = [title for title, _ in sections]
    assert titles == ["Options", *SECTIONS, "Commands"]
    assert re.match(r"  (\S+)", sections[1][1]).group(1) in ("demo", "turn")
    (own,) = sections[-1][1].splitlines()  # only what comes from another package
    assert own.split()[0] == "probe"


def test_version_is_printed_alone(aerodima: Run) -> None:
    done = aerodima("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"aerodima \d+\.\d+\.\d+\n", done.stdout)


def test_command_gets_its_arguments(aerodima: Run) -> None:
    done = aerodima("probe", "fine", "--times", "3")
    assert (done.returncode, done.stdout, done.stderr) == (0, "done fine 3\n", "")


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("user", "error: car.yaml: mass: -1 kg; allowed: 4.5 to 8 kg\n"),
        ("scenario", "error: speed: nan m/s is not a number\n"),
        ("unwritable", "error: /no/such/folder/file: No such file or directory\n"),
    ],
)
def test_what_a_user_can_mend_is_one_line_and_status_2(aerodima: Run, kind: str, line: str) -> None:
    done = aerodima("probe", kind)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", line)


@pytest.mark.parametrize(
    ("kind", "last"), [("bug", "ValueError: a bug"), ("nameless", "OSError: [Errno 5] Input/output error")]
)
def test_bug_keeps_its_traceback_and_is_status_1(aerodima: Run, kind: str, last: str) -> None:
    done = aerodima("probe", kind)
    assert done.returncode == 1
    assert done.stderr.startswith("Traceback (most recent call last):")
    assert done.stderr.splitlines()[-1] == last


@pytest.mark.parametrize(
    "arguments",
    [("--no-such-flag",), ("no-such-command",), ("probe",), ("probe", "fine", "--times", "many"), ("probe", "a", "b")],
    ids=["flag", "command", "missing", "type", "extra"],
)
def test_bad_flag_is_status_2_without_traceback(aerodima: Run, arguments: tuple[str, ...]) -> None:
    done = aerodima(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "Error: " in done.stderr


def listen_to_ctrl_c() -> None:
    """A shell starts background jobs deaf to Ctrl-C, and their children inherit it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_is_one_line_and_status_130(environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "aerodima", "probe", "wait"]
    with subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=listen_to_ctrl_c,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (130, "interrupted\n")


def test_package_that_fails_to_register_is_named(environment: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "probe_commands.py").write_text("raise ImportError('no module named gears')")
    done = subprocess.run(
        [sys.executable, "-m", "aerodima", "--help"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert "no module named gears" in done.stderr
    assert "while registering the commands of 'probe' (probe_commands:register)" in done.stderr


def test_shell_completes_commands(environment: dict[str, str]) -> None:
    asked = {"_AERODIMA_COMPLETE": "complete_bash", "COMP_WORDS": "aerodima tur", "COMP_CWORD": "1"}
    program = Path(sys.executable).with_name("aerodima")
    done = subprocess.run([program], env={**environment, **asked}, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["turn"]
