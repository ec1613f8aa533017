"""One message of Drake is dropped by its exact text; every other one is still seen."""

import logging
import subprocess
import sys

from aerodima.workbench.car.car_plant import HALF_SPACE_WARNING, drop_half_space_warning

BUILD_CAR = """
from pydrake.systems.framework import DiagramBuilder
from aerodima.workbench.car import car_plant as car
from aerodima.workbench.scenario.scenario import load_scenario
builder = DiagramBuilder()
car.add_car_plant(builder, load_scenario("turn_swing"))
builder.Build().CreateDefaultContext()
"""


def test_car_is_built_without_a_message():
    """Drake warns only once in a process."""
    command = [sys.executable, "-c", BUILD_CAR]
    built = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert built.stderr == ""


def test_other_messages_pass(caplog):
    drake = logging.getLogger("drake")
    drake.addFilter(drop_half_space_warning)
    before = len(drake.filters)
    drake.addFilter(drop_half_space_warning)
    assert len(drake.filters) == before
    drake.warning(HALF_SPACE_WARNING)
    drake.warning("something new")
    assert caplog.messages == ["something new"]
