"""What drives a station, as Drake systems: tail controller and driver of the car, the experiments of the rig.

The tail controller samples the station's signals at its rate and runs a law on them; the driver plays the schedule of a
manoeuvre. A rig rests at the start angle and swings (thesis sections 4.4, 4.7, 6.3).
"""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, System

from aerodima.workbench.config.checked_files import check_range
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.config.signal_table import (
    IMU,
    PLANNED_TURN,
    SPEED,
    STATUS,
    STEERING_ANGLE,
    TAIL_COMMAND,
    TAIL_STATE,
)
from aerodima.workbench.controllers.law_of_scenario import law_of_scenario
from aerodima.workbench.controllers.manoeuvre import DriverInput, Schedule
from aerodima.workbench.controllers.tail_law import AGE_LIMIT, Observation, TailLaw, observe
from aerodima.workbench.systems.system_ports import (
    DiscreteVector,
    Stage,
    connected,
    declare_ticks,
    nominal_time,
    stage_before,
    vector_of,
)


class TailController(LeafSystem):
    """Runs a tail law at a fixed rate on what the station reports; commands are held between ticks.

    A signal that is older than `age_limit`, or whose fault code is not zero, reaches the law as unknown: the IMU as
    "not valid", a tail angle as NaN. All memory is discrete state, so a reset context repeats a run.

    Input ports:
        tail_state (6), imu (9), status (13): as the station gives them, see `aerodima.workbench.config.signal_table`.
        planned_turn (1): +1 left, -1 right, 0 none, from the driver.
        speed (1, optional): m/s, from the station; unknown when not connected.
        steering_angle (1, optional): command of the driver, rad; unknown when not connected.
    Output ports:
        tail_pitch_command (5), tail_roll_command (5): `signal_table.TAIL_COMMAND`, in rad, rad/s, N m/rad,
            N m s/rad, N m.
        state (1): number of the law's state.

    Args:
        law: a `TailLaw`; `law_of_scenario(scenario)` is the one that a scenario names.
        age_limit: s; beyond this a signal counts as silent.
        stage: of its ticks, where it drives a simulated car (`aerodima.workbench.systems.system_ports`).
        idle: never ticks, and gives no command: for a car without tail, on which ticks cost and nothing hears them.

    Raises:
        UserError: rate or age limit out of range.
    """

    def __init__(
        self, law: TailLaw, age_limit: float = AGE_LIMIT, stage: Stage | None = None, idle: bool = False
    ) -> None:
        super().__init__()
        check_range("controller.rate", law.rate, 0.0, math.inf, "Hz", above_low=True)
        check_range("controller.age_limit", age_limit, 0.0, math.inf, "s", above_low=True)
        self.set_name("tail_controller")
        self._law = law
        self._age_limit = age_limit
        self._tail_state = self.DeclareVectorInputPort("tail_state", TAIL_STATE.size)
        self._imu = self.DeclareVectorInputPort("imu", IMU.size)
        self._status = self.DeclareVectorInputPort("status", STATUS.size)
        self._planned_turn = self.DeclareVectorInputPort("planned_turn", PLANNED_TURN.size)
        self._speed = self.DeclareVectorInputPort("speed", SPEED.size)
        self._steering = self.DeclareVectorInputPort("steering_angle", STEERING_ANGLE.size)
        self._memory = DiscreteVector(self, law.start())
        self._pitch_command = DiscreteVector(self, np.zeros(TAIL_COMMAND.size), output="tail_pitch_command")
        self._roll_command = DiscreteVector(self, np.zeros(TAIL_COMMAND.size), output="tail_roll_command")
        self._state = DiscreteVector(self, [0.0], output="state")
        if not idle:
            declare_ticks(self, law.rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        scenario: Any,
        *,
        station: System,
        driver: System,
        law: TailLaw | None = None,
        idle: bool = False,
    ) -> "TailController":
        """Adds a law, by default that of the scenario, between the ports of a station and of a driver."""
        stage = stage_before(station, Stage.CONTROLLER)
        inputs = {port: station.GetOutputPort(port) for port in ("tail_state", "imu", "status", "speed")}
        inputs |= {port: driver.GetOutputPort(port) for port in ("planned_turn", "steering_angle")}
        law = law or law_of_scenario(scenario)
        controller = connected(builder, cls(law, stage=stage, idle=idle), **inputs)
        for port in ("tail_pitch_command", "tail_roll_command"):
            builder.Connect(controller.GetOutputPort(port), station.GetInputPort(port))
        return controller

    def observe(self, context: Context) -> Observation:
        """What the law is given at this instant."""
        tail = vector_of(self._tail_state, context)
        imu = vector_of(self._imu, context)
        status = vector_of(self._status, context)
        planned_turn = vector_of(self._planned_turn, context)
        speed = vector_of(self._speed, context) if self._speed.HasValue(context) else None
        steering = vector_of(self._steering, context) if self._steering.HasValue(context) else (math.nan,)
        return observe(
            nominal_time(context.get_time(), self._law.rate),
            tail,
            imu,
            status,
            float(planned_turn[0]),
            speed,
            self._age_limit,
            steering_angle=float(steering[0]),
        )

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        memory, pitch_command, roll_command, state = self._law.step(self._memory.read(context), self.observe(context))
        self._memory.write(discrete_state, memory)
        self._pitch_command.write(discrete_state, pitch_command)
        self._roll_command.write(discrete_state, roll_command)
        self._state.write(discrete_state, [float(state)])


class TurnDriver(LeafSystem):
    """Steering, throttle and announced turn of a schedule, sampled at a fixed rate and held in between.

    Drives every manoeuvre of `aerodima.workbench.controllers.manoeuvre`: the simulated turn, the car's AUTO sequence,
    straight line and slalom. Open loop: it looks at nothing but the time.

    Output ports:
        steering_angle (1): rad, positive to the left.
        throttle (1): -1 to 1.
        planned_turn (1): +1 left, -1 right, 0 none.

    Args:
        schedule: from `make_schedule(scenario)`.
        rate: Hz.
        stage: of its ticks, where it drives a simulated car (`aerodima.workbench.systems.system_ports`).

    Raises:
        UserError: rate out of range.
    """

    def __init__(self, schedule: Schedule, rate: float = 100.0, stage: Stage | None = None) -> None:
        super().__init__()
        check_range("controller.rate", rate, 0.0, math.inf, "Hz", above_low=True)
        self.set_name("driver")
        self._schedule, self._rate = schedule, rate
        self._outputs = [
            DiscreteVector(self, [value], output=name)
            for name, value in zip(DriverInput._fields, schedule.at(0.0), strict=True)
        ]
        declare_ticks(self, rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        schedule: Schedule,
        rate: float = 100.0,
        *,
        station: System,
        controller_rate: float | None = None,
    ) -> "TurnDriver":
        """Adds a driver and connects steering and throttle to the station.

        Beside a tail controller of the same rate, Hz, it ticks at the controller's instant: that sees the driver as it
        was before, and one instant is cheaper than two.
        """
        driver = cls(
            schedule, rate, stage_before(station, Stage.CONTROLLER if controller_rate == rate else Stage.DRIVER)
        )
        builder.AddSystem(driver)
        for port in ("steering_angle", "throttle"):
            builder.Connect(driver.GetOutputPort(port), station.GetInputPort(port))
        return driver

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        inputs = self._schedule.at(nominal_time(context.get_time(), self._rate))
        for output, value in zip(self._outputs, inputs, strict=True):
            output.write(discrete_state, [value])


class CurrentController(LeafSystem):
    """Current of the Maxon motor: holds the start angle, then drives the tail to the target or lets it go.

    current = hold + kp (angle - goal) + kd rate, since a positive current pushes upstream. `hold` is the current that
    holds the goal in the wind, so that the rest is a rest.

    Input ports:
        rig_state (2): angle rad, rate rad/s, as the encoder reports them.
    Output ports:
        current_command (1): A, held between samples.

    Args:
        scenario: goal, gains, times.
        hold_start: current that holds the start angle, A.
        hold_target: current that holds the target, A.
    """

    def __init__(self, scenario: RigScenario, hold_start: float, hold_target: float):
        super().__init__()
        self.set_name("current_controller")
        self._experiment, self._limit = scenario.experiment, scenario.maxon.current_limit
        self._hold_start, self._hold_target = hold_start, hold_target
        self._state = self.DeclareVectorInputPort("rig_state", 2)
        self._current = DiscreteVector(self, [hold_start], output="current_command")
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / scenario.encoder.rate, 0.0, self._update)

    def current(self, time: float, angle: float, rate: float) -> float:
        """Commanded current (A) at a time (s), angle (rad) and rate (rad/s)."""
        experiment = self._experiment
        resting = time < experiment.rest - 1e-9
        if not resting and not experiment.actuated:
            return 0.0
        goal, hold = (experiment.angle, self._hold_start) if resting else (experiment.target, self._hold_target)
        current = hold + experiment.kp * (angle - goal) + experiment.kd * rate
        return min(max(current, -self._limit), self._limit)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        state = vector_of(self._state, context)
        self._current.write(values, [self.current(context.get_time(), float(state[0]), float(state[1]))])


class TailCommander(LeafSystem):
    """Commands of the robot-tail rig: hold the start angle, then position control to the target with the test's gains.

    Output ports:
        tail_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m.

    Args:
        scenario: angles, gains, times.
        hold_torque: torque that holds the start angle, N m; fed forward during the rest only.
    """

    def __init__(self, scenario: RigScenario, hold_torque: float):
        super().__init__()
        self.set_name("tail_commander")
        experiment, robot, motor = scenario.experiment, scenario.robot, scenario.robot_motor
        self._rest = experiment.rest
        self._held = TAIL_COMMAND.write(
            position=experiment.angle, velocity=0.0, kp=motor.kp_max / 10.0, kd=motor.kd_max, torque=hold_torque
        )
        self._swung = TAIL_COMMAND.write(position=experiment.target, velocity=0.0, kp=robot.kp, kd=robot.kd, torque=0.0)
        self._command = DiscreteVector(self, self._held, output="tail_command")
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / robot.command_rate, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        self._command.write(values, self._held if context.get_time() < self._rest - 1e-9 else self._swung)
