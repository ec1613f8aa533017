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
GUARDED = '\nif __name__ == "__main__":\n    main()\n'


def run_script(path, text):
    path.write_text(text)
    return subprocess.run(
        [sys.executable, path], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("ending", ["main()\n", THREADED])
def test_a_script_without_a_guard_is_refused_once_and_starts_nothing(tmp_path, ending):
    script = tmp_path / "study.py"
    run = run_script(script, HEAD + ending)
    line = HEAD.count("\n") + ending.count("\n")
    errors = [text for text in run.stderr.splitlines() if "Error: " in text]
    assert len(errors) == 1
    assert f"{script}, line {line}:" in errors[0]
    assert "__main__" in errors[0]
    assert not run.stdout


def test_a_script_with_a_guard_starts_its_workers(tmp_path):
    run = run_script(tmp_path / "study.py", HEAD + GUARDED)
    assert (run.stdout, run.stderr) == ("[2.0, 3.0]\n", "")
