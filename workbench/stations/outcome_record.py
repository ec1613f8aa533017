"""What outcome and metrics of a run need, recorded without Python at any step.

Drake's own loggers keep the ports that are plain vectors: what the sensors hold, the state of the plant, the torques on
the tail's joints. All else is computed from them after the run, for all rows at once: motion of the chassis, forces of
the ground, whether and when the car has flipped.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from aerodima.workbench.aero.sail import rotation_rows
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import GROUND_CONTACTS, TIME, WHEELS
from aerodima.workbench.controllers.manoeuvre import run_time
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.metrics.turn_signals import CALM_FOR, CALM_SPIN, settled_row
from aerodima.workbench.stations.car_station import simulated_car
from aerodima.workbench.stations.ground_loads import GroundLoads
from aerodima.workbench.systems.system_ports import Stage, connected, nominal_time, period_of, stacked, vector_of

IntArray = NDArray[np.int_]
Signals = Sequence[tuple[Any, Sequence[str]]]

COSTLY = ("roll_estimate", "status", "tail_pitch_torque", "tail_roll_torque")
"""How columns begin that a Python system would compute at every row and no metric needs, or that come cheaper."""

COS_FLIP = float(np.cos(FLIP_TILT))

STOPPED = "stopped_at_flip_s"
"""Key in `extra` of a log that ends at a flip: the time of its last row, s."""

SETTLED = "settled_s"
"""Key in `extra` of a log that ends once the car has settled after its turn: the time of its last row, s."""

CONTACT_COLUMNS = (
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
    *(f"ground_contact_{part}_truth_n" for part in GROUND_CONTACTS),
)


class FlipWatch(LeafSystem):
    """Stops a run once the car has flipped.

    Input ports:
        plant_state: [q; v] of the plant.

    Args:
        station: simulated station.
        rate: looks per second, Hz.
        stop_after: s; a flipped car ends the run from then on.
    """

    def __init__(self, station: Diagram, rate: float, stop_after: float) -> None:
        super().__init__()
        plant = simulated_car(station).plant
        self._quaternion = plant.GetBodyByName("chassis").floating_positions_start()
        self._stop_after, self._rate = stop_after, rate
        self._flipped = False
        self.stopped: float | None = None
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.DeclarePeriodicPublishEvent(period_of(rate, Stage.RECORD), 0.0, self._look)

    @classmethod
    def add_to_builder(cls, builder: DiagramBuilder, station: Diagram, rate: float, stop_after: float) -> "FlipWatch":
        """Adds a watch to the diagram of a simulated station."""
        state = station.GetOutputPort("plant_state_truth")
        return connected(builder, cls(station, rate, stop_after), "flip_watch", plant_state=state)

    def facts(self) -> dict[str, float]:
        """For `extra` of the log: when the watch ended the run, if it did."""
        return {} if self.stopped is None else {STOPPED: self.stopped}

    def _look(self, context: Context) -> EventStatus:
        state = vector_of(self._state, context)
        self._flipped = self._flipped or has_flipped(state[self._quaternion : self._quaternion + 4].tolist())
        time = nominal_time(context.get_time(), self._rate)
        if not (self._flipped and time >= self._stop_after):
            return EventStatus.Succeeded()
        self.stopped = time
        return EventStatus.ReachedTermination(self, "the car has flipped")


def has_flipped(quaternion: Any) -> Any:
    """Whether a body of this orientation w, x, y, z has tilted beyond the angle of a flip; for arrays row by row."""
    w, x, y, z = quaternion
    return 1.0 - 2.0 * (x * x + y * y) / (w * w + x * x + y * y + z * z) < COS_FLIP


class OutcomeRecord:
    """Loggers on the ports of a station and its controllers, and the table that they make after the run.

    Args:
        builder: of the diagram that holds the station.
        station: simulated, without the truth for a log.
        scenario: of the station.
        signals: ports with their column names (`car_run.assemble`); those that cost Python at every row are left out.
    """

    def __init__(self, builder: DiagramBuilder, station: Diagram, scenario: Scenario, signals: Signals) -> None:
        self._scenario, self._station = scenario, station
        self._car = simulated_car(station)
        self._plant = self._car.plant
        self._rate, step = scenario.simulation.log_rate, scenario.simulation.step
        # A row with an instant of its own makes Drake look for the next event twice a step.
        period = step if math.isclose(self._rate * step, 1.0) else period_of(self._rate, Stage.RECORD)
        cheap = [(port, names) for port, names in signals if _is_cheap(names)]
        self._names = [name for _, names in cheap for name in names]
        # One logger for all ports: each has its share in every instant of the diagram.
        rows = stacked(builder, "logged_rows", [port for port, _ in cheap])
        self._rows: VectorLogSink = LogVectorOutput(rows, builder, publish_period=period)
        motion = [station.GetOutputPort("plant_state_truth")]
        self._has_tail = station.HasOutputPort("last_tail_torque_truth")
        if self._has_tail:
            motion.append(station.GetOutputPort("last_tail_torque_truth"))
        self._steps_log: VectorLogSink = LogVectorOutput(
            stacked(builder, "logged_steps", motion), builder, publish_period=step
        )
        self._loads = GroundLoads(self._car)
        chassis = self._plant.GetBodyByName("chassis")
        q = chassis.floating_positions_start()
        v = self._plant.num_positions() + chassis.floating_velocities_start_in_v()
        self._quaternion, self._spin = slice(q, q + 4), slice(v, v + 3)
        still = scenario.wind.is_still or scenario.tail.mode == "none"
        self._look_back = CALM_FOR + 0.05 + 1.0 / self._rate
        self._may_settle = still and scenario.manoeuvre.kind == "turn"

    def is_certain(self, context: Context, turn_end: float) -> bool:
        """Whether the run may end: the car has flipped, or has settled after a single turn in still air.

        Args:
            context: of the whole diagram.
            turn_end: s; from then on.
        """
        state, time = self._states(context), self._times(context)
        if self._over(state, time, turn_end).any():
            return True
        return self._may_settle and self._is_calm(context, turn_end)

    def _is_calm(self, context: Context, since: float) -> bool:
        """Whether the car has been calm in the last instants, and not before `since`, s."""
        state, time = self._states(context), self._times(context)
        first = int(np.searchsorted(time, max(since, time[-1] - self._look_back)))
        if first == time.size or np.sum(state[self._spin, -1] ** 2) > CALM_SPIN**2:
            return False
        motion, since = self._motion(context, state, slice(first, None)), time[first]
        pressed = dict.fromkeys(CONTACT_COLUMNS, np.full(time.size - first, math.inf))
        if settled_row(motion | pressed, since) is None:
            return False  # whatever the forces of the ground are, which cost most
        return settled_row(motion | self._contacts(state, self._steps(time[first:])), since) is not None

    def table(self, context: Context, stop_after: float) -> tuple[pd.DataFrame, dict[str, float]]:
        """One row per log time, columns as in a run log; up to that at which a `FlipWatch` at every row would stop.

        The second answer is for `extra` of the log: when and why the run ended before its time.

        Args:
            context: of the whole diagram, at the end of the run.
            stop_after: s; a flipped car ends the table from then on.
        """
        state, time = self._states(context), self._times(context)
        over = self._over(state, time, stop_after)
        rows = slice(0, int(np.argmax(over)) + 1 if over.any() else time.size)
        table = pd.DataFrame(self._motion(context, state, rows) | self._contacts(state, self._steps(time[rows])))
        end = float(table[TIME].iloc[-1])
        if over.any():
            return table, {STOPPED: end}
        return table, {SETTLED: end} if end < run_time(self._scenario) - 1.0 / self._rate else {}

    def _times(self, context: Context) -> FloatArray:
        return np.arange(self._rows.FindLog(context).num_samples()) / self._rate

    def _states(self, context: Context) -> FloatArray:
        """[q; v] of the plant at every step."""
        return self._steps_log.FindLog(context).data()[: self._plant.num_multibody_states()]

    def _over(self, state: FloatArray, time: FloatArray, stop_after: float) -> NDArray[np.bool_]:
        """At which rows the run of a car that has flipped is over."""
        rotations = state[self._quaternion][:, self._steps(time)]
        over: NDArray[np.bool_] = np.logical_or.accumulate(has_flipped(rotations)) & (time >= stop_after)
        return over

    def _steps(self, time: FloatArray) -> IntArray:
        """Step of the plant that a row shows: between two steps the one that has begun."""
        return np.ceil(time / self._scenario.simulation.step - 1e-6).astype(int)

    def _motion(self, context: Context, state: FloatArray, rows: slice) -> dict[str, FloatArray]:
        """All columns but the forces of the ground."""
        time = self._times(context)[rows]
        steps = self._steps(time)
        columns: dict[str, FloatArray] = {TIME: time}
        columns |= dict(zip(self._names, self._rows.FindLog(context).data()[:, rows], strict=True))
        return columns | self._body(state, steps) | self._tail(state, steps, context)

    def _body(self, states: FloatArray, steps: IntArray) -> dict[str, FloatArray]:
        """Motion of the chassis; the definitions of `ground_truth.CarTruth` and `chassis_sensors.motion_at_imu`."""
        chassis = self._plant.GetBodyByName("chassis")
        q = chassis.floating_positions_start()
        v = self._plant.num_positions() + chassis.floating_velocities_start_in_v()
        state = states[:, steps]
        acceleration = (state - states[:, np.maximum(steps - 1, 0)]) / self._scenario.simulation.step
        R_WB: FloatArray = np.array(rotation_rows(state[q : q + 4]))
        w_WB, v_WB = (np.einsum("jin,jn->in", R_WB, state[v + part : v + part + 3]) for part in (0, 3))
        alpha, a_WB = (np.einsum("jin,jn->in", R_WB, acceleration[v + part : v + part + 3]) for part in (0, 3))
        p_BoImu_B = np.array([[self._scenario.imu.x], [0.0], [self._scenario.imu.z]])
        a_WImu = a_WB + np.cross(alpha, p_BoImu_B, axis=0) + np.cross(w_WB, np.cross(w_WB, p_BoImu_B, axis=0), axis=0)
        named = {
            "roll_truth_rad": np.arctan2(R_WB[2, 1], R_WB[2, 2]),
            "pitch_truth_rad": np.arcsin(np.clip(-R_WB[2, 0], -1.0, 1.0)),
            "yaw_truth_rad": np.unwrap(np.arctan2(R_WB[1, 0], R_WB[0, 0])),
            "tilt_truth_rad": np.arccos(np.clip(R_WB[2, 2], -1.0, 1.0)),
        }
        vectors = {
            "position_{}_truth_m": state[q + 4 : q + 7],
            "velocity_{}_truth_m_per_s": v_WB,
            "gyro_{}_truth_rad_per_s": w_WB,
            "acceleration_{}_truth_m_per_s2": a_WImu,
        }
        for stem, values in vectors.items():
            named |= {stem.format(axis): values[index] for index, axis in enumerate("xyz")}
        return named

    def _tail(self, states: FloatArray, steps: IntArray, context: Context) -> dict[str, FloatArray]:
        """Torques of the tail motors in the step that begins, N m, and their power, W."""
        names = ("tail_pitch_torque_n_m", "tail_roll_torque_n_m")
        if not self._has_tail:
            return {name: np.zeros(steps.size) for name in names}
        # At a step the log has what acted in the step before; at the end of the run nobody has stepped yet.
        port = self._station.GetOutputPort("tail_torque")
        at_end = vector_of(port, self._station.GetMyContextFromRoot(context))
        last = self._steps_log.FindLog(context).data()[self._plant.num_multibody_states() :]
        torques = np.column_stack((last[:, 1:], at_end))[:, steps]
        joints = [self._plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")]
        rates = states[[self._plant.num_positions() + joint.velocity_start() for joint in joints]][:, steps]
        return dict(zip(names, torques, strict=True)) | {"tail_power_truth_w": np.sum(torques * rates, axis=0)}

    def _contacts(self, states: FloatArray, steps: IntArray) -> dict[str, FloatArray]:
        """Vertical forces of the ground in the step before each row, N; none before the first step."""
        positions = states[: self._plant.num_positions()]
        forces = self._loads.forces(positions[:, np.maximum(steps - 1, 0)], positions[:, steps])
        forces[:, steps == 0] = 0.0
        return dict(zip(CONTACT_COLUMNS, forces, strict=True))


def _is_cheap(names: Sequence[str]) -> bool:
    return not (names[0].startswith(COSTLY) or any("_truth_" in name or "plant_" in name for name in names))
