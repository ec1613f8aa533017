"""The drive without Drake: nothing on its way imports pydrake, and the plain loop swings the
tail.
"""

from tests.blocked_drake import run_without_drake

PROGRAM = """
import importlib, pathlib, pkgutil, tempfile
import aerodima.hardware.commands.drive_commands, aerodima.workbench.control.law_of_scenario
from aerodima.hardware import car, devices, driving, protocol, transport
for package in (driving, devices, car, protocol, transport):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name.rpartition(".")[2] not in ("car_interface", "drive_diagram", "__main__"):
            importlib.import_module(module.name)

import numpy as np
from aerodima.hardware.driving.car_guard import CarGuard
from aerodima.hardware.driving.plain_loop import idle_until, run_loop
from aerodima.hardware.driving.plain_loop import AutoPilot
from aerodima.hardware.driving.run_journal import open_run_journal
from aerodima.hardware.protocol.radio import RadioMode
from aerodima.hardware.car.safety_settings import load_drive_safety
from tests.hardware.driving.fake_wiring import FakeWiring, quick_turn

class Time:
    now = 0.0
    def __call__(self):
        return self.now
    def wait(self, due):
        self.now = max(self.now, due)

clock, scenario = Time(), quick_turn()
wiring = FakeWiring(yaw_rate=lambda tick: 2.0 if 60 <= tick < 110 else 0.0)
guard = CarGuard(wiring, load_drive_safety())
idle_until(guard, lambda: True, 0.1, clock, clock.wait)
guard.arm(clock())
idle_until(guard, lambda: guard.was_idle, 0.1, clock, clock.wait)
guard.drive(RadioMode.AUTO, clock())
with tempfile.TemporaryDirectory() as folder:
    journal = open_run_journal(pathlib.Path(folder) / "run.parquet", scenario, "watched_can")
    run_loop(guard, AutoPilot(scenario), scenario, 2.0, journal, clock, clock.wait)
    journal.close()
print("swung" if wiring.roll > 1.3 else wiring.roll)
"""


def test_a_drive_runs_with_drake_blocked():
    result = run_without_drake(PROGRAM)
    assert result.stdout == "swung\n", result.stderr
