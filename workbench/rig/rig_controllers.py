"""Controllers of a rig that rests at the start angle and swings (thesis sections 4.4, 4.7, 6.3)."""

from pydrake.systems.framework import (
    Context,
    DiscreteValues,
    LeafSystem,
)

from aerodima.workbench.core.port_wiring import DiscreteVector, vector_of
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.signal_table import TAIL_COMMAND


class CurrentController(LeafSystem):
    """Current of the Maxon motor: holds the start angle, then drives the tail to the target or lets
    it go.

    current = hold + kp (angle - goal) + kd rate, since a positive current pushes upstream. `hold`
    is the current that holds the goal in the wind, so that the tail stays at rest there. The motor
    limits the current.

    Input ports:
        rig_state (2): angle, rad, and rate, rad/s, as the encoder reports them.
    Output ports:
        current_command (1): commanded current, A, held between samples.

    Args:
        scenario: scenario with goal, gains and times.
        hold_start: current that holds the start angle, A.
        hold_target: current that holds the target, A.
    """

    def __init__(self, scenario: RigScenario, hold_start: float, hold_target: float):
        super().__init__()
        self.set_name("current_controller")
        self._experiment = scenario.experiment
        self._hold_start = hold_start
        self._hold_target = hold_target
        self._state = self.DeclareVectorInputPort("rig_state", 2)
        self._current = DiscreteVector(self, [hold_start], output="current_command")
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / scenario.encoder.rate, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        experiment = self._experiment
        goal = experiment.target
        hold = self._hold_target
        resting = context.get_time() < experiment.rest - 1e-9
        if resting:
            goal = experiment.angle
            hold = self._hold_start
        current = 0.0
        if resting or experiment.actuated:
            angle, rate = vector_of(self._state, context)
            current = hold + experiment.kp * (angle - goal) + experiment.kd * rate
        self._current.write(values, [current])


class TailCommander(LeafSystem):
    """Commands of the robot-tail rig: hold the start angle, then position control to the target
    with the test's gains.

    Output ports:
        tail_command (5): position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m.

    Args:
        scenario: scenario with angles, gains and times.
        hold_torque: torque that holds the start angle, N m; fed forward during the rest only.
    """

    def __init__(self, scenario: RigScenario, hold_torque: float):
        super().__init__()
        self.set_name("tail_commander")
        experiment = scenario.experiment
        robot = scenario.robot
        motor = scenario.robot_motor
        self._rest = experiment.rest
        self._held = TAIL_COMMAND.write(
            position=experiment.angle,
            velocity=0.0,
            kp=motor.kp_max / 10.0,
            kd=motor.kd_max,
            torque=hold_torque,
        )
        self._swung = TAIL_COMMAND.write(
            position=experiment.target, velocity=0.0, kp=robot.kp, kd=robot.kd, torque=0.0
        )
        self._command = DiscreteVector(self, self._held, output="tail_command")
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / robot.command_rate, 0.0, self._update)

    def _update(self, context: Context, values: DiscreteValues) -> None:
        self._command.write(
            values, self._held if context.get_time() < self._rest - 1e-9 else self._swung
        )
