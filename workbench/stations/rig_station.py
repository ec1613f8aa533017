"""The rig behind its ports: simulated plant with motor and sensors, or the interface to the real rig.

Both export the same ports (design section 9). The robot-tail rig has its AK70-10 on the bus and can be swapped for
hardware; the cheetah rig takes a current and exists in simulation only. The simulated station adds ports whose names
end in `_truth`.
"""

from collections.abc import Callable

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System

from aerodima.workbench.actuators.motors import MaxonMotor, MitMotor, current_noise
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.config.signal_table import RIG_OUTPUTS, RIG_STATUS, ROBOT_RIG_INPUTS
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.rig import add_rig_plant
from aerodima.workbench.sensors.encoder import MotorEncoder, MotorReply
from aerodima.workbench.sensors.rig_sensors import ForceTorqueSensor, MotorCurrentSensor, RigEncoder
from aerodima.workbench.simulate.rig_run import sensor_offsets
from aerodima.workbench.systems.system_ports import add_status, export_interface, export_outputs, select, stacked

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
        current_noise(scenario.maxon, scenario.seed),
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
    export_outputs(
        builder,
        {
            "rig_state": reported,
            "motor_current": current.GetOutputPort("reading"),
            "force_torque": force.GetOutputPort("reading"),
            "status": add_status(
                builder,
                RIG_STATUS,
                {"motor_age": age, "force_age": force.GetOutputPort("age")},
                healthy=("motor_fault", "force_fault", "operator_age", "operator_fault"),
            ),
            "state_truth": state,
            "wrench_truth": rig.wrench,
            "motor_torque_truth": motor.GetOutputPort("torque"),
        },
    )
    if rig.tail_force is not None:
        builder.ExportOutput(rig.tail_force.GetOutputPort("sections"), "tail_sections_truth")
    if meshcat is not None:
        assert rig.scene_graph is not None
        MeshcatVisualizer.AddToBuilder(builder, rig.scene_graph, meshcat)


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
        both = stacked(builder, "rig_state", [encoder.GetOutputPort(name) for name in ("angle", "rate")])
        return both, encoder.GetOutputPort("age")
    reply = MotorReply(scenario.robot_motor.position_range, scenario.robot_motor.speed_range)
    replies = MotorEncoder(
        scenario.robot.command_rate, indices=(0, 0, 1, 1), state_size=2, reply=reply, step=scenario.simulation.step
    )
    builder.AddSystem(replies)
    builder.Connect(state, replies.GetInputPort("plant_state"))
    ones = [select(builder, f"one_of_{name}", replies.GetOutputPort(name), [0]) for name in ("angles", "rates")]
    return stacked(builder, "rig_state", ones), replies.GetOutputPort("age")
