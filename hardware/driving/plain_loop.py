"""The loop of a drive and its pilots: a sequence with its tail law, or the operator by radio.

It works without Drake.

`aerodima.hardware.driving.drive_diagram.DiagramPilot` is the sequence as a diagram.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from aerodima.hardware.car.wiring import PERIOD, CarCommand, CarReading
from aerodima.hardware.devices.motor_limits import clip
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.driving.car_guard import CarGuard
from aerodima.hardware.driving.run_journal import RunJournal, drive_columns
from aerodima.workbench.car.roll_filter import RollEstimate, RollFilterSettings, estimate_roll
from aerodima.workbench.control.driver_law import (
    DriverLaw,
    DriverView,
    ScheduledDriver,
    limited_driver,
    make_driver,
)
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import DriverInput
from aerodima.workbench.control.tail_law import TailLaw, observe
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.realtime import SWITCH_INTERVAL
from aerodima.workbench.logs.signals import RowUnwrapper
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import CAR_PORTS, IMU, STATION_OUTPUTS

WRITE_DELAY = 0.001
"""Time from a tick to its commands, s; the same in the plain loop and in the diagram."""
Clock = Callable[[], float]
Wait = Callable[[float], None]


def wait_until(due: float) -> None:
    """Sleeps until `time.monotonic()` is `due`; returns at once if it is later.

    A thread that wakes up must wait until a computing thread releases the interpreter, at most
    `SWITCH_INTERVAL`. It therefore wakes up that much earlier and watches the clock for the rest.
    """
    time.sleep(max(0.0, due - time.monotonic() - SWITCH_INTERVAL))
    while time.monotonic() < due:
        pass


class Row:
    """Rows of the log: the values of the ports when a tick begins.

    Commands are those that the guard sent, with throttle 0 and steering 0 once a car stops. In a
    dry run, which sends none, they are the pilot's. A tail that its motors hold has the command 0.

    Args:
        scenario: scenario with the settings of the roll estimator.
        columns: names of the log's columns, in order.
    """

    def __init__(self, scenario: Scenario, columns: list[str]) -> None:
        self._settings = RollFilterSettings.from_scenario(scenario)
        self._estimate = RollEstimate()
        self._unwrap = RowUnwrapper(columns)
        self._unknown = np.full(len(columns) - len(drive_columns()), math.nan)

    def make(
        self,
        tick: float,
        step: PilotStep,
        sent: CarCommand | None,
        reading: CarReading,
        links: list[float],
    ) -> FloatArray:
        """Makes the row (columns,) of a tick; a diagram's own columns are NaN while another pilot
        drives.

        Args:
            tick: time of the tick, s.
            step: outputs of the pilot.
            sent: command that the guard sent; None before the car is armed.
            reading: reading of the car.
            links: values of `LINK_COLUMNS`, s.
        """
        command = sent or step.command
        values: dict[str, FloatArray | float] = {
            **{name: getattr(reading, name) for name in STATION_OUTPUTS},
            "steering_angle": command.steering_angle,
            "throttle": command.throttle,
            "tail_pitch_command": command.tail_pitch,
            "tail_roll_command": command.tail_roll,
            "planned_turn": step.planned_turn,
            "state": step.state,
            "roll_estimate": self._estimate.roll,
            "roll_rate_estimate": self._estimate.roll_rate,
        }
        own = self._unknown if step.own is None else step.own
        return self._unwrap.apply(
            np.hstack([tick, *(values[port] for port in CAR_PORTS), links, own])
        )

    def estimate(self, reading: CarReading) -> None:
        """Updates the roll estimator by one tick."""
        self._estimate = estimate_roll(
            self._estimate, reading.imu, float(reading.speed[0]), self._settings
        )


def run_loop(
    guard: CarGuard,
    pilot: Pilot,
    scenario: Scenario,
    length: float,
    journal: RunJournal,
    clock: Clock = time.monotonic,
    wait: Wait = wait_until,
) -> float:
    """Drives for `length` s, or until the car has stopped; a guard in the stage `DRIVING` passes
    commands on from the first tick.

    Args:
        clock: function that returns the time, s; tests replace it.
        wait: function that waits until an instant on that clock, s; tests replace it.

    Returns:
        Time at which the guard began to stop, s after the start; NaN if it did not.
    """
    row = Row(scenario, journal.columns)
    step = pilot.start()
    reading = guard.reading
    start = clock()
    spent = 0.0
    for tick in range(round(length / PERIOD) + 1):
        time_now = tick * PERIOD
        wait(start + time_now)
        wiring = guard.wiring
        links = [guard.lateness, wiring.imu_time - start, wiring.teensy_time - start, spent]
        journal.append(row.make(time_now, step, guard.sent, reading, links))
        if journal.error:
            guard.stop(journal.error, clock(), "log")
        # This row marks the end; its tick belongs to what comes after.
        if time_now + 0.5 * PERIOD > length:
            break
        reading = guard.read(clock(), start + time_now)
        spent = 0.0
        if not guard.reason:  # the pilot may be what failed
            begin = clock()
            step = pilot.step(time_now, reading)
            spent = clock() - begin
            guard.note_computing(spent, clock())
        row.estimate(reading)
        wait(start + time_now + WRITE_DELAY)
        guard.write(step.command, clock())
        if guard.finished:
            break
    return guard.stop_time - start


def idle_until(
    guard: CarGuard,
    condition: Callable[[], bool],
    timeout: float,
    clock: Clock = time.monotonic,
    wait: Wait = wait_until,
) -> bool:
    """Runs the loop without commands until `condition` holds, the car has stopped, or `timeout` s
    have passed; returns whether the condition holds.
    """
    start = clock()
    for tick in range(max(1, math.ceil(timeout / PERIOD)) + 1):
        wait(start + tick * PERIOD)
        now = clock()
        guard.read(now)
        guard.write(CarCommand(), now)
        if condition():
            return True
        if guard.finished:
            return False
    return False


class PilotStep(NamedTuple):
    """Outputs of a pilot in one tick.

    Attributes:
        command: command to the car.
        planned_turn: announced turn: +1 left, -1 right, 0 none.
        state: number of the tail law's state.
        own: values that a diagram exports or logs in addition, (columns,); None without any.
    """

    command: CarCommand
    planned_turn: float
    state: int
    own: FloatArray | None = None


class Pilot:
    """Driver of the car in the loop, one tick at a time."""

    def start(self) -> PilotStep:
        """Returns the outputs before the first tick."""
        return PilotStep(CarCommand(), 0.0, 0)

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Runs one tick, `time` s after the start of the run."""
        raise NotImplementedError


class LawPilot(Pilot):
    """A driver and a tail law, tick for tick as `TurnDriver` and `TailController` run them.

    The law sees the steering and the turn that was announced one tick before, as the discrete
    systems of the diagram do.

    Args:
        scenario: scenario of the car.
        driver: driver of the car; it looks at the IMU alone.
        law: law of the tail; None is that of the scenario.
    """

    def __init__(self, scenario: Scenario, driver: DriverLaw, law: TailLaw | None) -> None:
        self._law = law or law_of_scenario(scenario)
        self._memory = self._law.start()
        self._driver = driver
        self._driver_memory = driver.start()
        _, self._given = driver.step(self._driver_memory, DriverView(0.0))

    def start(self) -> PilotStep:
        """Implements `Pilot`."""
        given = self._given
        return PilotStep(CarCommand(given.steering_angle, given.throttle), given.planned_turn, 0)

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Implements `Pilot`."""
        before = self._given
        imu = IMU.read(reading.imu)
        view = DriverView(time, yaw_rate=imu.gyro_z, roll=imu.roll, roll_rate=imu.gyro_x)
        self._driver_memory, self._given = self._driver.step(self._driver_memory, view)
        steering, throttle, plan = self._given
        observation = observe(
            time,
            reading.tail_state,
            reading.imu,
            reading.status,
            before.planned_turn,
            reading.speed,
            steering_angle=before.steering_angle,
        )
        self._memory, pitch, roll, state = self._law.step(self._memory, observation)
        return PilotStep(CarCommand(steering, throttle, pitch, roll), plan, state)


class AutoPilot(LawPilot):
    """The manoeuvre of a scenario and its tail law."""

    def __init__(self, scenario: Scenario, law: TailLaw | None = None) -> None:
        super().__init__(scenario, make_driver(scenario), law)


class ControlPilot(LawPilot):
    """The operator's steering and throttle, with the tail by its law: the turn that is steered
    counts as announced.
    """

    def __init__(self, scenario: Scenario, law: TailLaw | None = None) -> None:
        self._steer = scenario.servo.limit
        self._operator = IDLE
        super().__init__(scenario, limited_driver(ScheduledDriver(self), scenario), law)

    def at(self, time: float) -> DriverInput:
        """Implements `Schedule`: the inputs of the operator now."""
        del time
        steering = clip(self._operator.steering, self._steer)
        return DriverInput(steering, self._operator.throttle, float(np.sign(steering)))

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Implements `Pilot`."""
        self._operator = reading.operator
        return super().step(time, reading)


class ManualPilot(Pilot):
    """The operator's sticks: steering, throttle, and two tail angles that are held with the gains
    of the scenario.

    The tail follows its sticks from where it is, at most at `ramp_speed` of the motors' safety, so
    that a stick that jumps does not swing it.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._gains = scenario.controller.hold_gains
        self._steer = scenario.servo.limit
        self._tail: FloatArray | None = None
        self._max_travel = load_motor_safety().ramp_speed / scenario.controller.rate

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Implements `Pilot`."""
        del time
        operator = reading.operator
        (kp, kd) = self._gains
        tail = np.array(reading.tail_state[:2] if self._tail is None else self._tail)
        stick = np.array([operator.pitch_tail, operator.roll_tail])
        tail += np.clip(stick - tail, -self._max_travel, self._max_travel)
        self._tail = tail
        steering = clip(operator.steering, self._steer)
        pitch, roll = (np.array([angle, 0.0, kp, kd, 0.0]) for angle in tail)
        return PilotStep(CarCommand(steering, operator.throttle, pitch, roll), 0.0, 0)
