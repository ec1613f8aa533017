"""The plain loop: the same pilot, guard and log as the diagram, without Drake."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from aerodima.hardware.car.latency import SWITCH_INTERVAL
from aerodima.hardware.car.wiring import CarCommand, CarReading
from aerodima.hardware.drive.car_guard import CarGuard, Stage
from aerodima.hardware.drive.pilots import Pilot, PilotStep
from aerodima.hardware.drive.run_journal import RunJournal
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.logs.signals import RowUnwrapper
from aerodima.workbench.sensors.roll_filter import RollEstimate, RollFilterSettings, estimate_roll

PERIOD = 0.01
"""s; of every loop that talks to the car."""
WRITE_DELAY = 0.001
"""s after a tick, at which its commands leave: the same instant in the plain loop and in the diagram."""
Clock = Callable[[], float]
Wait = Callable[[float], None]


def wait_until(due: float) -> None:
    """Sleeps until `time.monotonic()` is `due`; returns at once when it is later.

    A thread that wakes up must wait for the interpreter until a thread that computes lets go of it, `SWITCH_INTERVAL`
    at most: it wakes up that much earlier and looks at the clock for the rest.
    """
    time.sleep(max(0.0, due - time.monotonic() - SWITCH_INTERVAL))
    while time.monotonic() < due:
        pass


class Row:
    """One row of the log: what stands on the ports when a tick begins.

    Args:
        start: of the run on `time.monotonic`, s.
    """

    def __init__(self, scenario: Scenario, columns: list[str]) -> None:
        self._settings = RollFilterSettings(rate=scenario.imu.rate, gravity=scenario.environment.gravity or 9.81)
        self._estimate = RollEstimate()
        self._unwrap = RowUnwrapper(columns)

    def make(self, tick: float, step: PilotStep, reading: CarReading, links: np.ndarray) -> np.ndarray:
        """The row (columns,) of a tick (s)."""
        command = step.command
        row = np.concatenate(
            (
                [tick, command.steering_angle, command.throttle, step.planned_turn],
                command.tail_pitch,
                command.tail_roll,
                [step.state],
                reading.tail_state,
                reading.tail_torque,
                reading.imu,
                reading.speed,
                reading.status,
                [self._estimate.roll, self._estimate.roll_rate],
                links,
            )
        )
        return self._unwrap.apply(row)

    def estimate(self, reading: CarReading) -> None:
        """One tick of the roll estimator."""
        self._estimate = estimate_roll(self._estimate, reading.imu, float(reading.speed[0]), self._settings)


def run_loop(
    guard: CarGuard,
    pilot: Pilot,
    scenario: Scenario,
    length: float,
    journal: RunJournal,
    links: Callable[[float], np.ndarray],
    clock: Clock = time.monotonic,
    wait: Wait = wait_until,
) -> float:
    """Drives for `length` s, or until the car has stopped; a guard that is armed drives from the first tick on.

    Args:
        links: the values of `LINK_COLUMNS` for a run that started at the given time.
        clock, wait: of the real loop; tests turn faster.

    Returns:
        When the guard began to stop, s after the start; NaN if it did not.
    """
    start, stopped = clock(), math.nan
    row = Row(scenario, journal.columns)
    step, reading = pilot.start(), guard.reading
    for tick in range(round(length / PERIOD) + 1):
        time_now = tick * PERIOD
        wait(start + time_now)
        journal.append(row.make(time_now, step, reading, links(start)))
        if journal.error:
            guard.stop(journal.error, clock())
        if time_now + 0.5 * PERIOD > length:  # the row of the end; its tick belongs to what comes after
            break
        reading = guard.read(clock(), start + time_now)
        step = pilot.step(time_now, reading)
        row.estimate(reading)
        wait(start + time_now + WRITE_DELAY)
        guard.write(step.command, clock())
        if math.isnan(stopped) and guard.stage in (Stage.HOLDING, Stage.EXITING, Stage.STOPPED):
            stopped = time_now
        if guard.finished:
            break
    return stopped


def idle_until(
    guard: CarGuard,
    condition: Callable[[], bool],
    timeout: float,
    clock: Clock = time.monotonic,
    wait: Wait = wait_until,
) -> bool:
    """Turns the loop without commands until `condition`, the end of the car, or `timeout` s; the condition's answer."""
    start = clock()
    for tick in range(max(1, math.ceil(timeout / PERIOD)) + 1):
        wait(start + tick * PERIOD)
        guard.exchange(CarCommand(), clock())
        if condition():
            return True
        if guard.finished:
            return False
    return False
