"""`aerodima emulate`: wrong input is one line; its end is orderly; what it leaves can be read."""

import signal
import subprocess
import sys
from pathlib import Path

import can
import pytest

from aerodima.hardware.car.car_ports import read_ports
from aerodima.hardware.commands.car_commands import emulate
from aerodima.hardware.emulator.fault_script import read_events
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.resources import model_path
from tests.hardware.fake_can import wait_until


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"wiring": "usb"}, "--wiring usb: allowed: teensy_bridge, watched_can"),
        ({"duration": 0.0}, "--duration 0 s: allowed is more than 0"),
        ({"faults": Path("nowhere.yaml")}, "nowhere.yaml: no such file"),
        ({"scenario": str(model_path("scenarios/rig/robot.yaml"))}, r"robot\.yaml"),
        ({"scenario": "no_such_car"}, "no_such_car"),
        ({"settings": ["tail.mode=flying"]}, "tail.mode"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing_behind(tmp_path, arguments, message):
    out = tmp_path / "out"
    with pytest.raises(UserError, match=message) as caught:
        emulate(**{"scenario": "turn_swing", "out": out, "wiring": "watched_can",
                   "faults": None, "duration": None, "settings": None,
                   **arguments})  # fmt: skip
    assert "\n" not in str(caught.value)
    assert not out.exists()


@pytest.mark.slow
def test_a_folder_with_something_in_it_is_not_used(tmp_path):
    (tmp_path / "mine.txt").touch()
    result = _run(tmp_path, "--duration", "0.1")
    assert result.returncode == 2
    assert (
        result.stderr
        == f"error: {tmp_path}: is not empty; an emulator writes into a folder of its own\n"
    )


@pytest.mark.slow
def test_a_missing_compiler_is_one_line(tmp_path):
    environment = {
        "PATH": str(tmp_path),
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    result = _run(tmp_path / "out", "--duration", "0.1", environment=environment)
    assert result.returncode == 2
    assert result.stderr.startswith("error: the firmware's core needs a C++17 compiler")
    assert result.stderr.count("\n") == 1


@pytest.mark.emulated
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order_with_logs_that_can_be_read(tmp_path, number):
    out = tmp_path / "emulated"
    command = [sys.executable, "-m", "aerodima", "emulate", "turn_swing", "--out", str(out)]
    process = subprocess.Popen([*command, "--wiring", "watched_can"], stdout=subprocess.DEVNULL)
    assert wait_until((out / "ready.json").exists, 60.0)
    ports = read_ports(out / "ports.json")
    assert Path(ports.can.channel).is_char_device()
    process.send_signal(number)
    assert process.wait(30.0) == 0
    assert read_events(out / "events.jsonl")[-1]["event"] == "ended"
    log = read_run_log(out / "truth.parquet")
    assert log.has_truth
    assert log.extra["emulated"] == "watched_can"
    said = [
        bytes(message.data)
        for message in can.BLFReader(out / "traffic.blf")
        if message.arbitration_id in (1, 2)
    ]
    assert set(said[2:]) == {
        make_exit(1).data
    }  # the Teensy switches off what it finds, after a neutral command each
    assert list((out / "ports").iterdir()) == []


@pytest.mark.emulated
def test_it_ends_with_the_process_that_started_it(tmp_path):
    out = tmp_path / "emulated"
    start = (
        "import os, subprocess, sys, time; "
        "subprocess.Popen([sys.executable, '-m', 'aerodima', 'emulate', 'turn_swing', '--out', "
        "sys.argv[1], '--parent', str(os.getpid())]); time.sleep(60)"
    )
    starter = subprocess.Popen([sys.executable, "-c", start, str(out)], stdout=subprocess.DEVNULL)
    assert wait_until((out / "ready.json").exists, 60.0)
    starter.kill()
    starter.wait()
    assert wait_until(lambda: read_events(out / "events.jsonl")[-1]["event"] == "ended", 20.0)


def _run(out, *arguments, environment=None):
    command = [
        sys.executable,
        "-m",
        "aerodima.workbench.cli.program",
        "emulate",
        "turn_swing",
        "--out",
        str(out),
        *arguments,
    ]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
