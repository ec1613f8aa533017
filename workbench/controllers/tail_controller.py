"""The tail controller as a Drake system: samples the station's signals at its rate and runs a law on them."""

import math
from typing import Any, Protocol

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, System

from workbench.controllers.checks import check_range
from workbench.controllers.swing_law import Observation, SwingLaw, SwingSettings
from workbench.discrete_vector import DiscreteVector
from workbench.ports import IMU, PLANNED_TURN, STATUS, TAIL_COMMAND, TAIL_STATE


class TailLaw(Protocol):
    """A control law for the tail, free of Drake: the thesis' swing, or a player of optimised swings."""

    @property
    def rate(self) -> float:
        """Controller rate, Hz."""

    @property
    def memory_size(self) -> int:
        """Number of floats that the law carries from tick to tick."""

    def start(self) -> np.ndarray:
        """Memory (memory_size,) before the first tick."""

    def step(self, memory: np.ndarray, observation: Observation) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """One tick: new memory, pitch command (5), roll command (5), state number. Must not change its arguments."""


class TailController(LeafSystem):
    """Runs a tail law at a fixed rate on what the station reports; commands are held between ticks.

    A signal that is older than `age_limit`, or whose fault code is not zero, reaches the law as unknown: the IMU as
    "not valid", a tail angle as NaN. All memory is discrete state, so a reset context repeats a run.

    Input ports:
        tail_state (6), imu (9), status (13): as the station gives them, see `workbench.ports`.
        planned_turn (1): +1 left, -1 right, 0 none, from the driver.
    Output ports:
        tail_pitch_command (5), tail_roll_command (5): `ports.TAIL_COMMAND`, in rad, rad/s, N m/rad,
            N m s/rad, N m.
        state (1): number of the law's state.

    Args:
        law: a `TailLaw`; `SwingLaw(SwingSettings.from_scenario(scenario))` is the thesis' one.
        age_limit: s; beyond this a signal counts as silent.

    Raises:
        UserError: rate or age limit out of range.
    """

    def __init__(self, law: TailLaw, age_limit: float = 0.1) -> None:
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
        self._memory = DiscreteVector(self, law.start())
        self._pitch_command = DiscreteVector(self, np.zeros(TAIL_COMMAND.size), output="tail_pitch_command")
        self._roll_command = DiscreteVector(self, np.zeros(TAIL_COMMAND.size), output="tail_roll_command")
        self._state = DiscreteVector(self, [0.0], output="state")
        self.DeclarePeriodicDiscreteUpdateEvent(period_sec=1.0 / law.rate, offset_sec=0.0, update=self._tick)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, scenario: Any, *, station: System, driver: System
    ) -> "TailController":
        """Adds the thesis' controller of a scenario between the ports of a station and of a driver."""
        controller = cls(SwingLaw(SwingSettings.from_scenario(scenario)))
        builder.AddSystem(controller)
        for port in ("tail_state", "imu", "status"):
            builder.Connect(station.GetOutputPort(port), controller.GetInputPort(port))
        builder.Connect(driver.GetOutputPort("planned_turn"), controller.GetInputPort("planned_turn"))
        for port in ("tail_pitch_command", "tail_roll_command"):
            builder.Connect(controller.GetOutputPort(port), station.GetInputPort(port))
        return controller

    def observe(self, context: Context) -> Observation:
        """What the law is given at this instant."""
        tail: Any = self._tail_state.Eval(context)
        imu: Any = self._imu.Eval(context)
        status: Any = self._status.Eval(context)
        planned_turn: Any = self._planned_turn.Eval(context)
        return Observation(
            time=context.get_time(),
            yaw_rate=float(imu[GYRO_Z]),
            roll_angle=float(tail[ROLL_ANGLE]) if self._fresh(status, ROLL_AGE) else math.nan,
            pitch_angle=float(tail[PITCH_ANGLE]) if self._fresh(status, PITCH_AGE) else math.nan,
            planned_turn=float(planned_turn[0]),
            imu_valid=self._fresh(status, IMU_AGE),
        )

    def _fresh(self, status: np.ndarray, age_index: int) -> bool:
        """False for NaN too; the fault code stands right behind the age."""
        return bool(status[age_index] <= self._age_limit and status[age_index + 1] == 0.0)

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        memory, pitch_command, roll_command, state = self._law.step(self._memory.read(context), self.observe(context))
        self._memory.write(discrete_state, memory)
        self._pitch_command.write(discrete_state, pitch_command)
        self._roll_command.write(discrete_state, roll_command)
        self._state.write(discrete_state, [float(state)])


GYRO_Z = IMU.index("gyro_z")
ROLL_ANGLE, PITCH_ANGLE = TAIL_STATE.index("roll_angle"), TAIL_STATE.index("pitch_angle")
ROLL_AGE, PITCH_AGE, IMU_AGE = (STATUS.index(f"{source}_age") for source in ("tail_roll", "tail_pitch", "imu"))
