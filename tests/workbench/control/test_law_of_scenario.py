"""A tail law from a file: loaded without Drake, refused in one line when it is none."""

import pytest

from aerodima.workbench.control.user_law import load_law
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

LAW = """
from dataclasses import dataclass

import numpy as np


@dataclass
class Held:
    rate: float = 100.0
    memory_size: int = 0

    def start(self):
        return np.zeros(0)

    def step(self, memory, observation):
        return memory, np.zeros(5), np.zeros(5), 1


class Half:
    rate = 100.0


class Tuned(Held):
    @classmethod
    def from_scenario(cls, scenario):
        return cls(rate=scenario.controller.rate)


class Broken:
    def __init__(self):
        raise ValueError("no gains\\nat all")
"""

SCENARIO = load_scenario("turn_swing", ["controller.rate=50"])


def test_class_of_a_file_becomes_a_law(tmp_path):
    path = tmp_path / "my_law.py"
    path.write_text(LAW)
    law = load_law(f"{path}:Held", SCENARIO)
    assert (type(law).__name__, law.rate, law.memory_size) == ("Held", 100.0, 0)
    assert law.start().shape == (0,)
    assert load_law(f"{path}:Tuned", SCENARIO).rate == 50.0, "from the scenario"


@pytest.mark.parametrize(
    ("place", "named"),
    [
        ("my_law.py", ("my_law.py",)),
        ("other.py:Held", ("other.py",)),
        ("my_law.py:Other", ("Other",)),
        ("my_law.py:Half", ("Half", "memory_size", "start", "step")),
        ("my_law.py:Broken", ("Broken", "ValueError", "no gains")),
        ("empty.py:Held", ("ModuleNotFoundError",)),
    ],
)
def test_what_is_no_law_is_refused_by_name(tmp_path, place, named):
    (tmp_path / "my_law.py").write_text(LAW)
    (tmp_path / "empty.py").write_text("import nothing_of_this_name\n")
    assert_refused(lambda: load_law(f"{tmp_path}/{place}", SCENARIO), UserError, *named)
