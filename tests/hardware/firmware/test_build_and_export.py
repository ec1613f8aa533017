"""Compiling the core, and the sketch that is handed out."""

import shutil
import subprocess

from aerodima.hardware.firmware import teensy_firmware as build
from aerodima.hardware.firmware.teensy_firmware import (
    COMPILERS,
    FirmwareSettings,
    build_core,
    core_sources,
    export_sketch,
    firmware_hash,
)
from aerodima.hardware.protocol.ak70 import AK70_10_24_N_M
from aerodima.workbench.core.errors import HardwareError
from tests.refusals import assert_refused

PROGRAM = """
#include "{sketch}/config.h"
#include <cstdio>
int main() {{
  const aerodima::Config c = aerodima_config();
  aerodima::TeensyCore core(c, 0);
  std::printf("%d %g %u %d %d %d %d\\n", c.owns_can, c.profile.torque, c.watchdog_ms, c.sail_bits,
              c.motor_ids[0], c.motor_ids[1], core.servo());
}}
"""


def settings(**changes):
    values = {"wiring": "teensy_bridge", "profile": AK70_10_24_N_M, **changes}
    return FirmwareSettings(**values)


def test_what_is_in_the_cache_is_not_compiled_again(monkeypatch, tmp_path):
    library = tmp_path / build_core().name
    library.touch()
    monkeypatch.setenv("PATH", "")
    assert build_core(tmp_path) == library


def test_a_core_that_does_not_compile_is_one_line(monkeypatch, tmp_path):
    shutil.copytree(build.SKETCH, tmp_path / "sketch")
    monkeypatch.setattr(build, "SKETCH", tmp_path / "sketch")
    (tmp_path / "sketch" / "src" / "core.cpp").write_text("#error broken\n")
    assert_refused(lambda: build_core(tmp_path / "cache"), HardwareError, "broken")
    assert list((tmp_path / "cache").iterdir()) == []


def test_the_core_needs_no_arduino():
    for path in core_sources():
        assert "Arduino.h" not in path.read_text(encoding="ascii"), path


def test_the_hash_follows_the_sources(monkeypatch, tmp_path):
    before = firmware_hash()
    shutil.copytree(build.SKETCH, tmp_path / "sketch")
    monkeypatch.setattr(build, "SKETCH", tmp_path / "sketch")
    assert firmware_hash() == before
    with open(tmp_path / "sketch" / "src" / "core.cpp", "a") as stream:
        stream.write("// changed\n")
    assert firmware_hash() != before


def test_the_exported_configuration_compiles_and_carries_the_parameters(tmp_path):
    folder = tmp_path / "tail_car"
    exported = settings(wiring="watched_can", sail_bits=10, motor_ids=(4, 9))
    sketch = export_sketch(exported, folder)
    assert sketch == folder / "tail_car.ino"
    program = tmp_path / "main.cpp"
    program.write_text(PROGRAM.format(sketch=folder))
    compiler = next(found for name in COMPILERS if (found := shutil.which(name)))
    sources = [str(path) for path in (folder / "src").glob("*.cpp")]
    subprocess.run(
        [compiler, "-std=c++17", "-Wall", "-Werror", str(program), *sources, "-o", tmp_path / "p"],
        check=True,
    )
    shown = subprocess.run(
        [tmp_path / "p"], capture_output=True, text=True, check=True
    ).stdout.split()
    watchdog = round(1000 * exported.timing.watchdog_timeout)
    assert shown == ["0", "24", str(watchdog), "10", "4", "9", "1500"]


def test_what_cannot_be_built_or_written_is_named(monkeypatch, tmp_path):
    mine = tmp_path / "mine.txt"
    mine.touch()
    assert_refused(lambda: build_core(mine / "cache"), HardwareError, str(mine))
    assert_refused(lambda: export_sketch(settings(), tmp_path), HardwareError, str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert_refused(lambda: build_core(tmp_path / "cache"), HardwareError, *COMPILERS)
