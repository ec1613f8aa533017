"""The diagram of a car's run: station, driver, controller and estimator; and its simulation."""

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, System

from aerodima.workbench.aero.section_watch import SectionWatch
from aerodima.workbench.car.car_model import axle_statics
from aerodima.workbench.car.car_station import (
    InterfaceFactory,
    make_car_station,
    simulated_car,
)
from aerodima.workbench.car.outcome_record import FlipWatch, OutcomeRecord
from aerodima.workbench.control.controller_systems import TailController, TurnDriver
from aerodima.workbench.control.driver_law import DriverLaw, make_driver
from aerodima.workbench.control.law_of_scenario import law_of_scenario, swing_facts
from aerodima.workbench.control.manoeuvre import (
    Schedule,
    angle_to_straighten,
    run_time,
    steering_time,
)
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.event_order import EVENT_OFFSET, step_instant
from aerodima.workbench.core.port_wiring import constant
from aerodima.workbench.core.system_lifetime import break_reference_cycles
from aerodima.workbench.logs.recorder import (
    OpenBuilder,
    RunRecorder,
    Signals,
    open_log,
    output_ports,
    recorded_columns,
    signals_of,
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
    CAR_PORTS,
    CAR_TRUTH,
    STATION_INPUTS,
    WHEELS,
    names_of,
    plant_position_columns,
    sensor_columns,
)

Progress = Callable[[float, float], None]
"""Called with the time of the run (s) and its length (s)."""
Check = Callable[[Context], None]
"""Raises when the run must not go on."""

TOLD_EVERY = 0.1
"""Time between two calls of the progress without a check, s of the run."""
CHECKED_EVERY = 0.02
"""Time between two calls with a check, s of the run."""
_TIME_MARGIN = 1e-9
"""Rounding of a time, s."""
DRIVER_PORTS = ("planned_turn", "state")
"""Ports of driver and tail controller that the log has beside their commands."""
LOOKS = 50.0
"""Looks per second, Hz, for a certain outcome that ends a trial; its table ends at the row of the
flip all the same."""
Build = Callable[[DiagramBuilder, Diagram], object]
"""Adds what drives a station to the builder, in which the station stands, and connects its input
ports. What it exports or logs fills columns of the log (`OpenBuilder.signals`); exported as
`planned_turn` or `state`, those of driver and controller."""


@dataclass(frozen=True)
class LiveView:
    """Meshcat that shows the run, its pace (0 as fast as possible, 1 in real time), and what
    receives its progress.
    """

    meshcat: Meshcat | None = None
    real_time_rate: float = 0.0
    progress: Progress | None = None

    def run(
        self,
        simulator: Simulator,
        length: float,
        *,
        margin: float = 0.0,
        check: Check | None = None,
    ) -> None:
        """Simulates from time 0 to `length` + `margin`, s."""
        self.begin(simulator, length, check)
        simulator.AdvanceTo(length + margin)

    def begin(self, simulator: Simulator, length: float, check: Check | None = None) -> None:
        """Initialises a run of `length` s."""
        simulator.set_target_realtime_rate(self.real_time_rate)
        if self.progress is not None or check is not None:
            simulator.set_monitor(self._monitor(length, check))
        simulator.Initialize()

    def _monitor(self, length: float, check: Check | None) -> Callable[[Context], EventStatus]:
        last = -np.inf
        period = TOLD_EVERY if check is None else CHECKED_EVERY

        def monitor(context: Context) -> EventStatus:
            nonlocal last
            time = context.get_time()
            if time - last >= period:
                last = time
                if check is not None:
                    check(context)
                if self.progress is not None:
                    self.progress(time, length)
            return EventStatus.DidNothing()

        return monitor


@dataclass(frozen=True)
class CarDiagram:
    """A station with what drives it and the roll estimator around it, and the ports worth
    recording.

    Attributes: own: those of `signals` that whoever built what drives has exported or logged.
    """

    builder: DiagramBuilder
    station: Diagram
    signals: Signals
    own: Signals


def build_of(
    scenario: Scenario,
    tail_law: TailLaw | None = None,
    schedule: DriverLaw | Schedule | None = None,
    lean: bool = False,
) -> Build:
    """Driver and tail controller of a scenario. See `assemble`."""

    def build(builder: DiagramBuilder, station: Diagram) -> None:
        law = tail_law or law_of_scenario(scenario)
        rate = scenario.controller.rate
        driver = TurnDriver.add_to_builder(
            builder,
            schedule or make_driver(scenario),
            rate,
            station=station,
            controller_rate=law.rate,
        )
        idle = lean and tail_law is None and scenario.tail.mode == "none"
        controller = TailController.add_to_builder(
            builder, scenario, station=station, driver=driver, law=law, idle=idle
        )
        for port, system in zip(DRIVER_PORTS, (driver, controller), strict=True):
            builder.ExportOutput(system.GetOutputPort(port), port)

    return build


def assemble(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    tail_law: TailLaw | None = None,
    lean: bool = False,
    schedule: DriverLaw | Schedule | None = None,
    build: Build | None = None,
) -> CarDiagram:
    """Connects station, what drives it, and estimator; the controllers stand outside the station.

    The tail follows `tail_law`, the driver `schedule`, which may be a law, or by default what the
    scenario names; `build` adds something else in place of both. With `lean`, what no metric of a
    run needs is left out: most of the truth, the estimator of roll and, without tail, the ticks of
    its controller.

    Raises:
        UserError: `build` leaves an input port of the station without connection, or names columns
            that are there.
    """
    builder = OpenBuilder()
    station = make_car_station(scenario, interface, meshcat, with_truth=not lean)
    builder.AddSystem(station)
    (build or build_of(scenario, tail_law, schedule, lean))(builder, station)
    ports = builder.sources(station)
    missing = [name for name in STATION_INPUTS if name not in ports]
    if missing:
        raise UserError(
            f"build: station port {', '.join(missing)}: not connected; each of them commands the "
            "car"
        )
    for name in DRIVER_PORTS:
        if name in builder.exported:
            ports[name] = builder.exported.pop(name)
        else:
            ports[name] = constant(builder, f"no_{name}", [0.0])
    sources: list[System] = [station]
    if not lean:
        from aerodima.workbench.car.roll_estimator import RollEstimator
        from aerodima.workbench.car.roll_filter import RollFilterSettings

        settings = RollFilterSettings(
            rate=scenario.imu.rate, gravity=scenario.environment.gravity or 9.81
        )
        sources.append(RollEstimator.add_to_builder(builder, settings, station=station))
    signals = signals_of(CAR_PORTS, ports | output_ports(*sources)) + truth_signals(station)
    taken = names_of(sensor_columns())
    for _, names in signals:
        taken += names
    own = builder.signals(taken)
    return CarDiagram(builder, station, signals + own, own)


def name_of(build: Build) -> str:
    """What a log calls it."""
    return str(getattr(build, "__name__", type(build).__name__))


def truth_signals(station: Diagram) -> Signals:
    """Ground-truth ports of a station with their column names; none for a station without plant."""
    ports = output_ports(station)
    wind = ports.pop("wind_truth", None)
    signals = signals_of(CAR_TRUTH, ports)
    if "plant_state_truth" in ports:
        plant = simulated_car(station).plant
        names = names_of(plant_position_columns(plant.GetPositionNames()))
        names += [f"plant_velocity_{name}" for name in plant.GetVelocityNames()]
        signals.append((ports["plant_state_truth"], names))
    if wind is not None:
        signals += signals_of(CAR_TRUTH, {"wind_truth": wind})
    return signals


def run_car(
    scenario: Scenario,
    log: str | Path | None,
    stop_when_certain: bool,
    law: TailLaw | None,
    force: bool,
    view: LiveView,
    build: Build | None = None,
) -> RunLog:
    """Records every column of a run log; see `simulate`."""
    car = assemble(scenario, meshcat=view.meshcat, tail_law=law, build=build)
    watch: FlipWatch | None = None
    if stop_when_certain:
        watch = FlipWatch.add_to_builder(
            car.builder, car.station, scenario.simulation.log_rate, turn_end(scenario)
        )
    columns = recorded_columns(car.signals)
    metadata = _metadata(car, scenario, law, build)
    with _over(car, build), open_log(log, columns, metadata, force) as rows:
        settings = scenario.simulation
        RunRecorder.add_to_builder(car.builder, rows, car.signals, settings.log_rate, settings.step)
        sections: SectionWatch | None = None
        if car.station.HasOutputPort("tail_sections_truth"):
            seen = car.station.GetOutputPort("tail_sections_truth")
            valid = car.station.GetOutputPort("tail_validity_truth")
            sections = SectionWatch.add_to_builder(
                car.builder, "section_watch", seen, valid, scenario.controller.rate
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
) -> RunLog:
    """Records what outcome and metrics need, as cheaply as it can be: for studies, which need
    thousands of runs.

    Nothing is recorded in Python, and most of the truth and the roll estimator are left out. The
    driver follows `schedule`, or by default the manoeuvre of the scenario; the car begins at
    `speed`, m/s, straight ahead, or by default as the manoeuvre says.
    """
    car = assemble(
        scenario, meshcat=view.meshcat, tail_law=law, lean=True, schedule=schedule, build=build
    )
    with _over(car, build):
        outcome = OutcomeRecord(car.builder, car.station, scenario, car.signals)
        metadata = _metadata(car, scenario, law, build)
        simulator = Simulator(car.builder.Build())
        if speed is None:
            begin = start_speed(scenario)
        else:
            begin = speed
        _set_rolling(car, simulator.get_mutable_context(), scenario, begin)
        view.begin(simulator, run_time(scenario))
        if stop_when_certain:
            stop_after = turn_end(scenario)
        else:
            stop_after = math.inf
        for time in _looks(scenario, stop_after):
            simulator.AdvanceTo(time)
            if outcome.is_certain(simulator.get_context(), stop_after):
                break
        else:
            simulator.AdvanceTo(_behind_rows(scenario, run_time(scenario)))
        table, ended = outcome.table(simulator.get_context(), stop_after)
        metadata["extra"] |= ended
    return run_log_from_metadata(table, metadata)


def _over(car: CarDiagram, build: Build | None) -> AbstractContextManager[None]:
    """Breaks the reference cycles, unless the diagram is a user's, who may still hold systems."""
    if build is None:
        return break_reference_cycles(car.builder)
    return nullcontext()


def start_speed(scenario: Scenario) -> float:
    """Speed of the car at time 0, m/s: that of the manoeuvre with a rolling start, else 0."""
    return scenario.manoeuvre.speed if scenario.manoeuvre.rolling_start else 0.0


def _set_rolling(car: CarDiagram, context: Context, scenario: Scenario, speed: float) -> None:
    """Lets the car roll straight ahead at `speed`, m/s, without slip; at 0 it stays as it is."""
    if not speed:
        return
    plant = simulated_car(car.station).plant
    own = plant.GetMyMutableContextFromRoot(context)
    velocities = plant.GetVelocities(own)
    velocities[plant.GetBodyByName("chassis").floating_velocities_start_in_v() + 3] = speed
    for name in ("drive_shaft", *WHEELS):
        axle = axle_statics(
            scenario.car, scenario.environment.gravity, "front" if name in WHEELS[:2] else "rear"
        )
        velocities[plant.GetJointByName(f"{name}_spin").velocity_start()] = (
            speed / axle.wheel_height
        )
    plant.SetVelocities(own, velocities)


def _looks(scenario: Scenario, first: float) -> Iterator[float]:
    """When a trial is looked at, s: behind the rows of that instant, before the plant's step."""
    rate = min(LOOKS, scenario.simulation.log_rate)
    end = run_time(scenario)
    if first < end:
        yield from (
            _behind_rows(scenario, k / rate)
            for k in range(math.ceil(first * rate), math.ceil(end * rate))
        )


def _behind_rows(scenario: Scenario, time: float) -> float:
    """When the rows of an instant are written and the plant has not yet stepped, s."""
    instant = step_instant(time, scenario.simulation.step)
    if instant is None:
        return time * (1.0 - 0.5 * EVENT_OFFSET)
    return instant


def _metadata(
    car: CarDiagram, scenario: Scenario, law: TailLaw | None, build: Build | None
) -> dict[str, Any]:
    if law is None:
        facts = swing_facts(scenario)
    else:
        facts = {TAIL_LAW: type(law).__name__}
    if build is not None:
        facts = {DIAGRAM: name_of(build)}
    return run_metadata(scenario.resolved(), scenario.seed, extra=plant_facts(car.station) | facts)


def turn_start(scenario: Scenario) -> float:
    """Time of the steering command of a single turn, s."""
    manoeuvre = scenario.manoeuvre
    return manoeuvre.straight_time if manoeuvre.kind == "auto_turn" else manoeuvre.turn_start


def turn_end(scenario: Scenario) -> float:
    """When the wheels are straight again after the (last) turn, s; the end of the run where no
    schedule says that.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind not in ("turn", "auto_turn"):
        return run_time(scenario)
    servo = scenario.servo
    slack = 1.0 / servo.frame_rate + 1.0 / scenario.simulation.log_rate + _TIME_MARGIN
    angle = angle_to_straighten(
        manoeuvre.steer_angle,
        manoeuvre.turn_hold,
        servo.rate,
        manoeuvre.first_angle,
        manoeuvre.first_hold,
    )
    if manoeuvre.kind == "turn":
        steered = steering_time(manoeuvre.turn_hold, manoeuvre.turns, manoeuvre.turn_gap)
    else:
        steered = steering_time(manoeuvre.turn_hold)
    return turn_start(scenario) + steered + angle / servo.rate + slack


def plant_facts(station: Diagram) -> dict[str, float]:
    """Masses (kg) of a simulated station, for `extra` of a run log."""
    car = simulated_car(station)
    context = car.plant.CreateDefaultContext()
    if car.tail is None:
        tail_mass = 0.0
    else:
        tail_mass = car.plant.CalcTotalMass(context, [car.tail])
    return {
        "tail_mass_kg": tail_mass,
        "total_mass_kg": car.plant.CalcTotalMass(context, car.instances),
    }
