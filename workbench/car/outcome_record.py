"""Record of what outcome and metrics of a run need, made without Python at any step.

Drake's own loggers keep the ports that are plain vectors: what the sensors hold, the state of the
plant, the torques on the tail's joints. All else is computed from them after the run, for all rows
at once: motion of the chassis, forces of the ground, whether and when the car has flipped.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import VectorLogSink

from aerodima.workbench.car.car_sensors import ChassisMotion, felt_at, in_body
from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.car.ground_loads import GroundLoads
from aerodima.workbench.car.ground_truth import BODY_TRUTH
from aerodima.workbench.car.plant_ports import tail_rate_places
from aerodima.workbench.car.termination import STOPPED, quaternion_flipped
from aerodima.workbench.car.tip_up import LIFT_COLUMNS
from aerodima.workbench.car.turn_signals import settled_row
from aerodima.workbench.car.verdict import CALM_FOR, CALM_SPIN
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.core.array_types import (
    ArrayPair,
    BoolArray,
    FloatArray,
    IntArray,
    NamedArrays,
)
from aerodima.workbench.core.elementwise import roll_pitch_yaw, rotation_rows
from aerodima.workbench.core.event_order import row_period
from aerodima.workbench.core.port_wiring import add_and_connect, add_selector, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, TIME, WHEELS

Signals = Sequence[tuple[Any, Sequence[str]]]

COSTLY = ("roll_estimate", "status", "tail_pitch_torque", "tail_roll_torque")
"""Beginnings of the names of columns that are not recorded: a Python system would compute them at
every row and no metric needs them, or they can be had more cheaply."""
SETTLED = "settled_s"
"""Key in `extra` of a log that ends once the car has settled after its turn: the time of its last
row, s."""

CONTACT_COLUMNS = (
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
    *(f"ground_contact_{part}_truth_n" for part in GROUND_CONTACTS),
)


class OutcomeRecord:
    """Loggers on the ports of a station and its controllers, and the table that they make after the
    run.

    Args:
        builder: builder of the diagram that holds the station.
        station: simulated station, without the truth for a log.
        scenario: scenario of the station.
        signals: ports with their column names (`car_diagram.assemble`); those that cost Python at
            every row are left out.
    """

    def __init__(
        self, builder: DiagramBuilder, station: Diagram, scenario: Scenario, signals: Signals
    ) -> None:
        self._scenario = scenario
        self._station = station
        self._car = simulated_car(station)
        self._plant = self._car.plant
        self._rate = scenario.simulation.log_rate
        step = scenario.simulation.step
        cheap = [(port, names) for port, names in signals if _is_cheap(names)]
        self._names = [name for _, names in cheap for name in names]
        # One logger for all ports, since every logger takes time at every instant of the diagram.
        self._rows = add_and_connect(
            builder, VectorLogSink(len(self._names), publish_period=row_period(self._rate, step))
        )
        steps = [station.GetOutputPort("plant_state_truth")]
        self._has_tail = station.HasOutputPort("last_tail_torque_truth")
        if self._has_tail:
            steps.append(station.GetOutputPort("last_tail_torque_truth"))
        size = sum(port.size() for port in steps)
        self._steps_log = add_and_connect(builder, VectorLogSink(size, publish_period=step))
        logged = add_selector(
            builder, "logged", {"rows": [port for port, _ in cheap], "steps": steps}
        )
        for name, log in (("rows", self._rows), ("steps", self._steps_log)):
            builder.Connect(logged.GetOutputPort(name), log.get_input_port())
        self._loads = GroundLoads(self._car)
        chassis = self._plant.GetBodyByName("chassis")
        q = chassis.floating_positions_start()
        v = self._plant.num_positions() + chassis.floating_velocities_start_in_v()
        self._quaternion = slice(q, q + 4)
        self._position = slice(q + 4, q + 7)
        self._spin = slice(v, v + 3)
        self._velocity = slice(v, v + 6)
        still = not station.HasOutputPort("wind_truth")
        self._look_back = CALM_FOR + 0.05 + 1.0 / self._rate
        self._may_settle = still and scenario.manoeuvre.kind == "turn"

    def is_certain(self, context: Context, turn_end: float) -> bool:
        """Returns whether the run may end: the car has flipped, or has settled after a single turn
        in still air.

        Args:
            context: context of the whole diagram.
            turn_end: time from which the run may end, s.
        """
        state, time = self._log(context)
        if self._over(state, time, turn_end).any():
            return True
        return self._may_settle and self._is_calm(context, turn_end)

    def _is_calm(self, context: Context, since: float) -> bool:
        """Returns whether the car has just been calm, looking no further back than `since`, s."""
        state, time = self._log(context)
        first = int(np.searchsorted(time, max(since, time[-1] - self._look_back)))
        if first == time.size or np.sum(state[self._spin, -1] ** 2) > CALM_SPIN**2:
            return False
        motion = self._motion(context, state, slice(first, None))
        since = time[first]
        pressed = dict.fromkeys(CONTACT_COLUMNS, np.full(time.size - first, math.inf))
        if settled_row(motion | pressed, since) is None:
            return False  # the forces of the ground cost most and would not change this
        contacts = self._contacts(state, self._steps(time[first:]))
        return settled_row(motion | contacts, since) is not None

    def table(self, context: Context, stop_after: float) -> tuple[pd.DataFrame, dict[str, float]]:
        """Returns a table with one row per log time and the columns of a run log, up to the row at
        which a `FlipWatch` would stop; and for `extra` of the log, when and why the run ended
        before its time.

        Args:
            context: context of the whole diagram at the end of the run.
            stop_after: time from which a flipped car ends the table, s.
        """
        state, time = self._log(context)
        over = self._over(state, time, stop_after)
        rows = slice(0, time.size)
        if over.any():
            rows = slice(0, int(np.argmax(over)) + 1)
        steps = self._steps(time[rows])
        lifts = self._loads.lifts(state[: self._plant.num_positions(), steps])
        columns = self._motion(context, state, rows) | self._contacts(state, steps)
        table = pd.DataFrame(columns | dict(zip(LIFT_COLUMNS, lifts, strict=True)))
        end = float(table[TIME].iloc[-1])
        if over.any():
            return table, {STOPPED: end}
        if end < run_time(self._scenario) - 1.0 / self._rate:
            return table, {SETTLED: end}
        return table, {}

    def _log(self, context: Context) -> ArrayPair:
        """Returns [q; v] of the plant at every step, and the time of each row, s."""
        state = self._steps_log.FindLog(context).data()[: self._plant.num_multibody_states()]
        return state, np.arange(self._rows.FindLog(context).num_samples()) / self._rate

    def _over(self, state: FloatArray, time: FloatArray, stop_after: float) -> BoolArray:
        """Returns, row by row, whether the car has flipped and its run is over."""
        rotations = state[self._quaternion][:, self._steps(time)]
        return np.logical_or.accumulate(quaternion_flipped(rotations)) & (time >= stop_after)

    def _steps(self, time: FloatArray) -> IntArray:
        """Returns the step of the plant that a row shows: between two steps the one that began."""
        return np.ceil(time / self._scenario.simulation.step - 1e-6).astype(int)

    def _motion(self, context: Context, state: FloatArray, rows: slice) -> NamedArrays:
        """Returns all columns but the forces of the ground."""
        _, times = self._log(context)
        time = times[rows]
        steps = self._steps(time)
        columns: NamedArrays = {TIME: time}
        columns |= dict(zip(self._names, self._rows.FindLog(context).data()[:, rows], strict=True))
        return columns | self._body(state, steps) | self._tail(state, steps, context)

    def _body(self, states: FloatArray, steps: IntArray) -> NamedArrays:
        """Returns the motion of the chassis, by the definitions of `ground_truth.CarTruth`."""
        step = self._scenario.simulation.step
        state = states[:, steps]
        velocity = state[self._velocity]
        change = (velocity - states[self._velocity, np.maximum(steps - 1, 0)]) / step
        R_WB: Any = rotation_rows(state[self._quaternion])
        motion = ChassisMotion(R_WB, velocity[:3], change[:3], change[3:])
        gyro, acceleration = felt_at(motion, (self._scenario.imu.x, 0.0, self._scenario.imu.z))
        roll, pitch, yaw = roll_pitch_yaw(R_WB)
        columns = [
            *state[self._position],
            roll,
            pitch,
            np.unwrap(yaw),
            np.arccos(np.clip(R_WB[2][2], -1.0, 1.0)),
            *in_body(R_WB, velocity[3:]),
            *gyro,
            *acceleration,
        ]
        # The last fields are the centre of mass, which no metric needs.
        return dict(zip(BODY_TRUTH.fields, columns, strict=False))

    def _tail(self, states: FloatArray, steps: IntArray, context: Context) -> NamedArrays:
        """Returns torques of the tail motors in the step that begins, N m, and their power, W."""
        names = ("tail_pitch_torque_n_m", "tail_roll_torque_n_m")
        if not self._has_tail:
            return {name: np.zeros(steps.size) for name in names}
        # At a step the log holds the torques of the step before. Those of the step that begins at
        # the end of the run come from the port, since that step has not been taken.
        port = self._station.GetOutputPort("tail_torque")
        at_end = vector_of(port, self._station.GetMyContextFromRoot(context))
        last = self._steps_log.FindLog(context).data()[self._plant.num_multibody_states() :]
        torques = np.column_stack((last[:, 1:], at_end))[:, steps]
        rates = states[tail_rate_places(self._plant)][:, steps]
        columns = dict(zip(names, torques, strict=True))
        columns["tail_power_truth_w"] = np.sum(torques * rates, axis=0)
        return columns

    def _contacts(self, states: FloatArray, steps: IntArray) -> NamedArrays:
        """Returns vertical ground forces in the step before a row, N; 0 before the first step."""
        positions = states[: self._plant.num_positions()]
        forces = self._loads.forces(positions[:, np.maximum(steps - 1, 0)], positions[:, steps])
        forces[:, steps == 0] = 0.0
        return dict(zip(CONTACT_COLUMNS, forces, strict=True))


def _is_cheap(names: Sequence[str]) -> bool:
    return not (
        names[0].startswith(COSTLY) or any("_truth_" in name or "plant_" in name for name in names)
    )
