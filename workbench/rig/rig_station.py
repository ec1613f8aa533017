"""The simulated rig behind its ports: plant with motor and sensors (design section 9).

The robot-tail rig takes a command for its AK70-10, the cheetah rig a current. The names of ports
that no real rig could have end in `_truth`.
"""

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    OutputPort,
    System,
)

from aerodima.workbench.car.ak70 import MitMotor
from aerodima.workbench.car.car_sensors import MotorEncoder
from aerodima.workbench.core.port_contract import add_status, export_outputs
from aerodima.workbench.core.port_wiring import PortSlice, add_and_connect, concatenate
from aerodima.workbench.rig.maxon_motor import MaxonMotor
from aerodima.workbench.rig.rig_plant import add_rig_plant
from aerodima.workbench.rig.rig_sensors import (
    RigEncoder,
    RigSensor,
    current_errors,
    force_errors,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.signal_table import RIG_STATUS


def make_rig_station(scenario: RigScenario, meshcat: Meshcat | None = None) -> Diagram:
    """Makes the station of a rig scenario as a diagram.

    Ports: in `tail_command` (5) of the robot-tail rig or `current_command` (1) of the cheetah rig;
    out `rig_state` (2), `motor_current` (1), `force_torque` (6), `status` (7), and
    `state_truth` (2), `wrench_truth` (6), `motor_torque_truth` (1), and with a tail
    `tail_sections_truth` (4 per section).

    Args:
        scenario: scenario to simulate.
        meshcat: Meshcat that shows the rig live.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
    """
    builder = DiagramBuilder()
    rig = add_rig_plant(builder, scenario)
    state = rig.plant.get_state_output_port()
    drive = _add_ak70 if scenario.is_robot else _add_maxon
    motor, rig_state, motor_sample = drive(builder, scenario, state)
    torque = motor.GetOutputPort("torque")
    builder.Connect(torque, rig.motor_torque)

    rate = scenario.robot.command_rate if scenario.is_robot else scenario.encoder.rate
    noise = 0.0 if scenario.is_robot else scenario.maxon.current_noise
    current = RigSensor("motor_current", rate, current_errors(noise, scenario.seed))
    add_and_connect(builder, current, value=motor.GetOutputPort("current"))
    sensor = scenario.force_sensor
    errors = force_errors(sensor, scenario.sensor_offsets, scenario.seed)
    force = RigSensor("force_sensor", sensor.rate, errors)
    add_and_connect(builder, force, value=rig.wrench)
    samples = {"motor_age": motor_sample, "force_age": force.GetOutputPort("sample_time")}

    ports = {
        "rig_state": rig_state,
        "motor_current": current.GetOutputPort("reading"),
        "force_torque": force.GetOutputPort("reading"),
        "status": add_status(builder, RIG_STATUS, samples),
        "state_truth": state,
        "wrench_truth": rig.wrench,
        "motor_torque_truth": torque,
    }
    if rig.tail_force is not None:
        ports["tail_sections_truth"] = rig.tail_force.GetOutputPort("sections")
    export_outputs(builder, ports)
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, rig.scene_graph, meshcat)
    station = builder.Build()
    station.set_name("rig_station")
    return station


Drive = tuple[System, OutputPort, OutputPort]
"""Motor with the ports `torque` and `current`; port of the reported angle and rate (2); port of the
time of that sample (1), s."""


def _add_maxon(builder: DiagramBuilder, scenario: RigScenario, state: OutputPort) -> Drive:
    """Adds the Maxon and the encoder on its rotor."""
    maxon = builder.AddNamedSystem("maxon", MaxonMotor(scenario.maxon))
    builder.ExportInput(maxon.GetInputPort("current_command"), "current_command")
    angle = concatenate(builder, "joint_angle", [(state, [0])])
    encoder = RigEncoder(scenario.encoder, scenario.count_angle)
    add_and_connect(builder, encoder, joint_angle=angle)
    parts = [encoder.GetOutputPort(name) for name in ("angle", "rate")]
    return maxon, concatenate(builder, "rig_state", parts), encoder.GetOutputPort("sample_time")


def _add_ak70(builder: DiagramBuilder, scenario: RigScenario, state: OutputPort) -> Drive:
    """Adds the AK70-10, whose replies report its angle and rate."""
    settings = scenario.robot_motor
    motor = MitMotor(settings, scenario.robot.torque_constant)
    add_and_connect(builder, motor, "ak70", joint_state=state)
    builder.ExportInput(motor.GetInputPort("tail_command"), "tail_command")
    replies = MotorEncoder(scenario.robot.command_rate, settings)
    both_joints = concatenate(builder, "joint_twice", [(state, [0, 0, 1, 1])])
    add_and_connect(builder, replies, joints=both_joints)
    parts: list[PortSlice] = [(replies.GetOutputPort(name), [0]) for name in ("angles", "rates")]
    return motor, concatenate(builder, "rig_state", parts), replies.GetOutputPort("sample_time")
