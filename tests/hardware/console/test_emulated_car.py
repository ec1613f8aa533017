"""Where an emulated car of the console writes, and the console's record."""

from pathlib import Path

from aerodima.hardware.car.car_ports import PORTS_FILE, READY_FILE
from aerodima.hardware.commands.console_command import _next_record
from aerodima.hardware.console.emulated_car import EmulatedCarProcess


def ports_in(folder):
    return EmulatedCarProcess("auto_turn", [], True, "teensy_bridge", folder).ports


def test_a_folder_is_used_again_without_touching_what_is_there(tmp_path):
    folder = tmp_path / "car"
    assert ports_in(folder) == folder / PORTS_FILE
    for number in ("", "2", "3"):
        (folder / number).mkdir(parents=True, exist_ok=True)
        (folder / number / READY_FILE).write_text("{}", encoding="utf-8")
    assert ports_in(folder) == folder / "4" / PORTS_FILE


def test_the_record_has_the_next_free_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert _next_record() == Path("console.jsonl")
    Path("console.jsonl").touch()
    Path("console_2.jsonl").touch()
    assert _next_record() == Path("console_3.jsonl")
