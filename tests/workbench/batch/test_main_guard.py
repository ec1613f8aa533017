"""Scripts that start workers: refused without a main guard, before any process is started."""

import subprocess
import sys

import pytest

HEAD = """import math
from aerodima.workbench.batch.engine_factory import run_batch
def main():
    print(run_batch(math.sqrt, [4.0, 9.0], 2))
"""
THREADED = """from threading import Thread
thread = Thread(target=main)
thread.start()
thread.join()
"""


def run_script(path, text):
    """Runs a script, or the package whose `__main__.py` it is."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    command = [sys.executable, path]
    if path.name == "__main__.py":
        command = [sys.executable, "-m", path.parent.name]
    return subprocess.run(
        command, cwd=path.parent.parent, capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.parametrize("ending", ["main()\n", THREADED])
def test_a_script_without_a_guard_is_refused_once_and_starts_nothing(tmp_path, ending):
    script = tmp_path / "study.py"
    run = run_script(script, HEAD + ending)
    errors = [text for text in run.stderr.splitlines() if "Error: " in text]
    assert len(errors) == 1
    assert f"{script}, line " in errors[0]
    assert "__main__" in errors[0]
    assert not run.stdout


@pytest.mark.parametrize(
    ("name", "ending"),
    [("study.py", 'if __name__ == "__main__":\n    main()\n'), ("package/__main__.py", "main()\n")],
)
def test_a_script_that_workers_do_not_run_starts_them(tmp_path, name, ending):
    run = run_script(tmp_path / name, HEAD + ending)
    assert (run.stdout, run.stderr) == ("[2.0, 3.0]\n", "")
