"""Runs of a rig scenario to a log: static hold, flick, free bar swing, robot swing."""

from pathlib import Path

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from aerodima.workbench.car.run_view import Check, LiveView
from aerodima.workbench.core.port_wiring import add_and_connect, vector_of
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.core.system_lifetime import break_reference_cycles
from aerodima.workbench.logs.recorder import (
    RunRecorder,
    open_log,
    output_ports,
    recorded_columns,
    signals_of,
)
from aerodima.workbench.logs.schema import RunLog, read_run_log, write_run_log
from aerodima.workbench.rig.rig_controllers import CurrentController, TailCommander
from aerodima.workbench.rig.rig_log import known_truth, rig_log_metadata
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.rig_sensors import force_errors
from aerodima.workbench.rig.rig_station import make_rig_station
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.signal_table import RIG_PORTS, RIG_TRUTH

INTEGRATOR = "runge_kutta3"
"""Integrator, with a fixed step: 7e-7 rad of error after a second at 1 ms, on tables with kinks."""


def run_rig(
    scenario: RigScenario,
    log: str | Path | None,
    *,
    force: bool,
    view: LiveView,
) -> RunLog:
    """Runs the experiment of a scenario; its log is in the rig schema. See `simulate`.

    Args:
        scenario: resolved rig scenario.
        log: path of the Parquet file to write; None keeps the log in memory.
        force: whether to replace an existing log.
        view: live view of a swing.

    Raises:
        UserError: the tail leaves its range, holding takes too much current, unwritable or existing
            log.
    """
    if scenario.experiment.kind == "static":
        held = simulate_static_log(scenario)
        if log is None:
            return held
        return read_run_log(write_run_log(held, log, force=force))
    builder, station = assemble_rig(scenario, view.meshcat)
    signals = signals_of({**RIG_PORTS, **RIG_TRUTH}, output_ports(station))
    errors = force_errors(scenario.force_sensor, scenario.sensor_offsets, scenario.seed)
    metadata = rig_log_metadata(scenario, truth=known_truth(scenario), bias=errors.bias.tolist())
    with (
        break_reference_cycles(builder),
        open_log(log, recorded_columns(signals), metadata, force) as rows,
    ):
        RunRecorder.add_to_builder(
            builder, rows, signals, scenario.simulation.log_rate, with_samples=True
        )
        simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(simulator, INTEGRATOR, scenario.simulation.step)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
        margin = 0.5 * scenario.simulation.step
        view.run(
            simulator,
            scenario.experiment.duration,
            margin=margin,
            check=_range_check(scenario, station),
        )
    return rows.run_log()


def assemble_rig(
    scenario: RigScenario, meshcat: Meshcat | None = None
) -> tuple[DiagramBuilder, Diagram]:
    """Connects the station and the controller of the experiment; the controller stands outside the
    station.
    """
    builder = DiagramBuilder()
    station = make_rig_station(scenario, meshcat=meshcat)
    builder.AddSystem(station)
    rig = Rig(scenario)
    experiment = scenario.experiment
    if scenario.is_robot:
        torque = rig.torque_of(rig.holding_current(experiment.angle))
        controller: System = builder.AddSystem(TailCommander(scenario, torque))
        command = "tail_command"
    else:
        target = rig.holding_current(experiment.target) if experiment.actuated else 0.0
        controller = add_and_connect(
            builder,
            CurrentController(scenario, rig.holding_current(experiment.angle), target),
            rig_state=station.GetOutputPort("rig_state"),
        )
        command = "current_command"
    builder.Connect(controller.GetOutputPort(command), station.GetInputPort(command))
    return builder, station


def _range_check(scenario: RigScenario, station: Diagram) -> Check:
    """Makes a check that refuses a tail outside of its range."""
    limit = scenario.mount.angle_limit
    state = station.GetOutputPort("rig_state")

    def check(context: Context) -> None:
        angle, _ = vector_of(state, station.GetMyContextFromRoot(context))
        name = f"angle at {context.get_time():.2f} s, beyond the tail's range (mount.angle_limit)"
        check_range(name, angle, -limit, limit, "rad")

    return check
