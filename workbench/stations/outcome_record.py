"""What outcome and metrics of a run need, recorded without Python at every step wherever Drake can do it.

Drake's own loggers keep the ports that are plain vectors: what the sensors hold, state and acceleration of the plant,
actuation of the tail. Motion of the chassis and torques of the tail motors are computed from them after the run, for
all rows at once. Contacts alone are read while the run goes on, and so is whether the car has flipped.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import GROUND_CONTACTS, TIME, WHEELS
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.plants.joint_friction import smooth_friction
from aerodima.workbench.stations.car_station import simulated_car
from aerodima.workbench.stations.ground_truth import contact_slots, ground_forces
from aerodima.workbench.systems.event_order import Stage, nominal_time, period_of

Signals = Sequence[tuple[Any, Sequence[str]]]

COSTLY = ("roll_estimate", "status", "tail_pitch_torque", "tail_roll_torque")
"""How columns begin that a Python system would compute at every row and no metric needs, or that come cheaper."""

STOPPED = "stopped_at_flip_s"
"""Key in `extra` of a log that ends at a flip: the time of its last row, s."""

CONTACT_COLUMNS = (
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
    *(f"ground_contact_{part}_truth_n" for part in GROUND_CONTACTS),
)


class FlipWatch(LeafSystem):
    """Stops a run once the car has flipped; keeps the contact forces on the way there if asked.

    Input ports:
        plant_state: [q; v] of the plant.
        contact_results: ContactResults, from the plant.

    Args:
        station: simulated station.
        rate: looks per second, Hz.
        stop_after: s; a flipped car ends the run from then on. Infinite: never.
        contacts: whether the contact forces are kept.
    """

    def __init__(self, station: Diagram, rate: float, stop_after: float, contacts: bool) -> None:
        super().__init__()
        car = simulated_car(station)
        self._slots = contact_slots(car)
        self._quaternion = car.plant.GetBodyByName("chassis").floating_positions_start()
        self._stop_after, self._keeps, self._rate = stop_after, contacts, rate
        self._cos_flip = float(np.cos(FLIP_TILT))
        self._flipped = False
        self.stopped: float | None = None
        self.contacts: list[list[float]] = []
        self._state = self.DeclareVectorInputPort("plant_state", car.plant.num_multibody_states())
        self._results = self.DeclareAbstractInputPort("contact_results", Value(ContactResults()))
        self.DeclarePeriodicPublishEvent(period_of(rate, Stage.RECORD), 0.0, self._look)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, station: Diagram, rate: float, *, stop_after: float, contacts: bool
    ) -> "FlipWatch":
        """Adds a watch to the diagram of a simulated station."""
        watch = cls(station, rate, stop_after, contacts)
        builder.AddNamedSystem("flip_watch", watch)
        for name in ("plant_state", "contact_results"):
            builder.Connect(station.GetOutputPort(f"{name}_truth"), watch.GetInputPort(name))
        return watch

    def facts(self) -> dict[str, float]:
        """For `extra` of the log: when the watch ended the run, if it did."""
        return {} if self.stopped is None else {STOPPED: self.stopped}

    def _look(self, context: Context) -> EventStatus:
        state: Any = self._state.Eval(context)
        w, x, y, z = state[self._quaternion : self._quaternion + 4].tolist()
        square = w * w + x * x + y * y + z * z
        self._flipped = self._flipped or 1.0 - 2.0 * (x * x + y * y) / square < self._cos_flip
        if self._keeps:
            self.contacts.append(self._forces(context))
        time = nominal_time(context.get_time(), self._rate)
        if self._flipped and time >= self._stop_after:
            self.stopped = time
            return EventStatus.ReachedTermination(self, "the car has flipped")
        return EventStatus.Succeeded()

    def _forces(self, context: Context) -> list[float]:
        results: Any = self._results.Eval(context)
        found = dict.fromkeys((*WHEELS, *GROUND_CONTACTS), 0.0)
        for slot, force, _ in ground_forces(results, self._slots):
            if slot in GROUND_CONTACTS:
                found[slot] += float(np.linalg.norm(force))
            else:
                found[slot] += float(force[2])
        return list(found.values())


class OutcomeRecord:
    """Loggers on the ports of a station and its controllers, and the table that they make after the run.

    Args:
        builder: of the diagram that holds the station.
        station: simulated.
        scenario: of the station.
        signals: ports with their column names (`run.assemble`); those that cost Python at every row are left out.
        watch: that keeps the contacts.
    """

    def __init__(
        self, builder: DiagramBuilder, station: Diagram, scenario: Scenario, signals: Signals, watch: FlipWatch
    ) -> None:
        self._scenario, self._watch = scenario, watch
        self._plant = simulated_car(station).plant
        self._rate = scenario.simulation.log_rate
        self._sinks: list[tuple[VectorLogSink, Sequence[str]]] = [
            (self._log(builder, port), names) for port, names in signals if _is_cheap(names)
        ]
        self._state = self._log(builder, station.GetOutputPort("plant_state_truth"))
        self._acceleration = self._log(builder, station.GetOutputPort("plant_acceleration_truth"))
        has_tail = station.HasOutputPort("tail_actuation_truth")
        self._actuation = self._log(builder, station.GetOutputPort("tail_actuation_truth")) if has_tail else None

    def table(self, context: Context) -> pd.DataFrame:
        """One row per log time, columns as in a run log.

        Args:
            context: of the whole diagram, at the end of the run.
        """
        state_log = self._state.FindLog(context)
        columns: dict[str, FloatArray] = {TIME: np.rint(state_log.sample_times() * self._rate) / self._rate}
        for sink, names in self._sinks:
            columns |= dict(zip(names, sink.FindLog(context).data(), strict=True))
        state, acceleration = state_log.data(), self._acceleration.FindLog(context).data()
        columns |= self._body(state, acceleration)
        if self._actuation is not None:
            columns |= self._tail(state, self._actuation.FindLog(context).data())
        else:
            columns |= {f"tail_{joint}_torque_n_m": np.zeros(state.shape[1]) for joint in ("pitch", "roll")}
        columns |= dict(zip(CONTACT_COLUMNS, np.array(self._watch.contacts).T, strict=True))
        return pd.DataFrame(columns)

    def _log(self, builder: DiagramBuilder, port: Any) -> VectorLogSink:
        return LogVectorOutput(port, builder, publish_period=period_of(self._rate, Stage.RECORD))

    def _body(self, state: FloatArray, acceleration: FloatArray) -> dict[str, FloatArray]:
        """Motion of the chassis; the definitions of `truth.CarTruth` and `sensors.imu.motion_at_imu`."""
        chassis = self._plant.GetBodyByName("chassis")
        q, v = chassis.floating_positions_start(), chassis.floating_velocities_start_in_v()
        start = self._plant.num_positions() + v
        R_WB = _rotations(state[q : q + 4])
        w_WB, v_WB = (np.einsum("jin,jn->in", R_WB, state[start + part : start + part + 3]) for part in (0, 3))
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

    def _tail(self, state: FloatArray, actuation: FloatArray) -> dict[str, FloatArray]:
        """Torques of the motors, N m: the actuation of the joints without their friction; and the motors' power."""
        friction = self._scenario.friction
        law = np.vectorize(smooth_friction(friction.coulomb, friction.viscous, friction.tanh_gain), otypes=[float])
        joints = [self._plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")]
        rates = state[[self._plant.num_positions() + joint.velocity_start() for joint in joints]]
        torques = actuation - law(rates)
        return {
            "tail_pitch_torque_n_m": torques[0],
            "tail_roll_torque_n_m": torques[1],
            "tail_power_truth_w": np.sum(torques * rates, axis=0),
        }


def _is_cheap(names: Sequence[str]) -> bool:
    return not (names[0].startswith(COSTLY) or any("_truth_" in name or "plant_" in name for name in names))


def _rotations(quaternions: FloatArray) -> FloatArray:
    """Rotation matrices, shape (3, 3, n), of quaternions w, x, y, z, shape (4, n), of any length."""
    w, x, y, z = quaternions
    scale = 2.0 / np.sum(quaternions**2, axis=0)
    return np.array(
        [
            [1.0 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)],
            [scale * (x * y + w * z), 1.0 - scale * (x * x + z * z), scale * (y * z - w * x)],
            [scale * (x * z - w * y), scale * (y * z + w * x), 1.0 - scale * (x * x + y * y)],
        ]
    )
