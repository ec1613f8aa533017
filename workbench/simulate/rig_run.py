"""From a rig scenario to a log: static hold, flick, free bar swing, robot swing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, System

from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.controllers.rig_swing import CurrentController, TailCommander
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.recorder import recorded_columns
from aerodima.workbench.logs.sample_recorder import SampleRecorder
from aerodima.workbench.logs.schema import RunLog, read_run_log, write_run_log
from aerodima.workbench.plants.rig import Rig
from aerodima.workbench.sensors.force_torque import sensor_errors
from aerodima.workbench.stations.rig_logs import RIG_COLUMN_NAMES, known_truth, rig_log_metadata, simulate_static_log
from aerodima.workbench.stations.rig_station import RigInterfaceFactory, make_rig_station

INTEGRATOR = "runge_kutta3"
"""With a fixed step: 7e-7 rad after a second at 1 ms, on tables with kinks."""

TRUTH_COLUMNS = {
    "state_truth": ("angle_truth_rad", "angular_velocity_truth_rad_per_s"),
    "wrench_truth": tuple([f"force_{axis}_truth_n" for axis in "xyz"] + [f"torque_{axis}_truth_n_m" for axis in "xyz"]),
    "motor_torque_truth": ("motor_torque_truth_n_m",),
}
"""Port of the simulated station -> columns of a swing's log. The wrench is that of the support on the rig."""

Progress = Callable[[float, float], None]
"""Called with the time of the run (s) and its length (s)."""


def run_rig(
    scenario: RigScenario,
    log_path: str | Path,
    *,
    force: bool = False,
    interface: RigInterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
    real_time_rate: float = 0.0,
    progress: Progress | None = None,
) -> RunLog:
    """Runs the experiment of a scenario and writes its log in the rig schema.

    A swing goes through the journal: after an interruption `aerodima log recover` makes a log of what there is.

    Args:
        scenario: resolved rig scenario.
        log_path: the Parquet file to be; refused when it exists, unless `force`.
        force: replace an existing log.
        interface: None simulates; a factory (from `hardware`) talks to the robot-tail rig.
        meshcat: shows a swing live.
        real_time_rate: 0 runs as fast as possible, 1 in real time.
        progress: told how far the run is.

    Raises:
        UserError: the tail leaves its range, holding takes too much current, unwritable or existing log.
    """
    if scenario.experiment.kind == "static":
        log = simulate_static_log(scenario)
        write_run_log(log, log_path, force=force)
        return read_run_log(log_path)
    builder, station = assemble_rig(scenario, interface, meshcat)
    signals = [
        (station.GetOutputPort("rig_state"), list(RIG_COLUMN_NAMES[1:3])),
        (station.GetOutputPort("motor_current"), list(RIG_COLUMN_NAMES[3:4])),
        (station.GetOutputPort("force_torque"), list(RIG_COLUMN_NAMES[4:])),
    ]
    if interface is None:
        signals += [(station.GetOutputPort(port), list(names)) for port, names in TRUTH_COLUMNS.items()]
    facts: dict[str, Any] = {}
    if interface is None:
        facts["truth"] = known_truth(scenario)
        facts["bias"] = sensor_errors(scenario.force_sensor, scenario.seed).bias.tolist()
    metadata = rig_log_metadata(scenario, **facts)
    with JournalWriter(Path(log_path), recorded_columns(signals), metadata, force=force) as journal:
        SampleRecorder.add_to_builder(builder, journal, signals, scenario.simulation.log_rate)
        simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(simulator, INTEGRATOR, scenario.simulation.step)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
        simulator.set_target_realtime_rate(real_time_rate)
        simulator.set_monitor(_monitor(scenario, station, progress))
        simulator.Initialize()
        simulator.AdvanceTo(scenario.experiment.duration + 0.5 * scenario.simulation.step)
    return read_run_log(log_path)


def assemble_rig(
    scenario: RigScenario, interface: RigInterfaceFactory | None = None, meshcat: Meshcat | None = None
) -> tuple[DiagramBuilder, Diagram]:
    """Station and the controller of the experiment, connected; the controller stands outside the station."""
    builder = DiagramBuilder()
    station = make_rig_station(scenario, interface, meshcat)
    builder.AddSystem(station)
    rig, experiment = Rig(scenario), scenario.experiment
    if scenario.is_robot:
        torque = rig.torque_of(rig.holding_current(experiment.angle))
        commander: System = builder.AddSystem(TailCommander(scenario, torque))
        builder.Connect(commander.GetOutputPort("tail_command"), station.GetInputPort("tail_command"))
        return builder, station
    target = rig.holding_current(experiment.target) if experiment.actuated else 0.0
    controller = builder.AddSystem(CurrentController(scenario, rig.holding_current(experiment.angle), target))
    builder.Connect(station.GetOutputPort("rig_state"), controller.GetInputPort("rig_state"))
    builder.Connect(controller.GetOutputPort("current_command"), station.GetInputPort("current_command"))
    return builder, station


def _monitor(scenario: RigScenario, station: Diagram, progress: Progress | None) -> Callable:
    """Tells the progress and refuses a tail that leaves its range."""
    limit, length = scenario.mount.angle_limit, scenario.experiment.duration
    state = station.GetOutputPort("rig_state")
    last = -np.inf

    def monitor(context: Context) -> EventStatus:
        nonlocal last
        time = context.get_time()
        if time - last >= 0.02:
            last = time
            reported: Any = state.Eval(station.GetMyContextFromRoot(context))
            angle = float(reported[0])
            if abs(angle) > limit:
                raise UserError(
                    f"the tail left its range at {time:.2f} s: {angle:g} rad; allowed: within mount.angle_limit, "
                    f"+-{limit:g} rad"
                )
            if progress is not None:
                progress(time, length)
        return EventStatus.DidNothing()

    return monitor
