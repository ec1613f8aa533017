"""One message of Drake is dropped by its exact text; every other one is still seen."""

from __future__ import annotations

import logging
import subprocess
import sys

import pytest

from aerodima.workbench.plants.car import HALF_SPACE_WARNING, is_news

BUILD_CAR = """
import logging
from pydrake.systems.framework import DiagramBuilder
from aerodima.workbench.plants import car
from aerodima.workbench.config.scenario import load_scenario
{before}
builder = DiagramBuilder()
car.add_car_plant(builder, load_scenario("turn_swing"))
builder.Build().CreateDefaultContext()
"""


def said(before: str) -> str:
    """What a new process says while it builds a car; Drake warns only once in a process."""
    command = [sys.executable, "-c", BUILD_CAR.format(before=before)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stderr


def test_car_is_built_without_a_message() -> None:
    assert said("") == ""


def test_drake_still_says_what_is_dropped() -> None:
    """Otherwise the filter can go, or its text must follow."""
    assert said("car.is_news = lambda record: True").strip().endswith(HALF_SPACE_WARNING)


def test_other_messages_pass(caplog: pytest.LogCaptureFixture) -> None:
    drake = logging.getLogger("drake")
    drake.addFilter(is_news)
    before = len(drake.filters)
    drake.addFilter(is_news)
    assert len(drake.filters) == before
    drake.warning(HALF_SPACE_WARNING)
    drake.warning("something new")
    assert caplog.messages == ["something new"]
