"""The rig behind its ports: simulated plant with motor and sensors, or the interface to the real rig.

Both export the same ports (design section 9). The robot-tail rig has its AK70-10 on the bus and can be swapped for
hardware; the cheetah rig takes a current and exists in simulation only. The simulated station adds ports whose names
end in `_truth`.
"""

from collections.abc import Callable, Mapping

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain, Multiplexer

from aerodima.workbench.actuators.maxon import MaxonMotor, current_noise
from aerodima.workbench.actuators.mit_motor import MitMotor
from aerodima.workbench.config.ports import PortFields
from aerodima.workbench.config.rig_ports import RIG_OUTPUTS, RIG_STATUS, ROBOT_RIG_INPUTS
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.rig import RigPlant, add_rig_plant
from aerodima.workbench.sensors.encoder import MotorEncoder, MotorReply
from aerodima.workbench.sensors.force_torque import ForceTorqueSensor
from aerodima.workbench.sensors.motor_current import MotorCurrentSensor
from aerodima.workbench.sensors.rig_encoder import RigEncoder
from aerodima.workbench.stations.rig_logs import sensor_offsets
from aerodima.workbench.systems.noise import CounterNoise

RigInterfaceFactory = Callable[[RigScenario], System]
"""Makes the system that talks to the real rig, with exactly the ports of `ROBOT_RIG_INPUTS` and `RIG_OUTPUTS`."""


def make_rig_station(
    scenario: RigScenario, interface: RigInterfaceFactory | None = None, meshcat: Meshcat | None = None
) -> Diagram:
    """The station of a rig scenario as a diagram.

    Ports: in `tail_command` (5) of the robot-tail rig or `current_command` (1) of the cheetah rig; out `rig_state` (2),
    `motor_current` (1), `force_torque` (6), `status` (7), and in simulation `state_truth` (2), `wrench_truth` (6),
    `motor_torque_truth` (1), and with a tail `tail_sections_truth` (4 per section).

    Args:
        scenario: what to simulate, or what to drive.
        interface: None simulates; a factory (from `hardware`) talks to the robot-tail rig.
        meshcat: shows the simulated rig live.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface has other ports than the station must have, or is for a rig that has no hardware.
    """
    builder = DiagramBuilder()
    if interface is None:
        _simulate(builder, scenario, meshcat)
    elif not scenario.is_robot:
        raise UserError(
            f"experiment.kind: {scenario.experiment.kind!r} has no hardware interface; allowed with one: 'robot_swing'"
        )
    else:
        export_interface(builder, interface(scenario), ROBOT_RIG_INPUTS, RIG_OUTPUTS)
    station = builder.Build()
    station.set_name("rig_station")
    return station


def export_interface(
    builder: DiagramBuilder, system: System, inputs: Mapping[str, PortFields], outputs: Mapping[str, PortFields]
) -> None:
    """Adds a hardware interface and exports its ports; UserError unless names and sizes are those of the contract."""
    found = {
        "inputs": {
            system.get_input_port(i).get_name(): system.get_input_port(i).size()
            for i in range(system.num_input_ports())
        },
        "outputs": {
            system.get_output_port(i).get_name(): system.get_output_port(i).size()
            for i in range(system.num_output_ports())
        },
    }
    for kind, fields in (("inputs", inputs), ("outputs", outputs)):
        expected = {name: port.size for name, port in fields.items()}
        if found[kind] != expected:
            raise UserError(f"interface {system.get_name()!r}: {kind} {found[kind]}; allowed: {expected}")
    builder.AddSystem(system)
    for name in inputs:
        builder.ExportInput(system.GetInputPort(name), name)
    for name in outputs:
        builder.ExportOutput(system.GetOutputPort(name), name)


def _simulate(builder: DiagramBuilder, scenario: RigScenario, meshcat: Meshcat | None) -> None:
    rig = add_rig_plant(builder, scenario, scene_graph=meshcat is not None)
    state = rig.plant.get_state_output_port()
    motor = _add_motor(builder, scenario, state)
    builder.Connect(motor.GetOutputPort("torque"), rig.torques.get_input_port(0))
    reported, age = _add_encoder(builder, scenario, state)
    step = scenario.simulation.step
    current = MotorCurrentSensor.add_to_builder(
        builder,
        scenario.robot.command_rate if scenario.is_robot else scenario.encoder.rate,
        0.0 if scenario.is_robot else scenario.maxon.current_noise,
        _current_noise(scenario),
        current=motor.GetOutputPort("current"),
        step=step,
    )
    force = ForceTorqueSensor.add_to_builder(
        builder,
        scenario.force_sensor,
        wrench=rig.wrench,
        offsets=sensor_offsets(scenario),
        seed=scenario.seed,
        step=step,
    )
    builder.ExportOutput(reported, "rig_state")
    builder.ExportOutput(current.GetOutputPort("reading"), "motor_current")
    builder.ExportOutput(force.GetOutputPort("reading"), "force_torque")
    builder.ExportOutput(_status(builder, age, force.GetOutputPort("age")), "status")
    _export_truth(builder, rig, motor)
    if meshcat is not None:
        assert rig.scene_graph is not None
        MeshcatVisualizer.AddToBuilder(builder, rig.scene_graph, meshcat)


def _current_noise(scenario: RigScenario) -> CounterNoise:
    return current_noise(scenario.maxon, scenario.seed)


def _add_motor(builder: DiagramBuilder, scenario: RigScenario, state: OutputPort) -> System:
    if not scenario.is_robot:
        maxon = builder.AddNamedSystem("maxon", MaxonMotor(scenario.maxon))
        builder.ExportInput(maxon.GetInputPort("current_command"), "current_command")
        return maxon
    motor = builder.AddNamedSystem("ak70", MitMotor(scenario.robot_motor, scenario.robot.torque_constant))
    builder.Connect(state, motor.GetInputPort("joint_state"))
    builder.ExportInput(motor.GetInputPort("tail_command"), "tail_command")
    return motor


def _add_encoder(builder: DiagramBuilder, scenario: RigScenario, state: OutputPort) -> tuple[OutputPort, OutputPort]:
    """Reported angle and rate (2), and the age of that sample (1)."""
    if not scenario.is_robot:
        encoder = RigEncoder.add_to_builder(builder, scenario, plant_state=state)
        both = builder.AddNamedSystem("rig_state", Multiplexer([1, 1]))
        for index, name in enumerate(("angle", "rate")):
            builder.Connect(encoder.GetOutputPort(name), both.get_input_port(index))
        return both.get_output_port(), encoder.GetOutputPort("age")
    reply = MotorReply(scenario.robot_motor.position_range, scenario.robot_motor.speed_range)
    replies = MotorEncoder(
        scenario.robot.command_rate, indices=(0, 0, 1, 1), state_size=2, reply=reply, step=scenario.simulation.step
    )
    builder.AddSystem(replies)
    builder.Connect(state, replies.GetInputPort("plant_state"))
    both = builder.AddNamedSystem("rig_state", Multiplexer([1, 1]))
    for index, name in enumerate(("angles", "rates")):
        one = builder.AddNamedSystem(f"one_of_{name}", MatrixGain(np.array([[1.0, 0.0]])))
        builder.Connect(replies.GetOutputPort(name), one.get_input_port())
        builder.Connect(one.get_output_port(), both.get_input_port(index))
    return both.get_output_port(), replies.GetOutputPort("age")


def _status(builder: DiagramBuilder, motor_age: OutputPort, force_age: OutputPort) -> OutputPort:
    """A simulated rig is armed, healthy, and its operator is always there."""

    def constant(name: str, value: float) -> OutputPort:
        return builder.AddNamedSystem(name, ConstantVectorSource(np.array([value]))).get_output_port()

    healthy = constant("no_fault", 0.0)
    sources = {"motor_age": motor_age, "force_age": force_age, "armed": constant("armed", 1.0)}
    parts = builder.AddNamedSystem("status", Multiplexer([1] * RIG_STATUS.size))
    for index, name in enumerate(RIG_STATUS.fields):
        builder.Connect(sources.get(name, healthy), parts.get_input_port(index))
    return parts.get_output_port()


def _export_truth(builder: DiagramBuilder, rig: RigPlant, motor: System) -> None:
    builder.ExportOutput(rig.plant.get_state_output_port(), "state_truth")
    builder.ExportOutput(rig.wrench, "wrench_truth")
    builder.ExportOutput(motor.GetOutputPort("torque"), "motor_torque_truth")
    if rig.tail_force is not None:
        builder.ExportOutput(rig.tail_force.GetOutputPort("sections"), "tail_sections_truth")
