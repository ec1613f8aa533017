"""`aerodima emulate`: wrong input is one line; its end is orderly; what it leaves can be read."""

import signal
import subprocess
import sys
from pathlib import Path

import can
import pytest
from typer.testing import CliRunner

from aerodima.hardware.car.car_ports import read_events, read_ports
from aerodima.hardware.protocol.ak70 import make_exit
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.logs.schema import read_run_log
from tests.hardware.fake_can import wait_until


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--wiring", "usb"], ("--wiring", "usb")),
        (["--duration", "0"], ("--duration", "0")),
        (["--faults", "nowhere.yaml"], ("nowhere.yaml",)),
        (["--set", "tail.mode=flying"], ("tail.mode", "flying")),
        (["--out", str(Path(__file__).parent)], (str(Path(__file__).parent),)),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing_behind(tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(build_app(), ["emulate", "turn_swing", "--out", "out", *words])
    assert result.exit_code == 2
    assert not [part for part in named if part not in result.stderr], result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


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
