"""Studies whose runs take a tenth of a second: a fifth of a second straight ahead."""

import os

from aerodima.optimisation.studies.run_study import TABLE
from aerodima.optimisation.studies.runs import evaluate

POISON = "poison"
"""Name of a task that ends the process that works on it."""

TINY_SETTINGS = (
    "manoeuvre.duration=0.2",
    "manoeuvre.speed_ramp=0.1",
    "manoeuvre.turn_start=0.1",
    "tail.mode=none",
)


def write_study(path, text):
    path.write_text(
        f"schema: aerodima/study/1\nname: tiny\nscenario: straight\nsettings: "
        f"[{', '.join(TINY_SETTINGS)}]\n{text}"
    )
    return path


def tiny_study(folder):
    return write_study(
        folder / "study.yaml", "grid:\n  manoeuvre.speed: {first: 1.0, last: 2.0, number: 4}\n"
    )


def assert_same_table(out, other):
    """Asserts that the tables of two studies have the same bytes."""
    assert (out / TABLE).read_bytes() == (other / TABLE).read_bytes()


def evaluate_or_die(task):
    if task.name == POISON:
        os._exit(9)
    return evaluate(task)
