"""What a user can get wrong with `aerodima drive`: one line, status 2, and nothing written."""

import errno
import json
import os
import pty
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.law_of_scenario import load_drive, make_bundle
from aerodima.workbench.controllers.swing_player import SwingPlayer


@pytest.fixture(autouse=True)
def own_state_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


def ports(**changes):
    data = {
        "schema": "aerodima/ports/1",
        "teensy": {"path": "/dev/no-teensy"},
        "imu": {"path": "/dev/no-imu"},
        "can": {"interface": "slcan", "channel": "/dev/no-can"},
        **changes,
    }
    with open("ports.json", "w", encoding="utf-8") as file:
        json.dump(data, file)
    return "ports.json"


def drive(*words):
    result = CliRunner().invoke(build_app(), ["drive", *words])
    return result.exit_code, result.stderr


def refused(*words):
    status, err = drive(*words)
    assert status == 2, err
    line = err.splitlines()[-1]
    assert line.startswith("error: ")
    assert "Traceback" not in err
    assert not os.path.exists("drive.parquet")
    assert not os.path.exists("drive.parquet.journal")
    return line


def test_wrong_words():
    assert "allowed: teensy_bridge, watched_can" in refused(
        "auto_turn", "--ports", ports(), "--wiring", "usb"
    )
    assert "no such ports file" in refused("auto_turn", "--ports", "none.json")
    assert "allowed: ak70" not in refused("nothing", "--ports", ports())
    assert "V3 firmware" in refused("auto_turn", "--ports", ports(firmware_profile="v3"))
    assert "allowed: can, car, console, firmware_profile" in refused(
        "auto_turn", "--ports", ports(wheel={"path": "x"})
    )
    assert "radio, schema" in refused("auto_turn", "--ports", ports(wheel={"path": "x"}))
    assert "allowed with watched_can" in refused(
        "auto_turn", "--ports", ports(), "--traffic", "a.blf"
    )


def test_a_scenario_of_the_rig_is_refused():
    line = refused(str(next(_rig_scenarios())), "--ports", ports())
    assert "aerodima/scenario/1" in line or "unknown key" in line or "missing" in line


def _rig_scenarios():
    from aerodima.workbench.resources import models_dir

    return (models_dir() / "scenarios" / "rig").glob("*.yaml")


def test_rates_that_the_car_does_not_have_are_refused():
    line = refused("auto_turn", "--ports", ports(), "--dry-run", "--set", "controller.rate=50")
    assert "controller.rate: 50 Hz; allowed on the car: 100 Hz" in line


def test_a_missing_watchdog_test_is_told_before_any_port_is_opened():
    assert "no watchdog test of teensy_bridge is recorded" in refused(
        "auto_turn", "--ports", ports()
    )


def test_a_missing_port_is_named_with_its_device():
    line = refused("auto_turn", "--ports", ports(), "--dry-run")
    assert (
        line == "error: teensy: /dev/no-teensy: cannot be opened: there is no such device; is it "
        "plugged in?"
    )
    line = refused("auto_turn", "--ports", ports(), "--dry-run", "--wiring", "watched_can")
    assert "CAN slcan:/dev/no-can" in line
    unknown = ports(can={"interface": "canbus9000", "channel": "x"})
    assert "canbus9000" in refused(
        "auto_turn", "--ports", unknown, "--dry-run", "--wiring", "watched_can"
    )


def test_a_path_that_is_no_serial_device_says_so():
    for path in ("/dev/null", "/dev"):
        line = refused("auto_turn", "--ports", ports(teensy={"path": path}), "--dry-run")
        assert line == f"error: teensy: {path}: cannot be opened: is no serial device"


def test_without_a_terminal_nothing_is_armed():
    assert refused("auto_turn", "--ports", ports(), "--watchdog-test").startswith(
        "error: not armed: nobody said"
    )


def test_a_device_without_permission_says_what_to_do(monkeypatch):
    master, slave = pty.openpty()
    name = os.ttyname(slave)
    opened = os.open

    def denied(
        path, *arguments, **named
    ):  # as for a user who is not in the device's group; root may open everything
        if path == name:
            raise PermissionError(errno.EACCES, "Permission denied", name)
        return opened(path, *arguments, **named)

    monkeypatch.setattr(os, "open", denied)
    assert "permission denied" in refused(
        "auto_turn", "--ports", ports(teensy={"path": name}), "--dry-run"
    )
    os.close(master)
    os.close(slave)


def test_an_existing_log_is_kept(tmp_path):
    (tmp_path / "run.parquet").write_text("mine")
    status, err = drive("auto_turn", "--ports", ports(), "--out", "run.parquet")
    assert status == 2
    assert "run.parquet" in err
    assert (tmp_path / "run.parquet").read_text() == "mine"


def test_a_bundle_carries_scenario_and_swing(tmp_path):
    scenario = load_scenario(
        "auto_turn", ["controller.swing_file=thesis_8_rad_per_s", "manoeuvre.speed=2.5"]
    )
    path = tmp_path / "bundle.json"
    path.write_text(json.dumps(make_bundle(scenario)))
    loaded, law = load_drive(str(path))
    assert loaded == scenario
    assert isinstance(law, SwingPlayer)


def test_wrong_bundles_are_told(tmp_path):
    path = tmp_path / "bundle.json"
    assert "no such file" in refused(str(path), "--ports", ports())
    path.write_text("[1]")
    assert "allowed is a bundle" in refused(str(path), "--ports", ports())
    path.write_text("{")
    assert "cannot be read as JSON" in refused(str(path), "--ports", ports())
    data = make_bundle(load_scenario("auto_turn"))
    path.write_text(json.dumps({**data, "swing": {"schema": "x"}}))
    assert "aerodima/swing/1" in refused(str(path), "--ports", ports())
    path.write_text(json.dumps(data))
    assert "set it before the export" in refused(
        str(path), "--ports", ports(), "--set", "manoeuvre.speed=3"
    )


@pytest.mark.parametrize(
    "words",
    [
        ["drive", "auto_turn", "--ports", "ports.json", "--dry-run"],
        ["emulate", "auto_turn", "--out", "emulated"],
    ],
    ids=["drive", "emulate"],
)
def test_a_missing_can_library_is_named_with_what_to_install(words):
    ports()
    blocked = (
        "import sys; sys.modules['can'] = None\nfrom aerodima.workbench.cli.program import "
        "main\nmain()"
    )
    done = subprocess.run([sys.executable, "-c", blocked, *words], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(
        "needs python-can: pip install 'aerodima-workbench[hardware]'"
    )
    assert "Traceback" not in done.stderr


def test_sketch_of_the_teensy_is_written_for_the_scenario_and_nothing_drives(tmp_path):
    words = (
        "auto_turn",
        "--ports",
        ports(),
        "--set",
        "sail_encoder.bits=10",
        "--firmware",
        str(tmp_path / "sketch"),
    )
    status, err = drive(*words)
    assert (status, err) == (0, "")
    assert (tmp_path / "sketch" / "sketch.ino").is_file()
    assert "#define AERODIMA_SAIL_BITS 10\n" in (tmp_path / "sketch" / "config.h").read_text()
    assert not list(tmp_path.glob("drive*"))
