"""From a rig scenario to a log: static hold, flick, free bar swing, robot swing."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.config.signal_table import RIG_PORTS, RIG_TRUTH, names_of, rig_columns
from aerodima.workbench.controllers.controller_systems import CurrentController, TailCommander
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.recorder import RunRecorder, open_log, output_ports, recorded_columns, signals_of
from aerodima.workbench.logs.schema import RunLog, read_run_log, run_log_from_metadata, run_metadata, write_run_log
from aerodima.workbench.plants.rig import Rig
from aerodima.workbench.plants.rig_motion import rig_law
from aerodima.workbench.sensors.rig_sensors import count_angle, quantise, sensor_errors, sensor_readings
from aerodima.workbench.sensors.sampled import CounterNoise
from aerodima.workbench.simulate.live_view import Check, LiveView
from aerodima.workbench.stations.rig_station import RigInterfaceFactory, make_rig_station
from aerodima.workbench.systems.system_ports import vector_of

RIG_COLUMN_NAMES = tuple(names_of(rig_columns()))
NO_OFFSETS = (0.0,) * 6
"""Of the bare bar and the robot's tail, for which none are published."""


def sensor_offsets(scenario: RigScenario) -> tuple[float, ...]:
    """What the force sensor was zeroed at in an experiment (6), N and N m: add it to a reading."""
    return scenario.cheetah_tail.offsets if scenario.has_cheetah_tail else NO_OFFSETS


def rig_log_metadata(scenario: RigScenario, **facts: Any) -> dict[str, Any]:
    """Metadata of a rig log: kind, and in `extra` tail, axis, wind speed, offsets, current sampling and more facts."""
    experiment = scenario.experiment
    extra = {
        "tail": scenario.tail_name,
        "axis": experiment.axis if scenario.has_cheetah_tail else "none",
        "wind_speed_m_per_s": experiment.wind_speed,
        "offsets_to_add": list(sensor_offsets(scenario)),
        "current_sampling": "mean",
        **facts,
    }
    return run_metadata(scenario.resolved(), scenario.seed, kind=experiment.kind, extra=extra)


def known_truth(scenario: RigScenario) -> dict[str, float]:
    """What the fits of a simulated log should find, by their names and in their units; without the holding current."""
    experiment, aero = scenario.experiment, scenario.aero
    if experiment.kind == "static":
        drag, lift = static_coefficients(scenario)
        return {"cd": drag, "cl": lift, "psi3": scenario.tunnel.psi3}
    if experiment.kind == "swing":
        return {"added_mass": aero.added_mass}
    friction = scenario.robot_friction if scenario.is_robot else scenario.friction
    return {"coulomb": friction.coulomb, "viscous": friction.viscous}


def static_coefficients(scenario: RigScenario) -> tuple[float, float]:
    """C_D and C_L at the wind speed and the angle of attack of a static hold."""
    speed, tunnel = scenario.experiment.wind_speed, scenario.tunnel
    attack = math.asin(abs(math.sin(scenario.experiment.angle + tunnel.misalignment)) * math.cos(tunnel.psi3))
    law, _ = rig_law(scenario)
    assert isinstance(law, PolarLaw)
    drag, lift = (value(speed, attack) if callable(value) else value for value in (law.drag, law.lift))
    return float(drag), float(lift)


def simulate_static_log(scenario: RigScenario, rig: Rig | None = None, calm: Rig | None = None) -> RunLog:
    """The log of a static hold, with a rest without wind in front when `experiment.wind_off` asks for one.

    The wind is there at once after the rest, and the motor holds the angle throughout.

    Args:
        scenario: `experiment.kind` must be `static`; its seed gives bias, drift and noise.
        rig: of the same scenario, when there is one already.
        calm: the same without wind, likewise; asked only for a rest.

    Returns:
        A log whose `extra` has, beside what every rig log has, `truth` (cd, cl, psi3, current in A), `true_wrench` in
        the wind (6), `bias` (6, N and N m), `exposed`, and after a rest `rest_s`, its first and last time.

    Raises:
        UserError: holding takes a current beyond the limit.
        ModelError: see `add_rig_plant`.
    """
    rig = rig or Rig(scenario)
    experiment, sensor = scenario.experiment, scenario.force_sensor
    current, wrench = _hold(rig, experiment.angle)
    rate = scenario.simulation.log_rate
    count = round(experiment.duration * rate) + 1
    time = np.arange(count) / rate
    sampled = int(np.floor(time[-1] * sensor.rate + 1e-6)) + 1
    currents, wrenches = np.full(count, current), np.tile(wrench, (sampled, 1))
    facts: dict[str, Any] = {}
    if experiment.wind_off > 0.0:
        still_current, still = _hold(calm or Rig(scenario.varied(experiment={"wind_speed": 0.0})), experiment.angle)
        wrenches[np.arange(sampled) / sensor.rate <= experiment.wind_off + 1e-9] = still
        resting = time <= experiment.wind_off + 1e-9
        currents[resting] = still_current
        facts["rest_s"] = [0.0, float(time[resting][-1])]
    samples = sensor_readings(wrenches, sampled, sensor, sensor_offsets(scenario), scenario.seed)
    table = np.empty((count, len(RIG_COLUMN_NAMES)))
    table[:, 0] = time
    table[:, 1] = quantise(experiment.angle, count_angle(scenario))
    table[:, 2] = 0.0
    table[:, 3] = (
        currents + scenario.maxon.current_noise * CounterNoise(scenario.seed, "maxon_current", 1).first(count)[:, 0]
    )
    table[:, 4:] = samples[np.floor(time * sensor.rate + 1e-6).astype(int)]
    metadata = rig_log_metadata(
        scenario,
        truth={**known_truth(scenario), "current": current},
        true_wrench=wrench.tolist(),
        bias=sensor_errors(sensor, scenario.seed).bias.tolist(),
        exposed=rig.is_exposed(experiment.angle),
        **facts,
    )
    return run_log_from_metadata(pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), metadata)


def _hold(rig: Rig, angle: float) -> tuple[float, np.ndarray]:
    """Current (A) that holds an angle (rad), and the wrench of the support then (6)."""
    current = rig.holding_current(angle)
    return current, rig.reaction_at_current(angle, 0.0, current).wrench


INTEGRATOR = "runge_kutta3"
"""With a fixed step: 7e-7 rad after a second at 1 ms, on tables with kinks."""


def run_rig(
    scenario: RigScenario,
    log: str | Path | None,
    *,
    force: bool = False,
    interface: RigInterfaceFactory | None = None,
    view: LiveView | None = None,
) -> RunLog:
    """Runs the experiment of a scenario; its log is in the rig schema. See `simulate`.

    Args:
        scenario: resolved rig scenario.
        log: the Parquet file to be; None keeps the log in memory.
        force: replace an existing log.
        interface: None simulates; a factory (from `hardware`) talks to the robot-tail rig.
        view: of a swing.

    Raises:
        UserError: the tail leaves its range, holding takes too much current, unwritable or existing log.
    """
    if scenario.experiment.kind == "static":
        held = simulate_static_log(scenario)
        return held if log is None else read_run_log(write_run_log(held, log, force=force))
    view = view or LiveView()
    builder, station = assemble_rig(scenario, interface, view.meshcat)
    signals = signals_of({**RIG_PORTS, **RIG_TRUTH}, output_ports(station))
    facts: dict[str, Any] = {}
    if interface is None:
        facts["truth"] = known_truth(scenario)
        facts["bias"] = sensor_errors(scenario.force_sensor, scenario.seed).bias.tolist()
    metadata = rig_log_metadata(scenario, **facts)
    with open_log(log, recorded_columns(signals), metadata, force) as rows:
        RunRecorder.add_to_builder(builder, rows, signals, scenario.simulation.log_rate, with_samples=True)
        simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(simulator, INTEGRATOR, scenario.simulation.step)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
        margin = 0.5 * scenario.simulation.step
        view.run(simulator, scenario.experiment.duration, margin=margin, check=_range_check(scenario, station))
    return rows.run_log()


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


def _range_check(scenario: RigScenario, station: Diagram) -> Check:
    """Refuses a tail that leaves its range."""
    limit, state = scenario.mount.angle_limit, station.GetOutputPort("rig_state")

    def check(context: Context) -> None:
        reported = vector_of(state, station.GetMyContextFromRoot(context))
        angle = float(reported[0])
        if abs(angle) > limit:
            raise UserError(
                f"the tail left its range at {context.get_time():.2f} s: {angle:g} rad; allowed: within "
                f"mount.angle_limit, +-{limit:g} rad"
            )

    return check
