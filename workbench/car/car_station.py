"""The car behind its ports: simulated plant with actuators and sensors, or the interface to the
real car.

Both export the same ports (design section 9); whatever drives the car is connected to them and does
not know which it is. The simulated station adds ground-truth ports, whose names end in `_truth`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import PassThrough

from aerodima.workbench.aero.tail_force import TailForce
from aerodima.workbench.car.ak70 import (
    TAIL_JOINTS,
    JointFriction,
    TailMotor,
    TailMotorFactory,
    add_tail_motor,
)
from aerodima.workbench.car.car_air import TailAerodynamics, add_sail_report, add_wind
from aerodima.workbench.car.car_bodies import AddBodies
from aerodima.workbench.car.car_plant import CarPlant, add_car_plant
from aerodima.workbench.car.car_sensors import (
    GpsSpeed,
    Imu,
    MotorEncoder,
    SailEncoder,
)
from aerodima.workbench.car.chassis_actuators import DriveTrain, SteeringServo
from aerodima.workbench.car.ground_truth import AIR_TRUTH, CarTruth, PlantTruth
from aerodima.workbench.car.plant_ports import PlantPorts
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_contract import (
    add_status,
    export_interface,
    export_outputs,
    require_ports,
)
from aerodima.workbench.core.port_wiring import PortSlice, add_and_connect, concatenate
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import (
    STATION_INPUTS,
    STATION_OUTPUTS,
    STATUS,
    TAIL_COMMAND,
)

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without
tail arm."""
TAIL_PARTS = ("tail_pitch", "tail_roll", "sail")
"""Parts of the tail that report on `status`."""

InterfaceFactory = Callable[["Scenario"], System]
"""Makes the system that talks to the real car, with exactly the ports of `STATION_INPUTS` and
`STATION_OUTPUTS`."""


def make_car_station(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    *,
    with_truth: bool = True,
    tail_motor: TailMotorFactory = TailMotor,
    bodies: AddBodies | None = None,
) -> Diagram:
    """Makes the station of a scenario as a diagram.

    A tail motor of your own is a system with an output port `torque` (1), N m, and any of the input
    ports `joint_state` (2), rad and rad/s, and `tail_command` (5):

        from pydrake.systems.framework import LeafSystem

        class Spring(LeafSystem):
            def __init__(self, scenario, joint):
                super().__init__()
                state = self.DeclareVectorInputPort("joint_state", 2)
                self.DeclareVectorOutputPort(
                    "torque", 1, lambda context, torque: torque.SetFromVector(
                        -5.0 * state.Eval(context)[:1]))

        station = make_car_station(scenario, tail_motor=Spring)

    Args:
        scenario: scenario of the car to simulate or to drive.
        interface: factory (from `hardware`) of the system that talks to the real car; None
            simulates the car.
        meshcat: Meshcat that shows the simulated car live.
        with_truth: whether the station of a simulated car has every ground truth, or only the
            plant's state and the torque of the tail motors in its last step, which costs nothing.
        tail_motor: function that makes the motor of a simulated joint; called with the scenario
            and one of `tail_pitch` and `tail_roll`.
        bodies: function that adds your own bodies to a simulated car, see `AddBodies`.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface, the simulated car or a tail motor has other ports than it must
            have.
    """
    if tail_motor is not TailMotor and (interface is not None or not scenario.has_tail):
        raise UserError(f"tail_motor: {tail_motor!r}: only a simulated car with a tail has one")
    if bodies is not None and interface is not None:
        raise UserError(f"bodies: {bodies!r}: only a simulated car takes them")
    builder = DiagramBuilder()
    if interface is None:
        _add_simulated_car(builder, scenario, meshcat, with_truth, tail_motor, bodies)
    else:
        export_interface(builder, interface(scenario), STATION_INPUTS, STATION_OUTPUTS)
    station = builder.Build()
    station.set_name("car_station")
    require_ports(station, STATION_INPUTS, STATION_OUTPUTS, besides=("_truth",))
    return station


def _add_simulated_car(
    builder: DiagramBuilder,
    scenario: Scenario,
    meshcat: Meshcat | None,
    with_truth: bool,
    tail_motor: TailMotorFactory,
    bodies: AddBodies | None,
) -> None:
    """Adds plant, drive train, servo, tail and sensors, and exports the ports of the station."""
    # The plant, and the wind that pushes its added mass.
    air, gust = add_wind(builder, scenario, bodies is not None)
    car = add_car_plant(
        builder,
        scenario,
        gust,
        sampled_outputs=with_truth,
        drawn=with_truth or meshcat is not None,
        wind=air,
        add_bodies=bodies,
    )
    ports = PlantPorts(builder, car)

    # Drive train, steering and tail.
    drive = add_and_connect(builder, DriveTrain(scenario), spins=ports.motion("spins"))
    frame = ports.motion("last_frame")  # the servo goes on from there
    servo = add_and_connect(builder, SteeringServo(scenario), last_frame=frame)
    inputs: dict[str, InputPort] = {
        "throttle": drive.GetInputPort("throttle"),
        "steering_angle": servo.GetInputPort("steering_angle"),
    }
    torques = drive.GetOutputPort("torques")
    steering = servo.GetOutputPort("steering")
    if car.tail is None:
        tail = None
        ports.drive(torques, steering)
        for joint in TAIL_JOINTS:
            inputs[f"{joint}_command"] = _ignored(builder, f"{joint}_command")
        motor_torques = ports.motion("tail_torque")
    else:
        tail = TailDrives.add_to_builder(builder, scenario, car, ports, air, tail_motor)
        inputs |= tail.commands
        motor_torques = tail.motor_torques
        force = tail.air.GetOutputPort("force")
        ports.drive(torques, steering, motor_torques, tail.joint_torques, force)

    # Sensors, and the ports of the station.
    outputs = _add_sensors(builder, scenario, ports, tail)
    for name in STATION_INPUTS:
        builder.ExportInput(inputs[name], name)
    outputs["tail_torque"] = motor_torques
    outputs["plant_state_truth"] = car.plant.get_state_output_port()
    if with_truth:
        outputs |= _add_truth(builder, scenario, car, ports, torques, tail, air)
    elif tail is not None:
        outputs["last_tail_torque_truth"] = ports.motion("last_tail_torque")
    if air is not None:
        outputs["wind_truth"] = air
    export_outputs(builder, outputs)
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, car.scene_graph, meshcat)


def _ignored(builder: DiagramBuilder, command: str) -> InputPort:
    """Adds a system that takes a command to a tail motor that needs none; returns its port."""
    ignored = PassThrough(TAIL_COMMAND.size)
    return builder.AddNamedSystem(f"ignored_{command}", ignored).get_input_port()


@dataclass(frozen=True)
class TailDrives:
    """Drives of the tail of a car.

    Attributes:
        commands: input ports of the motors, by their names on the station.
        motor_torques: port (2) of the torques of the motors on pitch and roll joint, N m.
        joint_torques: port (2) of these torques plus the friction of the joints, N m.
        air: system that computes the force of the air on the tail.
    """

    commands: dict[str, InputPort]
    motor_torques: OutputPort
    joint_torques: OutputPort
    air: TailAerodynamics

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        scenario: Scenario,
        car: CarPlant,
        ports: PlantPorts,
        wind: OutputPort | None,
        tail_motor: TailMotorFactory,
    ) -> TailDrives:
        """Adds two motors, the friction of their joints, and the air on the sail."""
        commands = {}
        torques = []
        for joint in TAIL_JOINTS:
            motor = add_tail_motor(
                builder,
                tail_motor,
                scenario,
                joint,
                joint_state=ports.motion(f"{joint}_state"),
                joint_motion=ports.motion(f"{joint}_motion"),
            )
            torques.append(motor.GetOutputPort("torque"))
            if motor.HasInputPort("tail_command"):
                commands[f"{joint}_command"] = motor.GetInputPort("tail_command")
            else:
                commands[f"{joint}_command"] = _ignored(builder, f"{joint}_command")
        motor_torques = concatenate(builder, "motor_torques", torques)
        friction = add_and_connect(
            builder,
            JointFriction(scenario.friction, len(TAIL_JOINTS)),
            rates=ports.motion("tail_rates"),
            motor_torques=motor_torques,
        )
        joint_torques = friction.GetOutputPort("joint_torques")
        air = TailAerodynamics.add_to_builder(
            builder, scenario, car.plant, tail_motion=ports.motion("tail_motion"), wind=wind
        )
        return cls(commands, motor_torques, joint_torques, air)


def _add_sensors(
    builder: DiagramBuilder, scenario: Scenario, ports: PlantPorts, tail: TailDrives | None
) -> dict[str, OutputPort]:
    """Adds the sensors of the car; returns the station's ports of sensors and status."""
    imu = Imu(
        scenario.imu,
        p_BoImu_B=(scenario.imu.x, 0.0, scenario.imu.z),
        seed=scenario.seed,
        step=scenario.simulation.step,
        discrete=True,
        gravity=scenario.environment.gravity,
    )
    gps = GpsSpeed(scenario.gps, seed=scenario.seed, discrete=True)
    for sensor in (imu, gps):
        add_and_connect(builder, sensor, chassis_motion=ports.motion("chassis_motion"))
    ages: dict[str, System] = {"imu_age": imu, "speed_age": gps}
    if tail is None:
        tail_state = ports.motion("tail_state")
    else:
        tail_state, encoders = _add_encoders(builder, scenario, ports, tail.air)
        ages |= encoders
    fault = 0.0 if "sail_age" in ages else NOT_FITTED
    status = add_status(
        builder,
        STATUS,
        {name: sensor.GetOutputPort("sample_time") for name, sensor in ages.items()},
        {f"{part}_fault": fault for part in TAIL_PARTS},
    )
    return {
        "tail_state": tail_state,
        "imu": imu.GetOutputPort("imu"),
        "speed": gps.GetOutputPort("speed"),
        "status": status,
    }


def _add_encoders(
    builder: DiagramBuilder, scenario: Scenario, ports: PlantPorts, air: TailAerodynamics
) -> tuple[OutputPort, dict[str, System]]:
    """Adds the tail's encoders; returns the port `tail_state`, and the sensor behind each age."""
    encoders = MotorEncoder(scenario.controller.rate, scenario.tail_motor, discrete=True)
    add_and_connect(builder, encoders, joints=ports.motion("tail_joints"))
    ages: dict[str, System] = {f"{part}_age": encoders for part in TAIL_PARTS}
    angle: PortSlice = ports.zero
    rate: PortSlice = ports.zero
    if scenario.tail.sail != "locked":
        sail = SailEncoder(scenario.sail_encoder, seed=scenario.seed, discrete=True)
        if scenario.tail.sail == "free":
            turn = ports.motion("sail_turn")
        else:  # a sail that faces the wind has no joint, its angle is that of the wind
            turn = air.GetOutputPort("wind_direction")
        ages["sail_age"] = add_and_connect(builder, sail, joint_angle=turn)
        angle = sail.GetOutputPort("angle")
        rate = sail.GetOutputPort("rate")
    parts = [encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate]
    return concatenate(builder, "tail_state", parts), ages


def _add_truth(
    builder: DiagramBuilder,
    scenario: Scenario,
    car: CarPlant,
    ports: PlantPorts,
    torques: OutputPort,
    tail: TailDrives | None,
    wind: OutputPort | None,
) -> dict[str, OutputPort]:
    """Adds the ground truth that only a simulation knows; returns the ports to export."""
    plant = car.plant
    state = plant.get_state_output_port()
    contacts = plant.get_contact_results_output_port()
    sources = {
        "plant_state": state,
        "contact_results": contacts,
        "chassis_motion": ports.motion("chassis_motion"),
        "drive_torque": concatenate(builder, "drive_torque", [(torques, [0])]),
    }
    outputs = {
        "plant_acceleration_truth": plant.GetOutputPort("generalized_acceleration"),
        "contact_results_truth": contacts,
    }
    forces: list[Any] = [force for force in builder.GetSystems() if isinstance(force, TailForce)]
    air = PlantTruth(plant, None, [], forces)
    wrenches = {force.get_name(): force.GetOutputPort("wrench") for force in forces}
    if wrenches:
        add_and_connect(builder, air, "air_truth", plant_state=state, **wrenches)
    for name in wrenches:
        outputs[name + AIR_TRUTH] = air.GetOutputPort(f"{name}_air")
    names = ["body_truth", "contact_truth"]
    if tail is not None:
        report = add_sail_report(builder, plant, scenario, wind)
        on_tail = tail.air.GetOutputPort("force")
        sources["tail_torque"] = tail.motor_torques
        sources["tail_air"] = concatenate(builder, "air_on_chassis", [(on_tail, range(6))])
        outputs["tail_actuation_truth"] = tail.joint_torques
        outputs["tail_sections_truth"] = report["sections"]
        outputs["tail_validity_truth"] = report["validity"]
        names.append("tail_truth")
    truth = add_and_connect(builder, CarTruth(car, scenario), "truth", **sources)
    return outputs | {name: truth.GetOutputPort(name) for name in names}


def simulated_car(station: Diagram) -> CarPlant:
    """Returns plant and scene graph of a simulated station, to look at bodies and joints."""
    plant: Any = station.GetSubsystemByName("plant")
    scene_graph: Any = station.GetSubsystemByName("scene_graph")
    instances = {
        name: plant.GetModelInstanceByName(name)
        for name in ("car", "tail")
        if plant.HasModelInstanceNamed(name)
    }
    return CarPlant(plant, scene_graph, instances["car"], instances.get("tail"))
