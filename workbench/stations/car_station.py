"""The car behind its ports: simulated plant with actuators and sensors, or the interface to the real car.

Both export the same ports (design section 9); whatever drives the car is connected to them and does not know which it
is. The simulated station adds ground-truth ports, whose names end in `_truth`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import MatrixGain

from aerodima.workbench.actuators.drive import Drive, shaft_gain
from aerodima.workbench.actuators.servo import SteeringServo
from aerodima.workbench.actuators.tail_drive import add_tail_drive
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import STATION_INPUTS, STATION_OUTPUTS, STATUS, TAIL_STATE
from aerodima.workbench.plants.car import CarPlant, add_car_plant
from aerodima.workbench.plants.car_model import axle_statics
from aerodima.workbench.sensors.encoder import MotorEncoder, MotorReply, SailEncoder
from aerodima.workbench.sensors.gps import GpsSpeed
from aerodima.workbench.sensors.imu import Imu
from aerodima.workbench.stations.car_air import SailForce, add_sail_force, add_wind_source
from aerodima.workbench.stations.ground_truth import CarTruth
from aerodima.workbench.systems.connections import (
    add_status,
    constant,
    export_interface,
    export_outputs,
    select,
    stacked,
    transformed,
)

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without tail arm."""

_TAIL_COMMANDS = ("tail_pitch_command", "tail_roll_command")

InterfaceFactory = Callable[[Scenario], System]
"""Makes the system that talks to the real car, with exactly the ports of `STATION_INPUTS` and `STATION_OUTPUTS`."""


def make_car_station(
    scenario: Scenario, interface: InterfaceFactory | None = None, meshcat: Meshcat | None = None
) -> Diagram:
    """The station of a scenario as a diagram.

    Args:
        scenario: what to simulate, or what to drive.
        interface: None simulates; a factory (from `hardware`) talks to the car.
        meshcat: shows the simulated car live.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface has other ports than the station must have.
    """
    builder = DiagramBuilder()
    if interface is None:
        _simulate(builder, scenario, meshcat)
    else:
        export_interface(builder, interface(scenario), STATION_INPUTS, STATION_OUTPUTS)
    station = builder.Build()
    station.set_name("car_station")
    return station


@dataclass
class _TailPorts:
    """Ports that exist with a tail arm and have constant stand-ins without."""

    state: OutputPort
    torque: OutputPort
    motor_age: OutputPort
    sail_age: OutputPort
    fault: float = 0.0
    force: SailForce | None = None


def _simulate(builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None) -> None:
    wind = add_wind_source(builder, scenario)
    gusts = wind is not None and scenario.wind.gust_amplitude > 0.0
    car = add_car_plant(builder, scenario, wind.GetOutputPort("wind_acceleration") if wind and gusts else None)
    plant, chassis = car.plant, car.plant.GetBodyByName("chassis")
    drive = _add_drive(builder, scenario, car)
    _add_steering(builder, scenario, car)
    tail = _stand_in_for_tail(builder) if car.tail is None else _add_tail(builder, scenario, plant, car.tail, wind)
    imu = Imu.add_to_builder(
        builder,
        scenario.imu,
        plant=plant,
        body=chassis,
        p_BoImu_B=np.array([scenario.imu.x, 0.0, scenario.imu.z]),
        seed=scenario.seed,
    )
    gps = GpsSpeed.add_to_builder(builder, scenario.gps, plant=plant, body=chassis, seed=scenario.seed)
    tail_fault = constant(builder, "tail_fault", [tail.fault])
    ages = {"tail_pitch_age": tail.motor_age, "tail_roll_age": tail.motor_age, "sail_age": tail.sail_age}
    ages |= {"imu_age": imu.GetOutputPort("age"), "speed_age": gps.GetOutputPort("age")}
    faults = {f"{part}_fault": tail_fault for part in ("tail_pitch", "tail_roll", "sail")}
    export_outputs(
        builder,
        {
            "tail_state": tail.state,
            "tail_torque": tail.torque,
            "imu": imu.GetOutputPort("imu"),
            "speed": gps.GetOutputPort("speed"),
            "status": add_status(builder, STATUS, ages | faults),
            **_add_truth(builder, scenario, car, drive, tail),
        },
    )
    if wind is not None:
        builder.ExportOutput(wind.GetOutputPort("wind_velocity"), "wind_truth")
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, car.scene_graph, meshcat)


def _add_drive(builder: DiagramBuilder, scenario: Scenario, car: CarPlant) -> System:
    plant = car.plant
    shaft = plant.GetJointByName("drive_shaft_spin")
    radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
    drive = builder.AddNamedSystem("drive", Drive(scenario.drive, shaft_gain(scenario.drive, scenario.car), radius))
    rate = plant.num_positions() + shaft.velocity_start()
    speed = select(builder, "shaft_speed", plant.get_state_output_port(), [rate])
    builder.Connect(speed, drive.GetInputPort("shaft_speed"))
    actuators = _actuated_joints(car)
    place = np.zeros((len(actuators), 1))
    place[actuators.index(shaft.name()), 0] = 1.0
    torques = transformed(builder, "car_actuation", drive.get_output_port(), place)
    builder.Connect(torques, plant.get_actuation_input_port(car.car))
    builder.ExportInput(drive.GetInputPort("throttle"), "throttle")
    return drive


def _add_steering(builder: DiagramBuilder, scenario: Scenario, car: CarPlant) -> None:
    servo = builder.AddNamedSystem("steering_servo", SteeringServo(scenario.servo, scenario.car))
    actuators = _actuated_joints(car)
    count = len(actuators)
    place = np.zeros((2 * count, 4))
    for side, name in enumerate(("front_left_steering", "front_right_steering")):
        place[actuators.index(name), side] = 1.0
        place[count + actuators.index(name), 2 + side] = 1.0
    desired = transformed(builder, "desired_steering", servo.get_output_port(), place)
    builder.Connect(desired, car.plant.get_desired_state_input_port(car.car))
    builder.ExportInput(servo.GetInputPort("steering_angle"), "steering_angle")


def _actuated_joints(car: CarPlant) -> list[str]:
    indices = car.plant.GetJointActuatorIndices(car.car)
    return [car.plant.get_joint_actuator(index).joint().name() for index in indices]


def _add_tail(
    builder: DiagramBuilder, scenario: Scenario, plant: MultibodyPlant, arm: ModelInstanceIndex, wind: System | None
) -> _TailPorts:
    motors = add_tail_drive(builder, plant, arm, scenario)
    for name in _TAIL_COMMANDS:
        builder.ExportInput(motors.GetInputPort(name), name)
    force = add_sail_force(builder, plant, scenario, wind)
    encoders = MotorEncoder.add_to_builder(
        builder,
        scenario.controller.rate,
        plant=plant,
        pitch_joint=plant.GetJointByName("tail_pitch"),
        roll_joint=plant.GetJointByName("tail_roll"),
        reply=MotorReply(scenario.tail_motor.position_range, scenario.tail_motor.speed_range),
    )
    age = encoders.GetOutputPort("age")
    if scenario.tail.sail == "locked":
        angle = rate = constant(builder, "sail_locked", [0.0])
        sail_age = age
    else:
        encoder = _add_sail_encoder(builder, scenario, plant, force)
        angle, rate, sail_age = (encoder.GetOutputPort(name) for name in ("angle", "rate", "age"))
    parts = [encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate]
    state = stacked(builder, "tail_state", parts)
    return _TailPorts(state, motors.GetOutputPort("torque"), age, sail_age, force=force)


def _add_sail_encoder(builder: DiagramBuilder, scenario: Scenario, plant: MultibodyPlant, force: SailForce) -> System:
    """On the joint of a free sail; a sail that faces the wind has no joint, its angle is that of the wind."""
    settings, seed = scenario.sail_encoder, scenario.seed
    if scenario.tail.sail == "free":
        joint = plant.GetJointByName("tail_sail_turn")
        return SailEncoder.add_to_builder(builder, settings, plant=plant, joint=joint, seed=seed)
    encoder = builder.AddSystem(SailEncoder(settings, seed=seed, step=plant.time_step()))
    builder.Connect(force.system.GetOutputPort("wind_direction"), encoder.GetInputPort("plant_state"))
    return encoder


def _stand_in_for_tail(builder: DiagramBuilder) -> _TailPorts:
    for name in _TAIL_COMMANDS:
        ignored = builder.AddNamedSystem(f"{name}_ignored", MatrixGain(np.eye(STATION_INPUTS[name].size)))
        builder.ExportInput(ignored.get_input_port(), name)
    age = constant(builder, "no_tail_age", [0.0])
    state = constant(builder, "no_tail_state", np.zeros(TAIL_STATE.size))
    return _TailPorts(state, constant(builder, "no_tail_torque", np.zeros(2)), age, age, NOT_FITTED)


def _add_truth(
    builder: DiagramBuilder, scenario: Scenario, car: CarPlant, drive: System, tail: _TailPorts
) -> dict[str, OutputPort]:
    """Adds the ground truth; the ports to export."""
    plant = car.plant
    truth = builder.AddNamedSystem("truth", CarTruth(car, scenario))
    builder.Connect(plant.get_state_output_port(), truth.GetInputPort("plant_state"))
    for name in ("body_spatial_accelerations", "contact_results"):
        builder.Connect(plant.GetOutputPort(name), truth.GetInputPort(name))
    builder.Connect(drive.get_output_port(), truth.GetInputPort("drive_torque"))
    ports = {
        "plant_state_truth": plant.get_state_output_port(),
        "plant_acceleration_truth": plant.GetOutputPort("generalized_acceleration"),
        "contact_results_truth": plant.get_contact_results_output_port(),
    }
    names = ["body_truth", "contact_truth"]
    if tail.force is not None:
        builder.Connect(tail.torque, truth.GetInputPort("tail_torque"))
        builder.Connect(tail.force.wrench, truth.GetInputPort("tail_wrench"))
        ports |= {f"tail_{name}_truth": tail.force.system.GetOutputPort(name) for name in ("sections", "validity")}
        actuation = builder.GetSubsystemByName("tail_torques").GetOutputPort("actuation")
        ports["tail_actuation_truth"] = actuation
        names.append("tail_truth")
    return ports | {name: truth.GetOutputPort(name) for name in names}


def simulated_car(station: Diagram) -> CarPlant:
    """Plant and scene graph inside a simulated station, for those who look at bodies and joints."""
    plant: Any = station.GetSubsystemByName("plant")
    scene_graph: Any = station.GetSubsystemByName("scene_graph")
    instances = {
        name: plant.GetModelInstanceByName(name) for name in ("car", "tail") if plant.HasModelInstanceNamed(name)
    }
    return CarPlant(plant, scene_graph, instances["car"], instances.get("tail"))
