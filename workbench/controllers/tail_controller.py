"""The tail controller as a Drake system: samples the station's signals at its rate and runs a law on them."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, System

from aerodima.workbench.config.range_check import check_range
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
from aerodima.workbench.controllers.observation import AGE_LIMIT, observe
from aerodima.workbench.controllers.tail_law import Observation, TailLaw
from aerodima.workbench.systems.discrete_vector import DiscreteVector
from aerodima.workbench.systems.event_order import Stage, declare_ticks, nominal_time, stage_before


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
        tail_pitch_command (5), tail_roll_command (5): `ports.TAIL_COMMAND`, in rad, rad/s, N m/rad,
            N m s/rad, N m.
        state (1): number of the law's state.

    Args:
        law: a `TailLaw`; `law_of_scenario(scenario)` is the one that a scenario names.
        age_limit: s; beyond this a signal counts as silent.
        stage: of its ticks, where it drives a simulated car (`aerodima.workbench.systems.event_order`).

    Raises:
        UserError: rate or age limit out of range.
    """

    def __init__(self, law: TailLaw, age_limit: float = AGE_LIMIT, stage: Stage | None = None) -> None:
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
        declare_ticks(self, law.rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, scenario: Any, *, station: System, driver: System, law: TailLaw | None = None
    ) -> "TailController":
        """Adds a law, by default that of the scenario, between the ports of a station and of a driver."""
        stage = stage_before(station, Stage.CONTROLLER)
        controller = cls(law or law_of_scenario(scenario), stage=stage)
        builder.AddSystem(controller)
        for port in ("tail_state", "imu", "status", "speed"):
            builder.Connect(station.GetOutputPort(port), controller.GetInputPort(port))
        for port in ("planned_turn", "steering_angle"):
            builder.Connect(driver.GetOutputPort(port), controller.GetInputPort(port))
        for port in ("tail_pitch_command", "tail_roll_command"):
            builder.Connect(controller.GetOutputPort(port), station.GetInputPort(port))
        return controller

    def observe(self, context: Context) -> Observation:
        """What the law is given at this instant."""
        tail: Any = self._tail_state.Eval(context)
        imu: Any = self._imu.Eval(context)
        status: Any = self._status.Eval(context)
        planned_turn: Any = self._planned_turn.Eval(context)
        speed: Any = self._speed.Eval(context) if self._speed.HasValue(context) else None
        steering: Any = self._steering.Eval(context) if self._steering.HasValue(context) else (math.nan,)
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
