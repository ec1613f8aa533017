"""The car behind its ports: simulated plant with actuators and sensors, or the interface to the
real car.

Both export the same ports (design section 9); whatever drives the car is connected to them and does
not know which it is. The simulated station adds ground-truth ports, whose names end in `_truth`.
"""

from collections.abc import Callable
from typing import Any

from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System

from aerodima.workbench.car.car_air import add_sail_report, add_wind_source
from aerodima.workbench.car.car_drives import LAST, DrivenCar, add_car_drives
from aerodima.workbench.car.car_plant import CarPlant, add_car_plant
from aerodima.workbench.car.car_sensors import (
    GpsSpeed,
    Imu,
    MotorEncoder,
    MotorReply,
    SailEncoder,
)
from aerodima.workbench.car.ground_truth import CarTruth
from aerodima.workbench.core.port_contract import (
    add_status,
    export_interface,
    export_outputs,
    require_ports,
)
from aerodima.workbench.core.port_wiring import PortMux, PortSlice, add_and_connect
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import (
    STATION_INPUTS,
    STATION_OUTPUTS,
    STATUS,
    TAIL_STATE,
)

NOT_FITTED = 1.0
"""Fault code on `status` of a part that this car does not have, such as the motors of a car without
tail arm."""

TAIL_PARTS = ("tail_pitch", "tail_roll", "sail")
HEALTHY = ("imu_fault", "speed_fault", "operator_age", "operator_fault")
"""Fields of `status` that are 0 in simulation."""

InterfaceFactory = Callable[[Scenario], System]
"""Makes the system that talks to the real car, with exactly the ports of `STATION_INPUTS` and
`STATION_OUTPUTS`."""


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
        with_truth: of a simulated car, whether the station has every ground truth, or only the
            plant's state and the torque of the tail motors in its last step, which costs nothing.

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
    require_ports(station, STATION_INPUTS, STATION_OUTPUTS, besides=("_truth",))
    return station


def _simulate(
    builder: DiagramBuilder, scenario: Scenario, meshcat: Meshcat | None, with_truth: bool
) -> None:
    mux = PortMux(builder, STATION_INPUTS)
    wind = add_wind_source(builder, scenario)
    gusts = wind is not None and scenario.wind.gust_amplitude > 0.0
    pushing = None
    if wind and gusts:
        pushing = wind.GetOutputPort("wind_acceleration")
    seen = with_truth or meshcat is not None
    car = add_car_plant(builder, scenario, pushing, sampled_outputs=with_truth, drawn=seen)
    blowing = None
    if wind is not None:
        blowing = wind.GetOutputPort("wind_velocity")
    driven = add_car_drives(builder, mux, scenario, car, blowing)
    reports: dict[str, System] = {}
    if car.tail is None:
        mux.route("tail_state", *[driven.zero] * TAIL_STATE.size)
    else:
        reports = _add_tail(builder, mux, scenario, driven)
    step = scenario.simulation.step
    seed = scenario.seed
    gravity = scenario.environment.gravity
    place = (scenario.imu.x, 0.0, scenario.imu.z)
    imu = Imu(scenario.imu, p_BoImu_B=place, seed=seed, step=step, discrete=True, gravity=gravity)
    gps = GpsSpeed(scenario.gps, seed=seed, step=step, discrete=True)
    for sensor in (imu, gps):
        builder.AddSystem(sensor)
        mux.route(sensor.GetInputPort("chassis_motion"), *driven.chassis_motion)
    mux.route("tail_torque", driven.drive("motor_torques"))
    outputs = {
        "imu": imu.GetOutputPort("imu"),
        "speed": gps.GetOutputPort("speed"),
        "status": _add_status(builder, {"imu_age": imu, "speed_age": gps}, reports),
        "plant_state_truth": car.plant.get_state_output_port(),
    }
    if with_truth:
        outputs |= _add_truth(builder, mux, scenario, car, driven, blowing)
    export_outputs(builder, outputs)
    if car.tail is not None and not with_truth:
        mux.route("last_tail_torque_truth", (driven.last, LAST["motor_torques"]))
    if blowing is not None:
        builder.ExportOutput(blowing, "wind_truth")
    mux.add_to_builder()
    if meshcat is not None:
        MeshcatVisualizer.AddToBuilder(builder, car.scene_graph, meshcat)


def _add_tail(
    builder: DiagramBuilder, mux: PortMux, scenario: Scenario, driven: DrivenCar
) -> dict[str, System]:
    """Adds the encoders; who reports, by field of its age."""
    motor = scenario.tail_motor
    step = scenario.simulation.step
    reply = MotorReply(motor.position_range, motor.speed_range)
    encoders = MotorEncoder(scenario.controller.rate, reply, step=step, discrete=True)
    builder.AddSystem(encoders)
    mux.route(
        encoders.GetInputPort("joints"), *driven.moves("angles")[:2], *driven.moves("rates")[:2]
    )
    sail: System = encoders
    angle: PortSlice = driven.zero
    rate: PortSlice = driven.zero
    if scenario.tail.sail != "locked":
        sail = builder.AddSystem(
            SailEncoder(scenario.sail_encoder, seed=scenario.seed, step=step, discrete=True)
        )
        # A sail that faces the wind has no joint, its angle is that of the wind.
        free = scenario.tail.sail == "free"
        if free:
            turn = driven.moves("angles")[2]
        else:
            turn = driven.system.GetOutputPort("wind_direction")
        mux.route(sail.GetInputPort("joint_angle"), turn)
        angle, rate = map(sail.GetOutputPort, ("angle", "rate"))
    mux.route(
        "tail_state", encoders.GetOutputPort("angles"), angle, encoders.GetOutputPort("rates"), rate
    )
    sensors: dict[str, System] = {f"{part}_age": encoders for part in TAIL_PARTS}
    sensors["sail_age"] = sail
    return sensors


def _add_status(
    builder: DiagramBuilder, reports: dict[str, System], tail: dict[str, System]
) -> OutputPort:
    """From the sensors by field of their age; those of the tail are none without one."""
    sensors = reports | tail
    healthy = [*HEALTHY]
    fault = 0.0
    if not tail:
        healthy += [f"{part}_age" for part in TAIL_PARTS]
        fault = NOT_FITTED
    return add_status(
        builder,
        STATUS,
        {},
        healthy,
        samples={name: sensor.GetOutputPort("sample_time") for name, sensor in sensors.items()},
        faults={f"{part}_fault": fault for part in TAIL_PARTS},
    )


def _add_truth(
    builder: DiagramBuilder,
    mux: PortMux,
    scenario: Scenario,
    car: CarPlant,
    driven: DrivenCar,
    wind: OutputPort | None,
) -> dict[str, OutputPort]:
    """Adds what only a simulation knows; the ports to export."""
    plant = car.plant
    truth = add_and_connect(
        builder,
        CarTruth(car, scenario),
        "truth",
        plant_state=plant.get_state_output_port(),
        contact_results=plant.get_contact_results_output_port(),
    )
    mux.route(truth.GetInputPort("chassis_motion"), *driven.chassis_motion)
    mux.route(truth.GetInputPort("drive_torque"), driven.drive("shaft_torque"))
    ports = {
        "plant_acceleration_truth": plant.GetOutputPort("generalized_acceleration"),
        "contact_results_truth": plant.get_contact_results_output_port(),
    }
    names = ["body_truth", "contact_truth"]
    if car.tail is not None:
        sail = add_sail_report(builder, plant, scenario, wind)
        mux.route(truth.GetInputPort("tail_torque"), driven.drive("motor_torques"))
        mux.route("tail_actuation_truth", driven.drive("joint_torques"))
        mux.route(truth.GetInputPort("tail_air"), driven.drive("air_on_chassis"))
        ports |= {"tail_sections_truth": sail.sections, "tail_validity_truth": sail.validity}
        names.append("tail_truth")
    return ports | {name: truth.GetOutputPort(name) for name in names}


def simulated_car(station: Diagram) -> CarPlant:
    """Plant and scene graph inside a simulated station, for those who look at bodies and joints."""
    plant: Any = station.GetSubsystemByName("plant")
    scene_graph: Any = station.GetSubsystemByName("scene_graph")
    instances = {
        name: plant.GetModelInstanceByName(name)
        for name in ("car", "tail")
        if plant.HasModelInstanceNamed(name)
    }
    return CarPlant(plant, scene_graph, instances["car"], instances.get("tail"))
