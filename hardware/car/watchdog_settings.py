"""Timing of the watchdog process."""

from __future__ import annotations

from aerodima.workbench.config.quantity import QuantityModel, quantity
from aerodima.workbench.config.scenario_file import load_section
from aerodima.workbench.resources import model_path


class WatchdogTiming(QuantityModel):
    """When the watchdog process acts, and what it sends then."""

    heartbeat_timeout: float = quantity("s", "without a heartbeat while armed, after which it acts", ge=0.05, le=0.25)
    answer_timeout: float = quantity("s", "without an answer to a heartbeat, after which the car stops", gt=0, le=0.25)
    exit_burst: int = quantity("1", "exit frames per motor at once", ge=1, le=10)
    exit_interval: float = quantity("s", "interval of the exit frames after that", gt=0, le=0.1)
    exit_time: float = quantity("s", "for how long it sends these", gt=0, le=10)
    give_up: float = quantity("s", "for how long it waits for an adapter that was unplugged", gt=0, le=3600)
    reopen_after: float = quantity("s", "until it opens the channel anew", gt=0, le=1)
    reminder: float = quantity("s", "interval of the exit frames while a hung drive process lives", gt=0, le=1)
    longest_test: float = quantity("s", "from the cut to the exit frames in a watchdog test", gt=0, le=1)


def load_watchdog_timing() -> WatchdogTiming:
    """The values of `models/parameters/hardware/watchdog.yaml`; `ScenarioError` names what is wrong in it."""
    return load_section(model_path("parameters/hardware/watchdog.yaml"), WatchdogTiming)
