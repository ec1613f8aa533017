"""Scripts that start workers: refused without a main guard, before any process is started."""

import py_compile
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


def test_a_compiled_script_shows_no_guard_and_is_not_refused(tmp_path):
    script = tmp_path / "study.py"
    check = "aerodima.workbench.batch.main_guard import refuse_unguarded_script"
    script.write_text(f"from {check}\nrefuse_unguarded_script()\n")
    compiled = py_compile.compile(str(script), str(tmp_path / "study.pyc"))
    subprocess.run([sys.executable, compiled], timeout=300, check=True)


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
