"""Protocol, transport and motor must run on a computer for which Drake has no wheel."""

from tests.blocked_drake import run_without_drake

PROGRAM = """
import importlib, pkgutil
import aerodima.hardware.protocol, aerodima.hardware.transport
for package in (aerodima.hardware.protocol, aerodima.hardware.transport):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
import aerodima.hardware.devices.motor_group, aerodima.hardware.driving.drive_checks
from tests.hardware.fake_motors import Bench, hold

bench = Bench().to_running(hold(0.0))
assert bench.group.ready
print("runs")
"""


def test_protocol_transport_and_motor_run_with_drake_blocked():
    result = run_without_drake(PROGRAM)
    assert result.stdout == "runs\n", result.stderr
