"""`aerodima sweep run`, end to end in processes: Ctrl-C, a scheduler that was
started by hand.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from aerodima.optimisation.studies.run_study import ROWS, TABLE, run_study
from aerodima.optimisation.studies.study import load_study
from aerodima.workbench.batch.engine import Engine
from tests.code_measure import ROOT
from tests.commands import refused
from tests.optimisation.studies.tiny import assert_same_table, tiny_study, write_study
from tests.refusals import assert_named

PATIENCE = 300.0
"""s; a busy machine starts workers slowly."""
MANY = 80
"""Runs of a study that cannot end before a test that watches it has stepped in, however late that
test is served."""
PAGE = ROOT / "docs/howto/studies.md"
AERODIMA = [sys.executable, "-m", "aerodima"]


def wait_for(condition, process=None):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        assert process is None or process.poll() is None, process.communicate()
        time.sleep(0.05)


def listen_to_ctrl_c():
    """A job in the background ignores it, and its children would too."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def started(*command):
    """A process that is gone at the end; it has a process group of its own, so that a Ctrl-C
    reaches it alone.
    """
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=listen_to_ctrl_c,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            process.communicate(timeout=PATIENCE)


def rows(out):
    path = out / ROWS
    return len(path.read_bytes().splitlines()) - 1 if path.exists() else 0


@pytest.mark.slow
@pytest.mark.nightly
def test_ctrl_c_loses_and_doubles_nothing(tmp_path):
    grid = f"grid:\n  manoeuvre.speed: {{first: 1.0, last: 2.0, number: {MANY}}}\n"
    study = write_study(tmp_path / "study.yaml", grid)
    out = tmp_path / "out"
    command = [*AERODIMA, "sweep", "run", str(study), "--out", str(out)]
    with started(*command) as client:
        wait_for(lambda: rows(out) >= 2, client)
        os.killpg(client.pid, signal.SIGINT)  # as the terminal does: the workers get it too
        _, told = client.communicate(timeout=PATIENCE)
    assert client.returncode == 130, told
    assert str(rows(out)) in told
    assert "Traceback" not in told
    assert 2 <= rows(out) < MANY
    assert not (out / TABLE).exists()
    subprocess.run(command, capture_output=True, timeout=PATIENCE, check=True)
    run_study(load_study(study), tmp_path / "undisturbed", Engine())
    assert_same_table(out, tmp_path / "undisturbed")


@pytest.mark.slow
def test_scheduler_and_worker_of_the_page_give_the_same_table(tmp_path):
    study = tiny_study(tmp_path)
    found = tmp_path / "scheduler.json"
    dask = str(Path(sys.executable).with_name("dask"))
    scheduler, worker = (
        line.split()[1:] for line in re.findall(r"^dask .*", PAGE.read_text(), re.MULTILINE)
    )
    with ExitStack() as stack:
        stack.enter_context(
            started(dask, *scheduler, "--port", "0", "--scheduler-file", str(found))
        )
        wait_for(found.exists)
        address = json.loads(found.read_text())["address"]
        chosen = {"tcp://127.0.0.1:8786": address, "32": "1"}
        worker = [chosen.get(word, word) for word in worker]
        stack.enter_context(started(dask, *worker, "--local-directory", str(tmp_path)))
        wait_for(lambda: _has_worker(address))
        words = ("sweep", "run", study, "--out", tmp_path / "out", "--scheduler", address)
        command = [*AERODIMA, *map(str, words)]
        subprocess.run(command, timeout=PATIENCE, check=True)
    run_study(load_study(study), tmp_path / "here", Engine())
    assert_same_table(tmp_path / "out", tmp_path / "here")


def _has_worker(address):
    from distributed import Client

    with Client(address, timeout=PATIENCE) as client:
        return bool(client.nthreads())


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("run", "{folder}/wrong.yaml"), ("car.tyre_frction", "car.tyre_friction")),
        (("run", "{folder}/study.yaml", "--workers", "0"), ("--workers", "0")),
        (("run", "triger"), ("triger", "trigger")),
        (("run", "absent.yaml"), ("absent.yaml",)),
    ],
)
def test_mistakes_end_in_one_line_before_any_worker_is_started(tmp_path, words, named):
    write_study(tmp_path / "wrong.yaml", "grid:\n  car.tyre_frction: [0.5]\n")
    tiny_study(tmp_path)
    out = tmp_path / "out"
    words = [word.format(folder=tmp_path) for word in words]
    assert_named(refused("sweep", *words, "--out", out), named)
    assert not out.exists()
