"""Who drives, as plain Python: the sequence of a scenario with its tail law, or the operator by radio. No Drake."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from aerodima.hardware.car.wiring import CarCommand, CarReading
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.law_of_scenario import law_of_scenario
from aerodima.workbench.controllers.manoeuvre import DriverInput, make_schedule
from aerodima.workbench.controllers.tail_law import TailLaw, observe


class PilotStep(NamedTuple):
    """One tick of a pilot: the command, the announced turn (+1 left, -1 right, 0 none), the number of the state."""

    command: CarCommand
    planned_turn: float
    state: int


class Pilot(Protocol):
    """Whoever drives the car in the plain loop."""

    def start(self) -> PilotStep:
        """What stands on the outputs before the first tick."""
        ...

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """One tick, `time` s after the start of the run."""
        ...


class AutoPilot:
    """The schedule of a scenario and its tail law, tick for tick as `TurnDriver` and `TailController` run them.

    The law sees the turn that was announced one tick before, as the discrete systems of the diagram do.
    """

    def __init__(self, scenario: Scenario, law: TailLaw | None = None) -> None:
        self._schedule = make_schedule(scenario)
        self._law = law or law_of_scenario(scenario)
        self._memory = self._law.start()
        self._driver = self._schedule.at(0.0)

    def start(self) -> PilotStep:
        """See `Pilot`."""
        return self._step_of(self._driver, np.zeros(5), np.zeros(5), 0)

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """See `Pilot`."""
        observation = observe(
            time,
            reading.tail_state,
            reading.imu,
            reading.status,
            self._driver.planned_turn,
            reading.speed,
            steering_angle=self._driver.steering_angle,
        )
        self._memory, pitch, roll, state = self._law.step(self._memory, observation)
        self._driver = self._schedule.at(time)
        return self._step_of(self._driver, pitch, roll, state)

    def _step_of(self, driver: DriverInput, pitch: np.ndarray, roll: np.ndarray, state: int) -> PilotStep:
        return PilotStep(CarCommand(driver.steering_angle, driver.throttle, pitch, roll), driver.planned_turn, state)


class ControlPilot:
    """The operator's steering and throttle, and the tail by its law: the turn that is steered counts as announced."""

    def __init__(self, scenario: Scenario, law: TailLaw | None = None) -> None:
        self._law = law or law_of_scenario(scenario)
        self._memory = self._law.start()
        self._steer = scenario.servo.limit
        self._steering = 0.0

    def start(self) -> PilotStep:
        """See `Pilot`."""
        return PilotStep(CarCommand(), 0.0, 0)

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """See `Pilot`."""
        asked = reading.operator
        plan = float(np.sign(self._steering))
        observation = observe(
            time,
            reading.tail_state,
            reading.imu,
            reading.status,
            plan,
            reading.speed,
            steering_angle=self._steering,
        )
        self._memory, pitch, roll, state = self._law.step(self._memory, observation)
        self._steering = min(self._steer, max(-self._steer, asked.steering))
        return PilotStep(CarCommand(self._steering, asked.throttle, pitch, roll), plan, state)


class ManualPilot:
    """The operator's sticks: steering, throttle, and two tail angles that are held with the gains of the scenario.

    The tail follows its stick from where it is, with `ramp_speed` of the motors' safety at most: a stick that jumps
    does not swing it.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._gains = (scenario.controller.hold_kp, scenario.controller.hold_kd)
        self._steer = scenario.servo.limit
        self._tail: np.ndarray | None = None
        self._most = load_motor_safety().ramp_speed / scenario.controller.rate

    def start(self) -> PilotStep:
        """See `Pilot`."""
        return PilotStep(CarCommand(), 0.0, 0)

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """See `Pilot`."""
        del time
        asked, (kp, kd) = reading.operator, self._gains
        tail = np.array(reading.tail_state[:2] if self._tail is None else self._tail)
        tail += np.clip(np.array([asked.pitch_tail, asked.roll_tail]) - tail, -self._most, self._most)
        self._tail = tail
        command = CarCommand(
            min(self._steer, max(-self._steer, asked.steering)),
            asked.throttle,
            np.array([tail[0], 0.0, kp, kd, 0.0]),
            np.array([tail[1], 0.0, kp, kd, 0.0]),
        )
        return PilotStep(command, 0.0, 0)
