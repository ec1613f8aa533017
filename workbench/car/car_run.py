"""Runs of a car: with every column of a log, or as a trial with what outcome and metrics need."""

import math
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from aerodima.workbench.aero.section_watch import SectionWatch
from aerodima.workbench.car.car_bodies import AddBodies
from aerodima.workbench.car.car_diagram import Build, CarDiagram, assemble, build_name, plant_facts
from aerodima.workbench.car.car_model import axle_statics
from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.car.outcome_record import OutcomeRecord
from aerodima.workbench.car.run_view import LiveView
from aerodima.workbench.car.termination import FlipWatch, check_times, time_after_rows, turn_end
from aerodima.workbench.control.driver_law import DriverLaw
from aerodima.workbench.control.manoeuvre import (
    Schedule,
    run_time,
)
from aerodima.workbench.control.swing_library import swing_facts
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.port_wiring import add_and_connect
from aerodima.workbench.core.system_lifetime import break_reference_cycles
from aerodima.workbench.logs.recorder import (
    RunRecorder,
    open_log,
    recorded_columns,
)
from aerodima.workbench.logs.schema import (
    DIAGRAM,
    TAIL_LAW,
    RunLog,
    run_log_from_metadata,
    run_metadata,
)
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import (
    WHEELS,
)


def run_car(
    scenario: Scenario,
    log: str | Path | None,
    stop_when_certain: bool,
    law: TailLaw | None,
    force: bool,
    view: LiveView,
    build: Build | None = None,
    bodies: AddBodies | None = None,
) -> RunLog:
    """Records every column of a run log; see `simulate`."""
    car = assemble(scenario, meshcat=view.meshcat, tail_law=law, build=build, bodies=bodies)
    watch: FlipWatch | None = None
    if stop_when_certain:
        watch = FlipWatch(car.station, scenario.simulation.log_rate, turn_end(scenario))
        state = car.station.GetOutputPort("plant_state_truth")
        add_and_connect(car.builder, watch, "flip_watch", plant_state=state)
    columns = recorded_columns(car.signals)
    metadata = _metadata(car, scenario, law, build)
    with _released(car, build or bodies), open_log(log, columns, metadata, force) as rows:
        settings = scenario.simulation
        RunRecorder.add_to_builder(car.builder, rows, car.signals, settings.log_rate, settings.step)
        sections: SectionWatch | None = None
        if car.station.HasOutputPort("tail_sections_truth"):
            flow = car.station.GetOutputPort("tail_sections_truth")
            valid = car.station.GetOutputPort("tail_validity_truth")
            sections = add_and_connect(
                car.builder,
                SectionWatch(valid.size(), scenario.controller.rate),
                "section_watch",
                sections=flow,
                validity=valid,
            )
        simulator = Simulator(car.builder.Build())
        _set_rolling(car, simulator.get_mutable_context(), scenario, start_speed(scenario))
        view.run(simulator, run_time(scenario))
        if watch is not None:
            rows.add_facts(watch.facts())
        if sections is not None:
            rows.add_facts(sections.facts())
    return rows.run_log()


def run_outcome(
    scenario: Scenario,
    stop_when_certain: bool,
    law: TailLaw | None,
    view: LiveView,
    schedule: DriverLaw | Schedule | None = None,
    speed: float | None = None,
    build: Build | None = None,
    bodies: AddBodies | None = None,
) -> RunLog:
    """Records what outcome and metrics need, as cheaply as possible, for studies with thousands of
    runs.

    Nothing is recorded in Python, and most of the truth and the roll estimator are left out. The
    driver follows `schedule`, or by default the manoeuvre of the scenario; the car begins at
    `speed`, m/s, straight ahead, or by default as the manoeuvre says.
    """
    car = assemble(
        scenario,
        meshcat=view.meshcat,
        tail_law=law,
        minimal=True,
        schedule=schedule,
        build=build,
        bodies=bodies,
    )
    with _released(car, build or bodies):
        outcome = OutcomeRecord(car.builder, car.station, scenario, car.signals)
        metadata = _metadata(car, scenario, law, build)
        simulator = Simulator(car.builder.Build())
        begin = start_speed(scenario) if speed is None else speed
        _set_rolling(car, simulator.get_mutable_context(), scenario, begin)
        view.begin(simulator, run_time(scenario))
        stop_after = turn_end(scenario) if stop_when_certain else math.inf
        for time in check_times(scenario, stop_after):
            simulator.AdvanceTo(time)
            if outcome.is_certain(simulator.get_context(), stop_after):
                break
        else:
            simulator.AdvanceTo(time_after_rows(scenario, run_time(scenario)))
        table, ended = outcome.table(simulator.get_context(), stop_after)
        metadata["extra"] |= ended
    return run_log_from_metadata(table, metadata)


def _released(car: CarDiagram, user: object) -> AbstractContextManager[None]:
    """Breaks reference cycles after the run, unless `user` code took part and may hold systems."""
    if user is None:
        return break_reference_cycles(car.builder)
    return nullcontext()


def start_speed(scenario: Scenario) -> float:
    """Returns the speed at time 0, m/s: that of the manoeuvre with a rolling start, else 0."""
    return scenario.manoeuvre.speed if scenario.manoeuvre.rolling_start else 0.0


def _set_rolling(car: CarDiagram, context: Context, scenario: Scenario, speed: float) -> None:
    """Lets the car roll straight ahead at `speed`, m/s, without slip; at 0 it stays as it is."""
    if not speed:
        return
    plant = simulated_car(car.station).plant
    plant_context = plant.GetMyMutableContextFromRoot(context)
    velocities = plant.GetVelocities(plant_context)
    velocities[plant.GetBodyByName("chassis").floating_velocities_start_in_v() + 3] = speed
    for name in ("drive_shaft", *WHEELS):
        axle = axle_statics(
            scenario.car, scenario.environment.gravity, "front" if name in WHEELS[:2] else "rear"
        )
        velocities[plant.GetJointByName(f"{name}_spin").velocity_start()] = (
            speed / axle.wheel_height
        )
    plant.SetVelocities(plant_context, velocities)


def _metadata(
    car: CarDiagram, scenario: Scenario, law: TailLaw | None, build: Build | None
) -> Json:
    if law is None:
        facts = swing_facts(scenario)
    else:
        facts = {TAIL_LAW: type(law).__name__}
    if build is not None:
        facts = {DIAGRAM: build_name(build)}
    return run_metadata(scenario.resolved(), scenario.seed, extra=plant_facts(car.station) | facts)
