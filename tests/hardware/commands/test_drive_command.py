"""What a user can get wrong with `aerodima drive ...`: one line, status 2, and nothing written."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from aerodima.hardware.commands.drive_commands import current_words
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.control.controller_bundle import load_drive, make_bundle
from aerodima.workbench.control.swing_library import find_swing
from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.core.extras import install_command
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import write_swing


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


WATCHED = ["--wiring", "watched_can"]
RIG = str(model_path("scenarios/rig/robot.yaml"))
REFUSED = {
    "wiring": (["run", "auto_turn", "--wiring", "usb"], {}, "--wiring", "usb"),
    "scenario": (["run", "nothing"], {}, "nothing"),
    "scenario of the rig": (["run", RIG], {}, "robot.yaml"),
    "firmware": (["run", "auto_turn"], {"firmware_profile": "v3"}, "v3"),
    "traffic on the bridge": (
        ["run", "auto_turn", "--traffic", "a.blf"], {}, "--traffic", "watched_can"
    ),
    "rate": (["run", "auto_turn", "--set", "controller.rate=50"], {}, "controller.rate", "50"),
    "no watchdog test": (
        ["run", "auto_turn"], {},
        "`aerodima drive watchdog-test auto_turn --ports ports.json --wiring teensy_bridge`",
    ),
    "missing device": (["check", "auto_turn"], {}, "teensy", "/dev/no-teensy"),
    "missing adapter": (["check", "auto_turn", *WATCHED], {}, "slcan", "/dev/no-can"),
    "no terminal": (["watchdog-test", "auto_turn"], {}),
    "command": (["chek"], {}, "chek", "check"),
    "law": (["run", "auto_turn", "--law", "nowhere.py:Law"], {}, "nowhere.py"),
    "law and swing": (
        ["run", "auto_turn", "--law", "no.py:Law", "--swing", "thesis_8_rad_per_s"], {}, "--swing"
    ),
}  # fmt: skip


def test_a_proposed_watchdog_test_has_the_scenario_and_the_ports_of_the_user():
    Path("my car.yaml").write_text("base: field\nmanoeuvre: {kind: auto_turn}\n")
    command = "`aerodima drive watchdog-test 'my car.yaml' --ports ports.json --wiring"
    for words in (["run"], ["motor-test", "--joint", "tail_pitch", "--arm"]):
        refused(words[0], "my car.yaml", *words[1:], "--ports", ports(), named=[command])


@pytest.mark.parametrize("row", REFUSED.values(), ids=REFUSED)
def test_what_is_wrong_is_named_in_the_last_line_and_nothing_is_written(row):
    words, changes, *named = row
    refused(*words, "--ports", ports(**changes), named=named)


def test_a_missing_ports_file_is_named():
    refused("run", "auto_turn", "--ports", "none.json", named=["none.json"])


def refused(*words, named):
    status, err = drive(*words)
    assert status == 2, err
    assert not [part for part in named if part not in err.splitlines()[-1]], err
    assert "Traceback" not in err
    assert not list(Path.cwd().glob("drive.parquet*"))


BUNDLE = make_bundle(load_scenario("auto_turn"))
WRONG_BUNDLES = {
    "no file": (None, [], "bundle.json"),
    "no JSON": ("{", [], "bundle.json"),
    "swing": (json.dumps({**BUNDLE, "swing": {"schema": "x"}}), [], "aerodima/swing/1", "x"),
    "changed": (json.dumps(BUNDLE), ["--set", "manoeuvre.speed=3"], "--set"),
}


@pytest.mark.parametrize("row", WRONG_BUNDLES.values(), ids=WRONG_BUNDLES)
def test_wrong_bundles_are_named(tmp_path, row):
    text, words, *named = row
    path = tmp_path / "bundle.json"
    if text is not None:
        path.write_text(text)
    refused("run", str(path), "--ports", ports(), *words, named=named)


def test_an_existing_log_is_kept(tmp_path):
    (tmp_path / "run.parquet").write_text("mine")
    status, err = drive("run", "auto_turn", "--ports", ports(), "--out", "run.parquet")
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


@pytest.mark.parametrize(
    "words",
    [
        ["drive", "check", "auto_turn", "--ports", "ports.json"],
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
    assert install_command("hardware") in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


SKETCH = ["auto_turn", "--set", "sail_encoder.bits=10", "--ports", "ports.json"]


@pytest.mark.parametrize(
    ("words", "lines"),
    [(["firmware", *SKETCH, "--out=sketch"], 0), ([*SKETCH, "--firmware=sketch"], 1)],
    ids=["now", "version 0.3"],
)
def test_sketch_of_the_teensy_is_written_for_the_scenario_and_nothing_drives(
    tmp_path, words, lines
):
    ports()
    status, err = drive(*words)
    assert (status, err.count("\n")) == (0, lines)
    assert lines == err.count(f"drive firmware {' '.join(SKETCH)} --out=sketch")
    assert (tmp_path / "sketch" / "sketch.ino").is_file()
    assert "#define AERODIMA_SAIL_BITS 10\n" in (tmp_path / "sketch" / "config.h").read_text()
    assert not list(tmp_path.glob("drive*"))


def test_a_swing_for_another_car_is_refused_where_it_is_played(tmp_path):
    """First tests and the sketch play no swing."""
    swing = find_swing("thesis_8_rad_per_s").model_copy(update={"car": {"car.mass": 6.5}})
    path = write_swing(swing, tmp_path / "heavy.yaml")
    words = ["auto_turn", "--set", f"controller.swing_file={path}", "--ports", ports()]
    for command in ("run", "check"):
        refused(command, *words, named=["car.mass", "6.5"])
    assert drive("firmware", *words, "--out=sketch") == (0, "")


def test_words_of_version_0_3_are_those_of_a_command():
    for old, now in (
        ("a.yaml --arm", "run a.yaml --arm"),
        ("--ports p a.yaml --dry-run --arm", "check --ports p a.yaml"),
        (
            "a.yaml --motor-test=tail_roll --ports p",
            "motor-test a.yaml --joint=tail_roll --ports p",
        ),
        ("a.yaml --firmware teensy --out run.parquet --arm", "firmware a.yaml --out=teensy"),
        ("--zero a.yaml --law=my.py --ports p --swing x", "zero a.yaml --ports p"),
    ):
        assert current_words(old.split()) == now.split()
