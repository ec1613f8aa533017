"""Protocol, transport and motor must run on a computer for which Drake has no wheel."""

import subprocess
import sys

PROGRAM = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "pydrake":
            raise ImportError("no Drake here")

sys.meta_path.insert(0, Blocked())
try:
    import pydrake
except ImportError:
    pass
else:
    raise SystemExit("the block does not work")

import importlib, pkgutil
import hardware.protocol, hardware.transport
for package in (hardware.protocol, hardware.transport):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
import hardware.motor_group, hardware.profile_check
from tests.hardware.fake_motors import Bench, hold

bench = Bench().to_running(hold(0.0))
assert bench.group.ready
print("runs")
"""


def test_protocol_transport_and_motor_run_with_drake_blocked():
    result = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert result.stdout == "runs\n", result.stderr
