"""The car behind its ports: simulated plant with actuators and sensors, or the interface to the real car.

Both export the same ports (design section 9); whatever drives the car is connected to them and does not know which it
is. The simulated station adds ground-truth ports, whose names end in `_truth`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain, Multiplexer

from aerodima.workbench.actuators.drive import Drive, shaft_gain
from aerodima.workbench.actuators.servo import SteeringServo
from aerodima.workbench.actuators.tail_drive import add_tail_drive
from aerodima.workbench.config.ports import STATION_INPUTS, STATION_OUTPUTS, STATUS, TAIL_STATE
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.plants.car import CarPlant, add_car_plant
from aerodima.workbench.plants.car_model import axle_statics
from aerodima.workbench.sensors.encoder import MotorEncoder, MotorReply, SailEncoder
from aerodima.workbench.sensors.gps import GpsSpeed
from aerodima.workbench.sensors.imu import Imu
from aerodima.workbench.stations.car_air import add_sail_force, add_wind_source
from aerodima.workbench.stations.ground_truth import CarTruth
from aerodima.workbench.systems.connections import select

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without tail arm."""

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
        _SimulatedCar(builder, scenario, meshcat)
    else:
        _export_interface(builder, interface(scenario))
    station = builder.Build()
    station.set_name("car_station")
    return station


def _export_interface(builder: DiagramBuilder, system: System) -> None:
    inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
    outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
    for kind, ports, contract in (("inputs", inputs, STATION_INPUTS), ("outputs", outputs, STATION_OUTPUTS)):
        sizes = {port.get_name(): port.size() for port in ports}
        allowed = {name: fields.size for name, fields in contract.items()}
        if sizes != allowed:
            raise UserError(f"interface {system.get_name()!r}: {kind} {_sizes(sizes)}; allowed: {_sizes(allowed)}")
    builder.AddSystem(system)
    for name in STATION_INPUTS:
        builder.ExportInput(system.GetInputPort(name), name)
    for name in STATION_OUTPUTS:
        builder.ExportOutput(system.GetOutputPort(name), name)


def _sizes(ports: dict[str, int]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in sorted(ports.items())) or "none"


@dataclass
class _TailPorts:
    """Ports that exist with a tail arm and have constant stand-ins without."""

    state: OutputPort
    torque: OutputPort
    motor_age: OutputPort
    sail_age: OutputPort
    fault: float


class _SimulatedCar:
    """Wires plant, actuators and sensors inside one builder."""

    def __init__(self, builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None):
        self._builder = builder
        self._scenario = scenario
        self._wind = add_wind_source(builder, scenario)
        gusts = self._wind is not None and scenario.wind.gust_amplitude > 0.0
        self._car = add_car_plant(
            builder, scenario, self._wind.GetOutputPort("wind_acceleration") if self._wind and gusts else None
        )
        self._plant = self._car.plant
        chassis = self._plant.GetBodyByName("chassis")
        drive = self._add_drive()
        self._add_steering()
        tail = self._stand_in_for_tail() if self._car.tail is None else self._add_tail(self._car.tail)
        imu = Imu.add_to_builder(
            builder,
            scenario.imu,
            plant=self._plant,
            body=chassis,
            p_BoImu_B=np.array([scenario.imu.x, 0.0, scenario.imu.z]),
            seed=scenario.seed,
        )
        gps = GpsSpeed.add_to_builder(builder, scenario.gps, plant=self._plant, body=chassis, seed=scenario.seed)
        builder.ExportOutput(tail.state, "tail_state")
        builder.ExportOutput(tail.torque, "tail_torque")
        builder.ExportOutput(imu.GetOutputPort("imu"), "imu")
        builder.ExportOutput(gps.GetOutputPort("speed"), "speed")
        builder.ExportOutput(self._status(tail, imu.GetOutputPort("age"), gps.GetOutputPort("age")), "status")
        self._add_truth(drive, tail)
        if meshcat is not None:
            MeshcatVisualizer.AddToBuilder(builder, self._car.scene_graph, meshcat)

    def _add_drive(self) -> System:
        shaft = self._plant.GetJointByName("drive_shaft_spin")
        rate = self._plant.num_positions() + shaft.velocity_start()
        scenario = self._scenario
        radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
        drive = self._builder.AddNamedSystem(
            "drive", Drive(scenario.drive, shaft_gain(scenario.drive, scenario.car), radius)
        )
        speed = select(self._builder, "shaft_speed", self._plant.get_state_output_port(), [rate])
        self._builder.Connect(speed, drive.GetInputPort("shaft_speed"))
        actuators = [
            self._plant.get_joint_actuator(index).joint().name()
            for index in self._plant.GetJointActuatorIndices(self._car.car)
        ]
        place = np.zeros((len(actuators), 1))
        place[actuators.index(shaft.name()), 0] = 1.0
        self._through(
            "car_actuation", place, drive.get_output_port(), self._plant.get_actuation_input_port(self._car.car)
        )
        self._builder.ExportInput(drive.GetInputPort("throttle"), "throttle")
        return drive

    def _add_steering(self) -> None:
        servo = self._builder.AddNamedSystem(
            "steering_servo",
            SteeringServo(self._scenario.servo, self._scenario.car),
        )
        actuators = [
            self._plant.get_joint_actuator(index).joint().name()
            for index in self._plant.GetJointActuatorIndices(self._car.car)
        ]
        count = len(actuators)
        place = np.zeros((2 * count, 4))
        for side, name in enumerate(("front_left_steering", "front_right_steering")):
            place[actuators.index(name), side] = 1.0
            place[count + actuators.index(name), 2 + side] = 1.0
        self._through(
            "desired_steering", place, servo.get_output_port(), self._plant.get_desired_state_input_port(self._car.car)
        )
        self._builder.ExportInput(servo.GetInputPort("steering_angle"), "steering_angle")

    def _add_tail(self, arm: ModelInstanceIndex) -> _TailPorts:
        builder, scenario, plant = self._builder, self._scenario, self._plant
        motors = add_tail_drive(builder, plant, arm, scenario)
        for name in ("tail_pitch_command", "tail_roll_command"):
            builder.ExportInput(motors.GetInputPort(name), name)
        self._tail_force = add_sail_force(builder, plant, scenario, self._wind)
        return self._add_tail_sensors(motors.GetOutputPort("torque"))

    def _add_tail_sensors(self, torque: OutputPort) -> _TailPorts:
        builder, scenario, plant = self._builder, self._scenario, self._plant
        reply = MotorReply(scenario.tail_motor.position_range, scenario.tail_motor.speed_range)
        encoders = MotorEncoder.add_to_builder(
            builder,
            scenario.controller.rate,
            plant=plant,
            pitch_joint=plant.GetJointByName("tail_pitch"),
            roll_joint=plant.GetJointByName("tail_roll"),
            reply=reply,
        )
        if scenario.tail.sail == "locked":
            zero = self._constant("sail_locked", [0.0])
            angle, rate, sail_age = zero, zero, encoders.GetOutputPort("age")
        else:
            encoder = self._add_sail_encoder()
            angle, rate, sail_age = (encoder.GetOutputPort(name) for name in ("angle", "rate", "age"))
        state = builder.AddNamedSystem("tail_state", Multiplexer([2, 1, 2, 1]))
        for index, port in enumerate((encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate)):
            builder.Connect(port, state.get_input_port(index))
        return _TailPorts(state.get_output_port(), torque, encoders.GetOutputPort("age"), sail_age, fault=0.0)

    def _add_sail_encoder(self) -> System:
        """On the joint of a free sail; a sail that faces the wind has no joint, its angle is that of the wind."""
        builder, scenario, plant = self._builder, self._scenario, self._plant
        settings, seed = scenario.sail_encoder, scenario.seed
        if scenario.tail.sail == "free":
            joint = plant.GetJointByName("tail_sail_turn")
            return SailEncoder.add_to_builder(builder, settings, plant=plant, joint=joint, seed=seed)
        encoder = builder.AddSystem(SailEncoder(settings, seed=seed, step=plant.time_step()))
        builder.Connect(self._tail_force.system.GetOutputPort("wind_direction"), encoder.GetInputPort("plant_state"))
        return encoder

    def _stand_in_for_tail(self) -> _TailPorts:
        for name in ("tail_pitch_command", "tail_roll_command"):
            ignored = self._builder.AddNamedSystem(f"{name}_ignored", MatrixGain(np.eye(STATION_INPUTS[name].size)))
            self._builder.ExportInput(ignored.get_input_port(), name)
        age = self._constant("no_tail_age", [0.0])
        state = self._constant("no_tail_state", np.zeros(TAIL_STATE.size))
        return _TailPorts(state, self._constant("no_tail_torque", np.zeros(2)), age, age, NOT_FITTED)

    def _status(self, tail: _TailPorts, imu_age: OutputPort, speed_age: OutputPort) -> OutputPort:
        """The station of a simulation is armed, and its operator is always there."""
        healthy, tail_fault = self._constant("no_fault", [0.0]), self._constant("tail_fault", [tail.fault])
        now = self._constant("operator_age", [0.0])
        sources = {
            "tail_pitch_age": tail.motor_age,
            "tail_pitch_fault": tail_fault,
            "tail_roll_age": tail.motor_age,
            "tail_roll_fault": tail_fault,
            "sail_age": tail.sail_age,
            "sail_fault": tail_fault,
            "imu_age": imu_age,
            "speed_age": speed_age,
            "operator_age": now,
            "armed": self._constant("armed", [1.0]),
        }
        parts = self._builder.AddNamedSystem("status", Multiplexer([1] * STATUS.size))
        for index, name in enumerate(STATUS.fields):
            self._builder.Connect(sources.get(name, healthy), parts.get_input_port(index))
        return parts.get_output_port()

    def _add_truth(self, drive: System, tail: _TailPorts) -> None:
        builder, plant = self._builder, self._plant
        truth = builder.AddNamedSystem("truth", CarTruth(self._car, self._scenario))
        builder.Connect(plant.get_state_output_port(), truth.GetInputPort("plant_state"))
        for name in ("body_spatial_accelerations", "contact_results"):
            builder.Connect(plant.GetOutputPort(name), truth.GetInputPort(name))
        builder.Connect(drive.get_output_port(), truth.GetInputPort("drive_torque"))
        builder.ExportOutput(plant.get_state_output_port(), "plant_state_truth")
        builder.ExportOutput(plant.GetOutputPort("generalized_acceleration"), "plant_acceleration_truth")
        builder.ExportOutput(plant.get_contact_results_output_port(), "contact_results_truth")
        names = ["body_truth", "contact_truth"]
        if self._car.tail is not None:
            builder.Connect(tail.torque, truth.GetInputPort("tail_torque"))
            builder.Connect(self._tail_force.wrench, truth.GetInputPort("tail_wrench"))
            for name in ("sections", "validity"):
                builder.ExportOutput(self._tail_force.system.GetOutputPort(name), f"tail_{name}_truth")
            actuation = builder.GetSubsystemByName("tail_torques").GetOutputPort("actuation")
            builder.ExportOutput(actuation, "tail_actuation_truth")
            names.append("tail_truth")
        for name in names:
            builder.ExportOutput(truth.GetOutputPort(name), name)
        if self._wind is not None:
            builder.ExportOutput(self._wind.GetOutputPort("wind_velocity"), "wind_truth")

    def _constant(self, name: str, value: list[float] | np.ndarray) -> OutputPort:
        return self._builder.AddNamedSystem(name, ConstantVectorSource(np.array(value, dtype=float))).get_output_port()

    def _through(self, name: str, matrix: np.ndarray, source: OutputPort, sink: InputPort) -> None:
        system = self._builder.AddNamedSystem(name, MatrixGain(matrix))
        self._builder.Connect(source, system.get_input_port())
        self._builder.Connect(system.get_output_port(), sink)


def simulated_car(station: Diagram) -> CarPlant:
    """Plant and scene graph inside a simulated station, for those who look at bodies and joints."""
    plant: Any = station.GetSubsystemByName("plant")
    scene_graph: Any = station.GetSubsystemByName("scene_graph")
    instances = {
        name: plant.GetModelInstanceByName(name) for name in ("car", "tail") if plant.HasModelInstanceNamed(name)
    }
    return CarPlant(plant, scene_graph, instances["car"], instances.get("tail"))
