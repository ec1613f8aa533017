"""The rig behind its ports: simulated plant with motor and sensors, or the interface to the real
rig.

Both export the same ports (design section 9). The robot-tail rig has its AK70-10 on the bus and can
be swapped for hardware; the cheetah rig takes a current and exists in simulation only. The
simulated station adds ports whose names end in `_truth`.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from pydrake.geometry import Meshcat, MeshcatVisualizer
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
    System,
)

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.car.ak70 import MitMotor
from aerodima.workbench.car.car_sensors import MotorEncoder, MotorReply
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_contract import add_status, export_interface, export_outputs
from aerodima.workbench.core.port_wiring import PortSlice, add_and_connect, concatenate, vector_of
from aerodima.workbench.core.system_lifetime import weak_callback
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.rig.rig_layout import rig_law
from aerodima.workbench.rig.rig_plant import Rig, add_rig_plant
from aerodima.workbench.rig.rig_sensors import (
    RigEncoder,
    RigSensor,
    current_errors,
    force_errors,
    quantise,
)
from aerodima.workbench.scenario.rig_scenario import MaxonParameters, RigScenario
from aerodima.workbench.scenario.signal_table import (
    RIG_OUTPUTS,
    RIG_STATUS,
    ROBOT_RIG_INPUTS,
    names_of,
    rig_columns,
)

RIG_COLUMN_NAMES = tuple(names_of(rig_columns()))
NO_OFFSETS = (0.0,) * 6
"""Offsets of the bare bar and the robot's tail, for which none are published."""
RigInterfaceFactory = Callable[[RigScenario], System]
"""Makes the system that talks to the real rig, with exactly the ports of `ROBOT_RIG_INPUTS` and
`RIG_OUTPUTS`."""


class MaxonMotor(LeafSystem):
    """Current to torque on the bar: torque = -k_t N current, since a positive current pushes the
    tail upstream.

    The current loop is taken as ideal inside the limit of the amplifier. The reflected rotor
    inertia is part of the plant (cheetah_rig.sdf). A NaN in the command gives no current.

    Input ports:
        current_command (1): A.
    Output ports:
        torque (1): N m along the joint axis; positive swings downstream.
        current (1): A, after the limit.
    """

    def __init__(self, settings: MaxonParameters):
        super().__init__()
        self._settings = settings
        self._command = self.DeclareVectorInputPort("current_command", 1)
        ticket = {self._command.ticket()}
        self.DeclareVectorOutputPort("torque", 1, weak_callback(self._calc_torque), ticket)
        self.DeclareVectorOutputPort("current", 1, weak_callback(self._calc_current), ticket)

    def current(self, command: float) -> float:
        """Current that flows at a command, A."""
        limit = self._settings.current_limit
        if command == command:
            return min(max(command, -limit), limit)
        return 0.0

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        command = vector_of(self._command, context)
        output.SetFromVector(
            np.array([-self._settings.torque_constant * self.current(float(command[0]))])
        )

    def _calc_current(self, context: Context, output: BasicVector) -> None:
        command = vector_of(self._command, context)
        output.SetFromVector(np.array([self.current(float(command[0]))]))


def sensor_offsets(scenario: RigScenario) -> tuple[float, ...]:
    """What the force sensor was zeroed at in an experiment (6), N and N m: add it to a reading."""
    return scenario.cheetah_tail.offsets if scenario.has_cheetah_tail else NO_OFFSETS


def rig_log_metadata(scenario: RigScenario, **facts: Any) -> dict[str, Any]:
    """Metadata of a rig log: kind, and in `extra` tail, axis, wind speed, offsets, current sampling
    and more facts.
    """
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
    """What the fits of a simulated log should find, by their names and in their units; without the
    holding current.
    """
    experiment = scenario.experiment
    aero = scenario.aero
    if experiment.kind == "static":
        drag, lift = static_coefficients(scenario)
        return {"cd": drag, "cl": lift, "psi3": scenario.tunnel.psi3}
    if experiment.kind == "swing":
        return {"added_mass": aero.added_mass}
    friction = scenario.joint_friction
    return {"coulomb": friction.coulomb, "viscous": friction.viscous}


def static_coefficients(scenario: RigScenario) -> tuple[float, float]:
    """C_D and C_L at the wind speed and the angle of attack of a static hold."""
    speed = scenario.experiment.wind_speed
    tunnel = scenario.tunnel
    attack = math.asin(
        abs(math.sin(scenario.experiment.angle + tunnel.misalignment)) * math.cos(tunnel.psi3)
    )
    law, _ = rig_law(scenario)
    assert isinstance(law, PolarLaw)
    drag, lift = (
        value(speed, attack) if callable(value) else value for value in (law.drag, law.lift)
    )
    return float(drag), float(lift)


def simulate_static_log(
    scenario: RigScenario, rig: Rig | None = None, calm: Rig | None = None
) -> RunLog:
    """The log of a static hold, with a rest without wind in front when `experiment.wind_off` asks
    for one.

    The wind is there at once after the rest, and the motor holds the angle throughout.

    Args:
        scenario: `experiment.kind` must be `static`; its seed gives bias, drift and noise.
        rig: of the same scenario, when there is one already.
        calm: the same without wind, likewise; asked only for a rest.

    Returns:
        A log whose `extra` has, beside what every rig log has, `truth` (cd, cl, psi3, current in
        A), `true_wrench` in the wind (6), `bias` (6, N and N m), `exposed`, and after a rest
        `rest_s`, its first and last time.

    Raises:
        UserError: holding takes a current beyond the limit.
        ModelError: see `add_rig_plant`.
    """
    rig = rig or Rig(scenario)
    experiment = scenario.experiment
    sensor = scenario.force_sensor
    current, wrench = _hold(rig, experiment.angle)
    rate = scenario.simulation.log_rate
    count = round(experiment.duration * rate) + 1
    time = np.arange(count) / rate
    sampled = int(np.floor(time[-1] * sensor.rate + 1e-6)) + 1
    currents = np.full(count, current)
    wrenches = np.tile(wrench, (sampled, 1))
    facts: dict[str, Any] = {}
    if experiment.wind_off > 0.0:
        still_current, still = _hold(
            calm or Rig(scenario.varied(experiment={"wind_speed": 0.0})), experiment.angle
        )
        wrenches[np.arange(sampled) / sensor.rate <= experiment.wind_off + 1e-9] = still
        resting = time <= experiment.wind_off + 1e-9
        currents[resting] = still_current
        facts["rest_s"] = [0.0, float(time[resting][-1])]
    errors = force_errors(sensor, sensor_offsets(scenario), scenario.seed)
    samples = errors.first_readings(wrenches, sampled, sensor.rate)
    table = np.empty((count, len(RIG_COLUMN_NAMES)))
    table[:, 0] = time
    table[:, 1] = quantise(experiment.angle, scenario.count_angle)
    table[:, 2] = 0.0
    noisy = current_errors(scenario.maxon.current_noise, scenario.seed).first_readings(
        currents[:, None], count, rate
    )
    table[:, 3] = noisy[:, 0]
    table[:, 4:] = samples[np.floor(time * sensor.rate + 1e-6).astype(int)]
    metadata = rig_log_metadata(
        scenario,
        truth={**known_truth(scenario), "current": current},
        true_wrench=wrench.tolist(),
        bias=errors.bias.tolist(),
        exposed=rig.is_exposed(experiment.angle),
        **facts,
    )
    return run_log_from_metadata(pd.DataFrame(table, columns=list(RIG_COLUMN_NAMES)), metadata)


def _hold(rig: Rig, angle: float) -> tuple[float, np.ndarray]:
    """Current (A) that holds an angle (rad), and the wrench of the support then (6)."""
    current = rig.holding_current(angle)
    return current, rig.reaction_at_current(angle, 0.0, current).wrench


def make_rig_station(
    scenario: RigScenario,
    interface: RigInterfaceFactory | None = None,
    meshcat: Meshcat | None = None,
) -> Diagram:
    """The station of a rig scenario as a diagram.

    Ports: in `tail_command` (5) of the robot-tail rig or `current_command` (1) of the cheetah rig;
    out `rig_state` (2), `motor_current` (1), `force_torque` (6), `status` (7), and in simulation
    `state_truth` (2), `wrench_truth` (6), `motor_torque_truth` (1), and with a tail
    `tail_sections_truth` (4 per section).

    Args:
        scenario: what to simulate, or what to drive.
        interface: None simulates; a factory (from `hardware`) talks to the robot-tail rig.
        meshcat: shows the simulated rig live.

    Raises:
        ModelError: a model does not load with the numbers of the scenario.
        UserError: the interface has other ports than the station must have, or is for a rig that
            has no hardware.
    """
    builder = DiagramBuilder()
    if interface is None:
        _simulate(builder, scenario, meshcat)
    elif not scenario.is_robot:
        raise UserError(
            f"experiment.kind: {scenario.experiment.kind!r} has no hardware interface; allowed "
            "with one: 'robot_swing'"
        )
    else:
        export_interface(builder, interface(scenario), ROBOT_RIG_INPUTS, RIG_OUTPUTS)
    station = builder.Build()
    station.set_name("rig_station")
    return station


def _simulate(builder: DiagramBuilder, scenario: RigScenario, meshcat: Meshcat | None) -> None:
    rig = add_rig_plant(builder, scenario, scene_graph=meshcat is not None)
    state = rig.plant.get_state_output_port()
    motor = _add_motor(builder, scenario, state)
    builder.Connect(motor.GetOutputPort("torque"), rig.torques.get_input_port(0))
    reported, age = _add_encoder(builder, scenario, state)
    step = scenario.simulation.step
    rate = scenario.robot.command_rate if scenario.is_robot else scenario.encoder.rate
    errors = current_errors(
        0.0 if scenario.is_robot else scenario.maxon.current_noise, scenario.seed
    )
    current = RigSensor("motor_current", rate, errors, step)
    add_and_connect(builder, current, value=motor.GetOutputPort("current"))
    sensor = scenario.force_sensor
    errors = force_errors(sensor, sensor_offsets(scenario), scenario.seed)
    force = add_and_connect(
        builder, RigSensor("force_sensor", sensor.rate, errors, step), value=rig.wrench
    )
    export_outputs(
        builder,
        {
            "rig_state": reported,
            "motor_current": current.GetOutputPort("reading"),
            "force_torque": force.GetOutputPort("reading"),
            "status": add_status(
                builder,
                RIG_STATUS,
                {"motor_age": age, "force_age": force.GetOutputPort("age")},
                healthy=("motor_fault", "force_fault", "operator_age", "operator_fault"),
            ),
            "state_truth": state,
            "wrench_truth": rig.wrench,
            "motor_torque_truth": motor.GetOutputPort("torque"),
        },
    )
    if rig.tail_force is not None:
        builder.ExportOutput(rig.tail_force.GetOutputPort("sections"), "tail_sections_truth")
    if meshcat is not None:
        assert rig.scene_graph is not None
        MeshcatVisualizer.AddToBuilder(builder, rig.scene_graph, meshcat)


def _add_motor(builder: DiagramBuilder, scenario: RigScenario, state: OutputPort) -> System:
    if not scenario.is_robot:
        maxon = builder.AddNamedSystem("maxon", MaxonMotor(scenario.maxon))
        builder.ExportInput(maxon.GetInputPort("current_command"), "current_command")
        return maxon
    motor = builder.AddNamedSystem(
        "ak70", MitMotor(scenario.robot_motor, scenario.robot.torque_constant)
    )
    builder.Connect(state, motor.GetInputPort("joint_state"))
    builder.ExportInput(motor.GetInputPort("tail_command"), "tail_command")
    return motor


def _add_encoder(
    builder: DiagramBuilder, scenario: RigScenario, state: OutputPort
) -> tuple[OutputPort, OutputPort]:
    """Reported angle and rate (2), and the age of that sample (1)."""
    if not scenario.is_robot:
        encoder = RigEncoder(scenario.encoder, scenario.count_angle, scenario.simulation.step)
        add_and_connect(
            builder, encoder, joint_angle=concatenate(builder, "joint_angle", [(state, [0])])
        )
        both = concatenate(
            builder, "rig_state", [encoder.GetOutputPort(name) for name in ("angle", "rate")]
        )
        return both, encoder.GetOutputPort("age")
    reply = MotorReply(scenario.robot_motor.position_range, scenario.robot_motor.speed_range)
    replies = MotorEncoder(scenario.robot.command_rate, reply, step=scenario.simulation.step)
    add_and_connect(
        builder, replies, joints=concatenate(builder, "joint_twice", [(state, [0, 0, 1, 1])])
    )
    ones: list[PortSlice] = [(replies.GetOutputPort(name), [0]) for name in ("angles", "rates")]
    return concatenate(builder, "rig_state", ones), replies.GetOutputPort("age")
