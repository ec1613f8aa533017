"""Programs that run in a Python in which Drake cannot be imported, as on a computer it has no wheel
for.
"""

import subprocess
import sys

BLOCK = """
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
"""


def run_without_drake(program: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", BLOCK + program], capture_output=True, text=True, check=False
    )
