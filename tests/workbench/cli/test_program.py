"""The program `aerodima` seen from outside: commands found by entry point, exit statuses, one line
per user error.
"""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.cli.options import Status
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario

PROBE = '''
import time
import typer
from aerodima.workbench.core.errors import ScenarioError, UserError


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
        if kind == "full":
            raise OSError(28, "No space left on device")
        if kind == "sign":
            print("≤")
        if kind == "bug":
            raise ValueError("a bug")
        if kind == "wait":
            print("waiting", flush=True)
            time.sleep(60)
        print("done", kind, times)
'''


@pytest.fixture
def environment(tmp_path):
    """A process environment in which another distribution, with one command, is installed."""
    (tmp_path / "probe_commands.py").write_text(PROBE)
    metadata = tmp_path / "probe-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: probe\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[aerodima.commands]\nprobe = probe_commands:register\n"
    )
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")]),
    }


@pytest.fixture
def aerodima(environment):
    def run(*arguments):
        command = [sys.executable, "-m", "aerodima", *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)

    return run


def test_version_is_printed_alone(aerodima):
    done = aerodima("--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"aerodima \d+\.\d+\.\d+\n", done.stdout)


def test_a_sign_that_the_terminal_lacks_is_escaped(aerodima, environment):
    environment["PYTHONIOENCODING"] = "latin-1"
    assert aerodima("probe", "sign").stdout.splitlines()[0] == "\\u2264"


def test_command_gets_its_arguments(aerodima):
    done = aerodima("probe", "fine", "--times", "3")
    assert (done.returncode, done.stdout, done.stderr) == (0, "done fine 3\n", "")


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("user", "error: car.yaml: mass: -1 kg; allowed: 4.5 to 8 kg\n"),
        ("scenario", "error: speed: nan m/s is not a number\n"),
        ("unwritable", "error: /no/such/folder/file: No such file or directory\n"),
        ("full", "error: disk: No space left on device\n"),
    ],
)
def test_what_a_user_can_mend_is_one_line_and_status_2(aerodima, kind, line):
    done = aerodima("probe", kind)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", line)


@pytest.mark.parametrize(
    ("kind", "last"),
    [("bug", "ValueError: a bug"), ("nameless", "OSError: [Errno 5] Input/output error")],
)
def test_bug_keeps_its_traceback(aerodima, kind, last):
    done = aerodima("probe", kind)
    assert done.returncode == 70
    assert done.stderr.startswith("Traceback (most recent call last):")
    assert done.stderr.splitlines()[-1] == last


@pytest.mark.parametrize(
    "arguments",
    [
        ("--no-such-flag",),
        ("no-such-command",),
        ("probe",),
        ("probe", "fine", "--times", "many"),
    ],
    ids=["flag", "command", "missing", "type"],
)
def test_bad_flag_is_status_2_without_traceback(aerodima, arguments):
    done = aerodima(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "Error: " in done.stderr


def listen_to_ctrl_c():
    """A shell starts background jobs deaf to Ctrl-C, and their children inherit it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_ctrl_c_is_one_line_and_status_130(environment):
    command = [sys.executable, "-m", "aerodima", "probe", "wait"]
    with subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=listen_to_ctrl_c,
    ) as process:
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert (process.returncode, errors) == (130, "interrupted\n")


def test_package_that_fails_to_register_is_named(environment, tmp_path):
    (tmp_path / "probe_commands.py").write_text("raise ImportError('no module named gears')")
    done = subprocess.run(
        [sys.executable, "-m", "aerodima", "--help"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 70
    assert "no module named gears" in done.stderr
    assert "probe_commands:register" in done.stderr


LAW = (
    "class Stop:\n    rate, memory_size = 100.0, 0\n    def step(self, memory, observation): ...\n"
)
INTERRUPTED = "    def start(self):\n        raise KeyboardInterrupt\n"
TABLE = re.findall(
    r"^\| (\d+) \|",
    (Path(__file__).parents[3] / "docs" / "commands.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)
COMMANDS = {
    Status.DONE: "scenarios list",
    Status.NO: "models check {folder}/broken.sdf",
    Status.WRONG: "run nowhere",
    Status.LEFT_OUT: "fit friction {folder}/swing.parquet {folder}/cut.parquet --workers 1 --out "
    "{folder}/fits",
    Status.BUG: "probe bug",
    Status.INTERRUPTED: "run turn_swing --law {folder}/law.py:Stop",
}


def test_table_of_the_documentation_has_every_exit_status():
    assert list(map(int, TABLE)) == list(Status) == list(COMMANDS)


@pytest.mark.parametrize("status", COMMANDS, ids=lambda status: status.name)
def test_exit_status_is_that_of_the_table(aerodima, call, tmp_path, status):
    if status == Status.LEFT_OUT:
        simulate(load_rig_scenario("bar", ["experiment.duration=3"]), tmp_path / "swing.parquet")
    (tmp_path / "cut.parquet").write_text("cut")
    (tmp_path / "broken.sdf").write_text("<sdf version='1.9'><model name='m'/></sdf>")
    (tmp_path / "law.py").write_text(LAW + INTERRUPTED)
    words = COMMANDS[status].format(folder=tmp_path).split()
    found = aerodima(*words).returncode if status == Status.BUG else call(*words).exit_code
    assert found == status


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run turn_sw", {"turn_swing", "turn_swing_free_sail", "turn_swing_wind"}),
        ("rig static -s maxon.torque", {"maxon.torque_constant="}),
        ("run turn_swing --law my_", {"my_law.py:Mine"}),
        ("log export run.parquet --to m", {"mcap"}),
        ("drive run auto_turn --wiring t", {"teensy_bridge"}),
    ],
)
def test_shell_completes(tmp_path, monkeypatch, words, offered):
    monkeypatch.chdir(tmp_path)
    Path("my_law.py").write_text("import numpy\n\n\nclass Mine:\n    pass\n")
    line = f"aerodima {words}"
    asked = {
        "COMP_WORDS": line,
        "COMP_CWORD": str(len(words.split())),
        "_TYPER_COMPLETE_ARGS": line,
    }
    done = CliRunner().invoke(build_app(), [], env=asked | {"_AERODIMA_COMPLETE": "complete_bash"})
    found = set(done.stdout.split())
    assert found >= offered, done.output
    assert all(word.startswith(words.split()[-1]) for word in found)
