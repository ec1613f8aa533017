"""From a scenario to a run log: the whole diagram, the simulation, the file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, EventStatus, OutputPort

from aerodima.workbench.aero.section_watch import SectionWatch
from aerodima.workbench.config.log_columns import plant_position_columns, sensor_columns
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.law_of_scenario import swing_facts
from aerodima.workbench.controllers.manoeuvre import make_schedule, run_time
from aerodima.workbench.controllers.tail_controller import TailController
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.controllers.turn_driver import TurnDriver
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.recorder import RunRecorder, recorded_columns
from aerodima.workbench.logs.schema import TAIL_LAW, RunLog, read_run_log, run_metadata
from aerodima.workbench.sensors.roll_estimator import RollEstimator
from aerodima.workbench.sensors.roll_filter import RollFilterSettings
from aerodima.workbench.stations.car_station import InterfaceFactory, make_car_station, simulated_car
from aerodima.workbench.stations.ground_truth import BODY_TRUTH, CONTACT_TRUTH, TAIL_TRUTH, WIND_TRUTH
from aerodima.workbench.systems.event_order import Stage

Progress = Callable[[float, float], None]
"""Called with the time of the run (s) and its length (s) about ten times per simulated second."""

Signals = list[tuple[OutputPort, list[str]]]


@dataclass(frozen=True)
class CarDiagram:
    """A station with driver, tail controller and roll estimator around it, and the ports worth recording."""

    builder: DiagramBuilder
    station: Diagram
    signals: Signals


def assemble(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    tail_law: TailLaw | None = None,
) -> CarDiagram:
    """Connects station, driver, controller and estimator; the controllers stand outside the station.

    The tail follows `tail_law`, or by default the law that the scenario names.
    """
    builder = DiagramBuilder()
    station = make_car_station(scenario, interface, meshcat)
    builder.AddSystem(station)
    driver = TurnDriver.add_to_builder(builder, make_schedule(scenario), scenario.controller.rate, station=station)
    controller = TailController.add_to_builder(builder, scenario, station=station, driver=driver, law=tail_law)
    settings = RollFilterSettings(rate=scenario.imu.rate, gravity=scenario.environment.gravity or 9.81)
    estimator = RollEstimator.add_to_builder(builder, settings, station=station)
    ports = [
        *(driver.GetOutputPort(name) for name in ("steering_angle", "throttle", "planned_turn")),
        *(controller.GetOutputPort(name) for name in ("tail_pitch_command", "tail_roll_command", "state")),
        *(station.GetOutputPort(name) for name in ("tail_state", "tail_torque", "imu", "speed", "status")),
        *(estimator.GetOutputPort(name) for name in ("roll_estimate", "roll_rate_estimate")),
    ]
    names = [column.name for column in sensor_columns()][1:]
    signals: Signals = []
    for port in ports:
        signals.append((port, names[: port.size()]))
        names = names[port.size() :]
    return CarDiagram(builder, station, signals + truth_signals(station))


def truth_signals(station: Diagram) -> Signals:
    """Ground-truth ports of a station with their column names; none for a station without plant."""
    present = {station.get_output_port(index).get_name() for index in range(station.num_output_ports())}
    signals: Signals = []
    for name, fields in (("body_truth", BODY_TRUTH), ("tail_truth", TAIL_TRUTH), ("contact_truth", CONTACT_TRUTH)):
        if name in present:
            signals.append((station.GetOutputPort(name), list(fields.fields)))
    if "plant_state_truth" in present:
        plant = simulated_car(station).plant
        state = station.GetOutputPort("plant_state_truth")
        names = [column.name for column in plant_position_columns(plant.GetPositionNames())]
        names += [f"plant_velocity_{name}" for name in plant.GetVelocityNames()]
        signals.append((state, names))
    if "wind_truth" in present:
        signals.append((station.GetOutputPort("wind_truth"), list(WIND_TRUTH.fields)))
    return signals


def run_scenario(
    scenario: Scenario,
    log_path: str | Path,
    *,
    force: bool = False,
    meshcat: Meshcat | None = None,
    real_time_rate: float = 0.0,
    progress: Progress | None = None,
    tail_law: TailLaw | None = None,
) -> RunLog:
    """Simulates a scenario and writes its run log.

    Rows reach the disk while the run goes on; after an interruption the journal beside `log_path` keeps them and
    `aerodima log recover` makes a log of it.

    Args:
        scenario: resolved scenario.
        log_path: the Parquet file to be; refused when it exists, unless `force`.
        meshcat: shows the run live.
        real_time_rate: 0 runs as fast as possible, 1 in real time.
        progress: told how far the run is.
        tail_law: drives the tail instead of the law that the scenario names; the log has the name of its class as
            `tail_law` in its `extra`.

    Raises:
        UserError: wrong scenario, unwritable or existing log.
    """
    car = assemble(scenario, meshcat=meshcat, tail_law=tail_law)
    law_facts = swing_facts(scenario) if tail_law is None else {TAIL_LAW: type(tail_law).__name__}
    metadata = run_metadata(scenario.resolved(), scenario.seed, extra=plant_facts(car.station) | law_facts)
    columns = recorded_columns(car.signals)
    with JournalWriter(Path(log_path), columns, metadata, force=force) as journal:
        rate = scenario.simulation.log_rate
        RunRecorder.add_to_builder(car.builder, journal, car.signals, rate, Stage.RECORD)
        watch = SectionWatch.add_to_builder(car.builder, car.station, scenario.controller.rate)
        simulator = Simulator(car.builder.Build())
        simulator.set_target_realtime_rate(real_time_rate)
        length = run_time(scenario)
        if progress is not None:
            simulator.set_monitor(_monitor(progress, length))
        simulator.Initialize()
        simulator.AdvanceTo(length)
        if watch is not None:
            journal.add_facts(watch.facts())
    return read_run_log(log_path)


def plant_facts(station: Diagram) -> dict[str, float]:
    """Masses (kg) of a simulated station, for `extra` of a run log."""
    car = simulated_car(station)
    context = car.plant.CreateDefaultContext()
    tail_mass = 0.0 if car.tail is None else car.plant.CalcTotalMass(context, [car.tail])
    return {"tail_mass_kg": tail_mass, "total_mass_kg": car.plant.CalcTotalMass(context, car.instances)}


def _monitor(progress: Progress, length: float) -> Callable:
    last = -np.inf

    def monitor(context: object) -> EventStatus:
        nonlocal last
        time = context.get_time()  # type: ignore[attr-defined]
        if time - last >= 0.1:
            last = time
            progress(time, length)
        return EventStatus.DidNothing()

    return monitor
