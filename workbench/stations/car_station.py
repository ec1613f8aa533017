"""The car behind its ports: simulated plant with actuators and sensors, or the interface to the real car.

Both export the same ports (design section 9); whatever drives the car is connected to them and does not know which it
is. The simulated station adds ground-truth ports, whose names end in `_truth`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.plant import MultibodyPlant
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
from aerodima.workbench.stations.fused_step import TAIL_COMMANDS, add_chassis_motion, add_fused_step
from aerodima.workbench.stations.ground_truth import CarTruth
from aerodima.workbench.stations.step_drives import MOTION_SIZE, MOTOR_TORQUES
from aerodima.workbench.systems.connections import (
    add_status,
    constant,
    export_interface,
    export_outputs,
    refuse_other_ports,
    select,
    stacked,
    transformed,
)

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without tail arm."""

TAIL_PARTS = ("tail_pitch", "tail_roll", "sail")
HEALTHY = ("imu_fault", "speed_fault", "operator_age", "operator_fault")
"""Fields of `status` that are 0 in simulation."""

Systems = Literal["separate", "fused"]

InterfaceFactory = Callable[[Scenario], System]
"""Makes the system that talks to the real car, with exactly the ports of `STATION_INPUTS` and `STATION_OUTPUTS`."""


def make_car_station(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    systems: Systems = "separate",
) -> Diagram:
    """The station of a scenario as a diagram.

    Args:
        scenario: what to simulate, or what to drive.
        interface: None simulates; a factory (from `hardware`) talks to the car.
        meshcat: shows the simulated car live.
        systems: `separate` has one system per actuator and for the air, and every ground truth; `fused` drives the
            plant by a `FusedStep`, one call into Python a step, and has the truth of motion and tail torque only.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface, or the simulated car, has other ports than the station must have.
    """
    builder = DiagramBuilder()
    if interface is None:
        _simulate(builder, scenario, meshcat, systems)
    else:
        export_interface(builder, interface(scenario), STATION_INPUTS, STATION_OUTPUTS)
    station = builder.Build()
    station.set_name("car_station")
    refuse_other_ports(station, STATION_INPUTS, STATION_OUTPUTS, besides=("_truth",))
    return station


@dataclass
class _TailPorts:
    """Ports that exist with a tail arm and have constant stand-ins without; who reports, by field of its age."""

    state: OutputPort
    torque: OutputPort
    reports: dict[str, System]


def _simulate(builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None, systems: Systems) -> None:
    wind = add_wind_source(builder, scenario)
    gusts = wind is not None and scenario.wind.gust_amplitude > 0.0
    car = add_car_plant(
        builder,
        scenario,
        wind.GetOutputPort("wind_acceleration") if wind and gusts else None,
        sampled_outputs=systems == "separate",
    )
    servo = builder.AddNamedSystem("steering_servo", SteeringServo(scenario.servo, scenario.car))
    builder.ExportInput(servo.GetInputPort("steering_angle"), "steering_angle")
    drive_plant = _drive_separately if systems == "separate" else _drive_at_once
    driven = drive_plant(builder, scenario, car, servo, wind)
    tail = _stand_in_for_tail(builder) if car.tail is None else _add_tail(builder, scenario, car.plant, driven)
    chassis = car.plant.GetBodyByName("chassis")
    p_BoImu_B, seed = np.array([scenario.imu.x, 0.0, scenario.imu.z]), scenario.seed
    imu = Imu.add_to_builder(
        builder,
        scenario.imu,
        plant=car.plant,
        body=chassis,
        p_BoImu_B=p_BoImu_B,
        seed=seed,
        motion=driven.chassis_motion,
    )
    gps = GpsSpeed.add_to_builder(
        builder, scenario.gps, plant=car.plant, body=chassis, seed=seed, motion=driven.chassis_motion
    )
    export_outputs(
        builder,
        {
            "tail_state": tail.state,
            "tail_torque": tail.torque,
            "imu": imu.GetOutputPort("imu"),
            "speed": gps.GetOutputPort("speed"),
            "status": _add_status(builder, {"imu_age": imu, "speed_age": gps}, tail.reports),
            "plant_state_truth": car.plant.get_state_output_port(),
            **driven.truth,
            **({} if driven.drive is None else _add_truth(builder, scenario, car, driven)),
        },
    )
    if wind is not None:
        builder.ExportOutput(wind.GetOutputPort("wind_velocity"), "wind_truth")
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, car.scene_graph, meshcat)


@dataclass
class _Driven:
    """How the plant is driven.

    Attributes:
        truth: ports to export.
        drive: the separate drive; None where a `FusedStep` drives the plant.
        torque: of the tail motors (2), N m; None without a tail.
        wind_direction: where a sail that faces the wind stands, rad; None without a tail.
        force: of the air on the tail; None without a tail, or of a `FusedStep`.
        chassis_motion: what the sensors read instead of the plant; None where they read the plant.
    """

    truth: dict[str, OutputPort]
    drive: System | None = None
    torque: OutputPort | None = None
    wind_direction: OutputPort | None = None
    force: SailForce | None = None
    chassis_motion: OutputPort | None = None


def _drive_separately(
    builder: DiagramBuilder, scenario: Scenario, car: CarPlant, servo: System, wind: System | None
) -> _Driven:
    """One system for the drive, one for the linkage, one for the tail motors, one or two for the air."""
    _connect_steering(builder, car, servo)
    driven = _Driven({}, _add_drive(builder, scenario, car))
    if car.tail is not None:
        motors = add_tail_drive(builder, car.plant, car.tail, scenario)
        for name in TAIL_COMMANDS:
            builder.ExportInput(motors.GetInputPort(name), name)
        driven.torque, driven.force = motors.GetOutputPort("torque"), add_sail_force(builder, car.plant, scenario, wind)
        driven.wind_direction = driven.force.wind_direction
        driven.truth["tail_actuation_truth"] = motors.GetOutputPort("actuation")
    return driven


def _drive_at_once(
    builder: DiagramBuilder, scenario: Scenario, car: CarPlant, servo: System, wind: System | None
) -> _Driven:
    """One system for all; it says where the sail faces, and has no report of its sections."""
    port = None if wind is None else wind.GetOutputPort("wind_velocity")
    fused = add_fused_step(builder, scenario, car, servo.GetOutputPort("frame"), port)
    for name, command in fused.commands.items():
        builder.ExportInput(command, name)
    driven = _Driven({}, chassis_motion=add_chassis_motion(builder, fused))
    if car.tail is not None:
        motors = [MOTOR_TORQUES, MOTOR_TORQUES + 1]
        driven.torque = select(builder, "tail_torque", fused.step.GetOutputPort("drives"), motors)
        driven.truth["last_tail_torque_truth"] = select(
            builder, "last_tail_torque", fused.last, [1 + MOTION_SIZE + index for index in motors]
        )
        driven.wind_direction = fused.step.GetOutputPort("wind_direction")
    return driven


def _add_drive(builder: DiagramBuilder, scenario: Scenario, car: CarPlant) -> System:
    plant = car.plant
    shaft = plant.GetJointByName("drive_shaft_spin")
    radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
    drive = builder.AddNamedSystem("drive", Drive(scenario.drive, shaft_gain(scenario.drive, scenario.car), radius))
    rate = plant.num_positions() + shaft.velocity_start()
    speed = select(builder, "shaft_speed", plant.get_state_output_port(), [rate])
    builder.Connect(speed, drive.GetInputPort("shaft_speed"))
    place = np.zeros((len(car.actuated_joints), 1))
    place[car.actuated_joints.index(shaft.name()), 0] = 1.0
    torques = transformed(builder, "car_actuation", drive.get_output_port(), place)
    builder.Connect(torques, plant.get_actuation_input_port(car.car))
    builder.ExportInput(drive.GetInputPort("throttle"), "throttle")
    return drive


def _connect_steering(builder: DiagramBuilder, car: CarPlant, servo: System) -> None:
    actuators = car.actuated_joints
    count = len(actuators)
    place = np.zeros((2 * count, 4))
    for side, name in enumerate(("front_left_steering", "front_right_steering")):
        place[actuators.index(name), side] = 1.0
        place[count + actuators.index(name), 2 + side] = 1.0
    desired = transformed(builder, "desired_steering", servo.GetOutputPort("knuckle_state"), place)
    builder.Connect(desired, car.plant.get_desired_state_input_port(car.car))


def _add_tail(builder: DiagramBuilder, scenario: Scenario, plant: MultibodyPlant, driven: _Driven) -> _TailPorts:
    assert driven.torque is not None
    assert driven.wind_direction is not None
    encoders = MotorEncoder.add_to_builder(
        builder,
        scenario.controller.rate,
        plant=plant,
        pitch_joint=plant.GetJointByName("tail_pitch"),
        roll_joint=plant.GetJointByName("tail_roll"),
        reply=MotorReply(scenario.tail_motor.position_range, scenario.tail_motor.speed_range),
    )
    sail: System = encoders
    if scenario.tail.sail == "locked":
        angle = rate = constant(builder, "sail_locked", [0.0])
    else:
        sail = _add_sail_encoder(builder, scenario, plant, driven.wind_direction)
        angle, rate = map(sail.GetOutputPort, ("angle", "rate"))
    parts = [encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate]
    reports = {f"{part}_age": sail if part == "sail" else encoders for part in TAIL_PARTS}
    return _TailPorts(stacked(builder, "tail_state", parts), driven.torque, reports)


def _add_status(builder: DiagramBuilder, reports: dict[str, System], tail: dict[str, System]) -> OutputPort:
    """From the sensors by field of their age; those of the tail are none without one."""
    return add_status(
        builder,
        STATUS,
        {},
        [*HEALTHY, *([] if tail else (f"{part}_age" for part in TAIL_PARTS))],
        samples={name: sensor.GetOutputPort("sample_time") for name, sensor in (reports | tail).items()},
        faults={f"{part}_fault": 0.0 if tail else NOT_FITTED for part in TAIL_PARTS},
    )


def _add_sail_encoder(
    builder: DiagramBuilder, scenario: Scenario, plant: MultibodyPlant, wind_direction: OutputPort
) -> System:
    """On the joint of a free sail; a sail that faces the wind has no joint, its angle is that of the wind."""
    settings, seed = scenario.sail_encoder, scenario.seed
    if scenario.tail.sail == "free":
        joint = plant.GetJointByName("tail_sail_turn")
        return SailEncoder.add_to_builder(builder, settings, plant=plant, joint=joint, seed=seed)
    encoder = builder.AddSystem(SailEncoder(settings, seed=seed, step=plant.time_step(), discrete=True))
    builder.Connect(wind_direction, encoder.GetInputPort("plant_state"))
    return encoder


def _stand_in_for_tail(builder: DiagramBuilder) -> _TailPorts:
    for name in TAIL_COMMANDS:
        ignored = builder.AddNamedSystem(f"{name}_ignored", MatrixGain(np.eye(STATION_INPUTS[name].size)))
        builder.ExportInput(ignored.get_input_port(), name)
    state = constant(builder, "no_tail_state", np.zeros(TAIL_STATE.size))
    return _TailPorts(state, constant(builder, "no_tail_torque", np.zeros(2)), {})


def _add_truth(builder: DiagramBuilder, scenario: Scenario, car: CarPlant, driven: _Driven) -> dict[str, OutputPort]:
    """Adds the ground truth of a plant that is driven separately; the ports to export."""
    assert driven.drive is not None
    plant = car.plant
    truth = builder.AddNamedSystem("truth", CarTruth(car, scenario))
    builder.Connect(plant.get_state_output_port(), truth.GetInputPort("plant_state"))
    for name in ("body_spatial_accelerations", "contact_results"):
        builder.Connect(plant.GetOutputPort(name), truth.GetInputPort(name))
    builder.Connect(driven.drive.get_output_port(), truth.GetInputPort("drive_torque"))
    ports = {
        "plant_acceleration_truth": plant.GetOutputPort("generalized_acceleration"),
        "contact_results_truth": plant.get_contact_results_output_port(),
    }
    names = ["body_truth", "contact_truth"]
    if driven.force is not None and driven.torque is not None:
        builder.Connect(driven.torque, truth.GetInputPort("tail_torque"))
        builder.Connect(driven.force.wrench, truth.GetInputPort("tail_wrench"))
        ports |= {"tail_sections_truth": driven.force.sections, "tail_validity_truth": driven.force.validity}
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
