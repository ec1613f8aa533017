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
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import MatrixGain

from aerodima.workbench.actuators.chassis_actuators import SteeringServo
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import STATION_INPUTS, STATION_OUTPUTS, STATUS, TAIL_STATE
from aerodima.workbench.plants.car import CarPlant, add_car_plant
from aerodima.workbench.sensors.car_sensors import GpsSpeed, Imu, MotorEncoder, MotorReply, SailEncoder
from aerodima.workbench.stations.car_air import add_sail_report, add_wind_source
from aerodima.workbench.stations.car_drives import TAIL_COMMANDS, DrivenCar, add_car_drives
from aerodima.workbench.stations.ground_truth import CarTruth
from aerodima.workbench.systems.system_ports import (
    add_status,
    connected,
    constant,
    export_interface,
    export_outputs,
    refuse_other_ports,
    select,
    stacked,
)

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without tail arm."""

TAIL_PARTS = ("tail_pitch", "tail_roll", "sail")
HEALTHY = ("imu_fault", "speed_fault", "operator_age", "operator_fault")
"""Fields of `status` that are 0 in simulation."""

InterfaceFactory = Callable[[Scenario], System]
"""Makes the system that talks to the real car, with exactly the ports of `STATION_INPUTS` and `STATION_OUTPUTS`."""


def make_car_station(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    *,
    with_truth: bool = True,
) -> Diagram:
    """The station of a scenario as a diagram.

    Args:
        scenario: what to simulate, or what to drive.
        interface: None simulates; a factory (from `hardware`) talks to the car.
        meshcat: shows the simulated car live.
        with_truth: of a simulated car, whether the station has every ground truth, or only the plant's state and the
            torque of the tail motors in its last step, which costs nothing.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface, or the simulated car, has other ports than the station must have.
    """
    builder = DiagramBuilder()
    if interface is None:
        _simulate(builder, scenario, meshcat, with_truth)
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


def _simulate(builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None, with_truth: bool) -> None:
    wind = add_wind_source(builder, scenario)
    gusts = wind is not None and scenario.wind.gust_amplitude > 0.0
    pushing = wind.GetOutputPort("wind_acceleration") if wind and gusts else None
    car = add_car_plant(builder, scenario, pushing, sampled_outputs=with_truth)
    servo = builder.AddNamedSystem("steering_servo", SteeringServo(scenario.servo))
    builder.ExportInput(servo.GetInputPort("steering_angle"), "steering_angle")
    blowing = None if wind is None else wind.GetOutputPort("wind_velocity")
    driven = add_car_drives(builder, scenario, car, servo.GetOutputPort("frame"), blowing)
    for name, command in driven.commands.items():
        builder.ExportInput(command, name)
    tail = _stand_in_for_tail(builder) if car.tail is None else _add_tail(builder, scenario, car.plant, driven)
    motion, step, seed = driven.chassis_motion(builder), scenario.simulation.step, scenario.seed
    place, gravity = (scenario.imu.x, 0.0, scenario.imu.z), scenario.environment.gravity
    imu = Imu(scenario.imu, p_BoImu_B=place, seed=seed, step=step, discrete=True, gravity=gravity)
    gps = GpsSpeed(scenario.gps, seed=seed, step=step, discrete=True)
    for sensor in (imu, gps):
        connected(builder, sensor, chassis_motion=motion)
    export_outputs(
        builder,
        {
            "tail_state": tail.state,
            "tail_torque": tail.torque,
            "imu": imu.GetOutputPort("imu"),
            "speed": gps.GetOutputPort("speed"),
            "status": _add_status(builder, {"imu_age": imu, "speed_age": gps}, tail.reports),
            "plant_state_truth": car.plant.get_state_output_port(),
            **(_add_truth(builder, scenario, car, driven, tail, blowing) if with_truth else {}),
        },
    )
    if car.tail is not None and not with_truth:
        builder.ExportOutput(driven.last_drive(builder, "last_tail_torque", "motor_torques"), "last_tail_torque_truth")
    if blowing is not None:
        builder.ExportOutput(blowing, "wind_truth")
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, car.scene_graph, meshcat)


def _add_tail(builder: DiagramBuilder, scenario: Scenario, plant: MultibodyPlant, driven: DrivenCar) -> _TailPorts:
    joints = [plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")]
    places = [joint.position_start() for joint in joints]
    places += [plant.num_positions() + joint.velocity_start() for joint in joints]
    reply = MotorReply(scenario.tail_motor.position_range, scenario.tail_motor.speed_range)
    encoders = MotorEncoder(scenario.controller.rate, reply, step=plant.time_step(), discrete=True)
    connected(builder, encoders, joints=select(builder, "tail_joints", plant.get_state_output_port(), places))
    sail: System = encoders
    if scenario.tail.sail == "locked":
        angle = rate = constant(builder, "sail_locked", [0.0])
    else:
        sail = _add_sail_encoder(builder, scenario, plant, driven.system.GetOutputPort("wind_direction"))
        angle, rate = map(sail.GetOutputPort, ("angle", "rate"))
    parts = [encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate]
    reports = {f"{part}_age": sail if part == "sail" else encoders for part in TAIL_PARTS}
    torque = driven.drive(builder, "tail_torque", "motor_torques")
    return _TailPorts(stacked(builder, "tail_state", parts), torque, reports)


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
    angle = wind_direction
    if scenario.tail.sail == "free":
        place = plant.GetJointByName("tail_sail_turn").position_start()
        angle = select(builder, "sail_turn", plant.get_state_output_port(), [place])
    encoder = SailEncoder(scenario.sail_encoder, seed=scenario.seed, step=plant.time_step(), discrete=True)
    return connected(builder, encoder, joint_angle=angle)


def _stand_in_for_tail(builder: DiagramBuilder) -> _TailPorts:
    for name in TAIL_COMMANDS:
        ignored = builder.AddNamedSystem(f"{name}_ignored", MatrixGain(np.eye(STATION_INPUTS[name].size)))
        builder.ExportInput(ignored.get_input_port(), name)
    state = constant(builder, "no_tail_state", np.zeros(TAIL_STATE.size))
    return _TailPorts(state, constant(builder, "no_tail_torque", np.zeros(2)), {})


def _add_truth(
    builder: DiagramBuilder,
    scenario: Scenario,
    car: CarPlant,
    driven: DrivenCar,
    tail: _TailPorts,
    wind: OutputPort | None,
) -> dict[str, OutputPort]:
    """Adds what only a simulation knows; the ports to export."""
    plant = car.plant
    truth = connected(
        builder,
        CarTruth(car, scenario),
        "truth",
        plant_state=plant.get_state_output_port(),
        body_spatial_accelerations=plant.get_body_spatial_accelerations_output_port(),
        contact_results=plant.get_contact_results_output_port(),
        drive_torque=driven.drive(builder, "drive_torque", "shaft_torque"),
    )
    ports = {
        "plant_acceleration_truth": plant.GetOutputPort("generalized_acceleration"),
        "contact_results_truth": plant.get_contact_results_output_port(),
    }
    names = ["body_truth", "contact_truth"]
    if car.tail is not None:
        sail = add_sail_report(builder, plant, scenario, wind)
        builder.Connect(tail.torque, truth.GetInputPort("tail_torque"))
        builder.Connect(sail.wrench, truth.GetInputPort("tail_wrench"))
        ports |= {"tail_sections_truth": sail.sections, "tail_validity_truth": sail.validity}
        ports["tail_actuation_truth"] = driven.drive(builder, "tail_actuation", "joint_torques")
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
