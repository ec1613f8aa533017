"""What drives the plant in one step, that is drive, servo, tail motors and air, in one calculation.

Between two steps of the plant the separate systems of a station (`Drive`, `SteeringServo`, `TailMotors`, `TailForce`)
are four calls from C++ into Python, each with its own ports to read. Here one system calls the same laws, with the
motion of the sail in closed form. The separate systems are the readable reference: a test holds both together.
"""

from typing import NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import Multiplexer, ZeroOrderHold

from aerodima.workbench.aero.laws import wind_direction
from aerodima.workbench.aero.sail_motion import generalised_force
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import TAIL_COMMAND
from aerodima.workbench.plants.car import CarPlant
from aerodima.workbench.stations.car_air import sail_strips
from aerodima.workbench.stations.compiled_step import drives_of
from aerodima.workbench.stations.step_drives import (
    AIR_ON_CHASSIS,
    AIR_ON_JOINTS,
    ANGLES,
    DRIVES_SIZE,
    JOINT_TORQUES,
    KNUCKLES,
    MOTION_SIZE,
    MOTOR_TORQUES,
    RATES,
    SHAFT,
    SHAFT_TORQUE,
    VELOCITY,
    TailNumbers,
    about_origin,
    car_numbers,
    sail_of,
    tail_numbers,
    wind_of,
)
from aerodima.workbench.systems.connections import constant, select, stacked, transformed
from aerodima.workbench.systems.port_values import vector_of

TAIL_JOINTS = ("tail_pitch", "tail_roll", "tail_sail_turn")
TAIL_COMMANDS = ("tail_pitch_command", "tail_roll_command")


class FusedStep(LeafSystem):
    """What drives the plant, from the commands and its state.

    Input ports:
        inputs (n): one vector, since each port that is read costs as much as a law: the parts of `input_sizes` in their
            order. motion: see `MOTION_SIZE`. throttle: -1..1. frame: of the `SteeringServo`. With a tail, last: 1 once
            the plant has stepped and 0 before, then motion and drives at its last step; tail commands: as for
            `TailMotors`; in wind, wind_velocity: v_WA in W, m/s.
    Output ports:
        drives (18): see `DRIVES_SIZE`.
        wind_direction (1): with a tail, of a sail that is one line of sections, as `TailForce.wind_direction`, rad.

    Args:
        scenario: of the car.
        p_BoSo_B: where the tail's joint axes cross, in the chassis frame (3), m; None without a tail.
        windy: whether the inputs have the velocity of the air.
    """

    def __init__(self, scenario: Scenario, p_BoSo_B: np.ndarray | None, windy: bool = False) -> None:
        super().__init__()
        self.set_name("fused_step")
        self._tail: TailNumbers | None = None
        self.input_sizes = {"motion": MOTION_SIZE, "throttle": 1, "frame": 3}
        if p_BoSo_B is not None:
            self.input_sizes["last"] = 1 + MOTION_SIZE + DRIVES_SIZE
            self.input_sizes |= dict.fromkeys(TAIL_COMMANDS, TAIL_COMMAND.size)
            self.input_sizes |= {"wind_velocity": 3} if windy else {}
        self._inputs = self.DeclareVectorInputPort("inputs", sum(self.input_sizes.values()))
        tickets = {self.time_ticket(), self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("drives", DRIVES_SIZE, self._calc, prerequisites_of_calc=tickets)
        if p_BoSo_B is not None:
            self._tail, self._other_lines = tail_numbers(scenario, p_BoSo_B.tolist(), windy)
            self._first_line, _ = sail_strips(scenario.tail)[0]
            inputs = {self.all_input_ports_ticket()}
            self.DeclareVectorOutputPort("wind_direction", 1, self._calc_wind_direction, prerequisites_of_calc=inputs)
        self._drives = drives_of(car_numbers(scenario), self._tail)

    def _calc(self, context: Context, output: BasicVector) -> None:
        inputs = vector_of(self._inputs, context)
        drives = self._drives(context.get_time(), inputs)
        if self._tail is not None and self._other_lines:
            drives[AIR_ON_CHASSIS:MOTOR_TORQUES] += self._other_force(inputs.tolist(), self._tail)
        output.SetFromVector(drives)

    def _other_force(self, inputs: list[float], tail: TailNumbers) -> FloatArray:
        """Of the lines whose law is no numbers, see `generalised_force`."""
        sail, wind, total = sail_of(inputs, tail.p_BoSo_B), wind_of(inputs, tail.windy), np.zeros(9)
        for layout, law in self._other_lines:
            a, n, u, k = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind)
            wrench = law.line_force(u, k, a, n, layout.distances, layout.areas, tail.density)
            total += generalised_force(sail, *about_origin(wrench, sail.R_WS, layout.p_BoRo_B))
        return total

    def _calc_wind_direction(self, context: Context, output: BasicVector) -> None:
        tail, layout = self._tail, self._first_line
        assert tail is not None
        inputs = vector_of(self._inputs, context).tolist()
        sail = sail_of(inputs, tail.p_BoSo_B)
        a, n, u, k = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind_of(inputs, tail.windy))
        output[0] = wind_direction(u, k, a, n, layout.distances, layout.areas)


class FusedPorts(NamedTuple):
    """A `FusedStep` as it is wired.

    Attributes:
        step: the system.
        commands: input ports by name, `throttle` and those of the tail, that are left to the caller.
        motion, last: ports that feed its inputs of that name.
    """

    step: FusedStep
    commands: dict[str, InputPort]
    motion: OutputPort
    last: OutputPort


def add_fused_step(
    builder: DiagramBuilder, scenario: Scenario, car: CarPlant, frame: OutputPort, wind: OutputPort | None
) -> FusedPorts:
    """Adds a `FusedStep` and wires it to the plant.

    Args:
        builder: that owns the plant.
        frame: port of the `SteeringServo`.
        wind: v_WA in W (3), m/s; still air without it.
    """
    plant, p_BoSo_B = car.plant, None
    if car.tail is not None:
        chassis, sail = (plant.GetFrameByName(name) for name in ("chassis", "tail_sail"))
        p_BoSo_B = plant.CalcRelativeTransform(plant.CreateDefaultContext(), chassis, sail).translation()
    step = FusedStep(scenario, p_BoSo_B, windy=wind is not None)
    builder.AddSystem(step)
    drives = step.GetOutputPort("drives")
    motion = transformed(builder, "motion", plant.get_state_output_port(), _motion_of_state(plant))
    this_step = stacked(builder, "this_step", [constant(builder, "has_stepped", [1.0]), motion, drives])
    last = builder.AddNamedSystem("last_step", ZeroOrderHold(scenario.simulation.step, this_step.size()))
    builder.Connect(this_step, last.get_input_port())
    sources = {"motion": motion, "frame": frame, "last": last.get_output_port(), "wind_velocity": wind}
    inputs = builder.AddNamedSystem("fused_step_inputs", Multiplexer([*step.input_sizes.values()]))
    builder.Connect(inputs.get_output_port(), step.get_input_port())
    ports = {name: inputs.get_input_port(index) for index, name in enumerate(step.input_sizes)}
    for name, source in sources.items():
        if source is not None and name in ports:
            builder.Connect(source, ports[name])
    for name, driven, place in _driven_ports(car):
        builder.Connect(transformed(builder, name, drives, place), driven)
    commands = {name: port for name, port in ports.items() if name not in sources}
    return FusedPorts(step, commands, motion, last.get_output_port())


def add_chassis_motion(builder: DiagramBuilder, ports: FusedPorts) -> OutputPort:
    """Motion of the chassis for its sensors, see `chassis_motion`."""
    both, last = stacked(builder, "motion_now_and_before", [ports.motion, ports.last]), MOTION_SIZE
    before = [last + 1 + index for index in range(VELOCITY, ANGLES)]
    return select(builder, "chassis_motion", both, [*range(ANGLES), *before, last])


def _motion_of_state(plant: MultibodyPlant) -> np.ndarray:
    """Matrix (20, n) from the plant's state to `motion`."""
    chassis, nq = plant.GetBodyByName("chassis"), plant.num_positions()
    q, v = chassis.floating_positions_start(), nq + chassis.floating_velocities_start_in_v()
    place = np.zeros((MOTION_SIZE, plant.num_multibody_states()))
    place[range(13), [*range(q, q + 7), *range(v, v + 6)]] = 1.0
    for index, joint in enumerate(_tail_joints(plant)):
        place[ANGLES + index, joint.position_start()] = 1.0
        place[RATES + index, nq + joint.velocity_start()] = 1.0
    place[SHAFT, nq + plant.GetJointByName("drive_shaft_spin").velocity_start()] = 1.0
    return place


def _tail_joints(plant: MultibodyPlant) -> list[Joint]:
    """Pitch, roll and, of a free sail, its own joint; none without a tail."""
    joints = [plant.GetJointByName(name) for name in TAIL_JOINTS if plant.HasJointNamed(name)]
    return [joint for joint in joints if joint.num_velocities() > 0]


def _driven_ports(car: CarPlant) -> list[tuple[str, InputPort, np.ndarray]]:
    """Input ports of the plant, each with a name and the matrix from the drives to it."""
    plant, names = car.plant, car.actuated_joints
    count, steered = len(names), [names.index(f"front_{side}_steering") for side in ("left", "right")]
    torques, knuckles = np.zeros((plant.num_actuators(), DRIVES_SIZE)), np.zeros((2 * count, DRIVES_SIZE))
    torques[_actuation_start(plant, "drive_shaft_spin"), SHAFT_TORQUE] = 1.0
    knuckles[[*steered, *(count + index for index in steered)], range(KNUCKLES, JOINT_TORQUES)] = 1.0
    ports = [
        ("actuation", plant.get_actuation_input_port(), torques),
        ("desired_steering", plant.get_desired_state_input_port(car.car), knuckles),
    ]
    if car.tail is None:
        return ports
    motors = [_actuation_start(plant, name) for name in TAIL_JOINTS[:2]]
    torques[motors, range(JOINT_TORQUES, AIR_ON_CHASSIS)] = 1.0
    air = np.zeros((plant.num_velocities(), DRIVES_SIZE))
    v = plant.GetBodyByName("chassis").floating_velocities_start_in_v()
    air[range(v, v + 6), range(AIR_ON_CHASSIS, AIR_ON_JOINTS)] = 1.0
    for index, joint in enumerate(_tail_joints(plant)):
        air[joint.velocity_start(), AIR_ON_JOINTS + index] = 1.0
    return [*ports, ("air_force", plant.get_applied_generalized_force_input_port(), air)]


def _actuation_start(plant: MultibodyPlant, joint: str) -> int:
    """Where the actuation of all actuators has that of a joint."""
    actuators = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    return next(int(actuator.input_start()) for actuator in actuators if actuator.joint().name() == joint)
