"""The diagram of a car's run: station, driver, tail controller and roll estimator."""

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System

from aerodima.workbench.car.car_bodies import AddBodies
from aerodima.workbench.car.car_station import (
    InterfaceFactory,
    make_car_station,
    simulated_car,
)
from aerodima.workbench.car.ground_truth import AIR_TRUTH, air_columns
from aerodima.workbench.control.controller_systems import TailController, TurnDriver
from aerodima.workbench.control.driver_law import DriverLaw, make_driver
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import Schedule
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_wiring import constant
from aerodima.workbench.logs.recorder import (
    OpenBuilder,
    Signals,
    output_ports,
    port_sources,
    signals_of,
)
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import (
    CAR_PORTS,
    CAR_TRUTH,
    STATION_INPUTS,
    names_of,
    plant_position_columns,
    sensor_columns,
)

DRIVER_PORTS = ("planned_turn", "state")
"""Ports of driver and tail controller that the log holds beside their commands."""
Build = Callable[[DiagramBuilder, Diagram], object]
"""Adds the systems that drive a station to the builder that holds it, and connects the station's
input ports. What it exports or logs fills columns of the log (`OpenBuilder.signals`); a port
exported as `planned_turn` or `state` fills the column of the driver or the controller."""


@dataclass(frozen=True)
class CarDiagram:
    """A station with the systems that drive it and the roll estimator around it, and the ports
    worth recording.

    Attributes:
        builder: builder of the diagram that holds the station.
        station: station of the car.
        signals: ports with the names of their columns.
        user_signals: part of `signals` that the build of the diagram has exported or logged.
    """

    builder: DiagramBuilder
    station: Diagram
    signals: Signals
    user_signals: Signals


def default_build(
    scenario: Scenario,
    tail_law: TailLaw | None = None,
    schedule: DriverLaw | Schedule | None = None,
    minimal: bool = False,
) -> Build:
    """Returns a function that adds driver and tail controller of a scenario; see `assemble`."""

    def build(builder: DiagramBuilder, station: Diagram) -> None:
        law = tail_law or law_of_scenario(scenario)
        driver = TurnDriver.add_to_builder(
            builder,
            schedule or make_driver(scenario),
            scenario.controller.rate,
            station=station,
            controller_rate=law.rate,
        )
        idle = minimal and tail_law is None and not scenario.has_tail
        TailController.add_to_builder(
            builder, scenario, station=station, driver=driver, law=law, idle=idle
        )

    return build


def assemble(
    scenario: Scenario,
    interface: InterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    tail_law: TailLaw | None = None,
    minimal: bool = False,
    schedule: DriverLaw | Schedule | None = None,
    build: Build | None = None,
    bodies: AddBodies | None = None,
) -> CarDiagram:
    """Connects a station, the systems that drive it, and the roll estimator; the controllers stand
    outside the station.

    The tail follows `tail_law` and the driver follows `schedule`, which may be a law; by default
    both are those that the scenario names. `build` adds something else in place of both, and
    `bodies` adds bodies to the simulated car. With `minimal`, what no metric of a run needs is left
    out: most of the truth, the roll estimator and, without tail, the ticks of its controller.

    Raises:
        UserError: `build` leaves an input port of the station without connection, or names columns
            that exist already.
    """
    builder = OpenBuilder()
    station = make_car_station(scenario, interface, meshcat, with_truth=not minimal, bodies=bodies)
    builder.AddSystem(station)
    (build or default_build(scenario, tail_law, schedule, minimal))(builder, station)
    driven = {name: builder.exported.pop(name) for name in DRIVER_PORTS if name in builder.exported}
    signals = car_signals(builder, station, scenario, driven, minimal)
    taken = names_of(sensor_columns())
    for _, names in signals:
        taken += names
    user_signals = builder.signals(taken)
    return CarDiagram(builder, station, signals + user_signals, user_signals)


def car_signals(
    builder: DiagramBuilder,
    station: Diagram,
    scenario: Scenario,
    driven: dict[str, OutputPort],
    minimal: bool = False,
) -> Signals:
    """Lists ports and columns of the log of a driven car; unless `minimal`, adds the roll estimator
    where there is none.

    Args:
        driven: exported ports of the driving systems by their names in `DRIVER_PORTS`; a missing
            one is that of a `TurnDriver` or `TailController` in the builder, or 0.

    Raises:
        UserError: an input port of the station is not connected.
    """
    ports = port_sources(builder, station)
    missing = [name for name in STATION_INPUTS if name not in ports]
    if missing:
        raise UserError(
            f"build: station port {', '.join(missing)}: not connected; each of them commands the "
            "car"
        )
    kinds = (TurnDriver, TailController)
    drivers = [system for system in builder.GetSystems() if isinstance(system, kinds)]
    ports = output_ports(*drivers) | ports | driven
    for name in DRIVER_PORTS:
        if name not in ports:
            ports[name] = constant(builder, f"no_{name}", [0.0])
    sources: list[System] = [station]
    if not minimal:
        from aerodima.workbench.car.roll_estimator import RollEstimator
        from aerodima.workbench.car.roll_filter import RollFilterSettings

        settings = RollFilterSettings.from_scenario(scenario)
        present = [system for system in builder.GetSystems() if isinstance(system, RollEstimator)]
        sources += present or [RollEstimator.add_to_builder(builder, settings, station=station)]
    return signals_of(CAR_PORTS, ports | output_ports(*sources)) + truth_signals(station)


def build_name(build: Build) -> str:
    """Returns the name of a build in the metadata of a log."""
    return str(getattr(build, "__name__", type(build).__name__))


def truth_signals(station: Diagram) -> Signals:
    """Returns the ground-truth ports of a station with their columns; none without a plant."""
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
    for name in ports:
        if name.endswith(AIR_TRUTH):
            signals.append((ports[name], air_columns(name.removesuffix(AIR_TRUTH))))
    return signals


def plant_facts(station: Diagram) -> dict[str, float]:
    """Returns masses (kg) of a simulated station, for `extra` of a run log."""
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
