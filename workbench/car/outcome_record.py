"""What outcome and metrics of a run need, recorded without Python at any step.

Drake's own loggers keep the ports that are plain vectors: what the sensors hold, the state of the
plant, the torques on the tail's joints. All else is computed from them after the run, for all rows
at once: motion of the chassis, forces of the ground, whether and when the car has flipped.

Drake's contact results cost 40 us to read at every step, as much as the laws of all actuators; what
they say follows from the motion. A contact of Drake's lagged approximation has the penetration x at
the beginning of a step of length h and, with the velocity at its end, the rate of that penetration
x':

    f = k (x + h x')_+ (1 + d x')_+        where x > 0, else 0

with stiffness k and dissipation d of the pair, and x' that of the point where Drake puts the
contact. Shapes that touch the ground are spheres and ellipsoids.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydrake.geometry import Ellipsoid, Sphere
from pydrake.multibody.tree import BodyIndex, Joint, PrismaticJoint, RevoluteJoint, WeldJoint
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import VectorLogSink

from aerodima.workbench.aero.sail import rotation_rows
from aerodima.workbench.car.car_plant import GROUND_STIFFNESS, CarPlant
from aerodima.workbench.car.car_sensors import ChassisMotion, felt_at, in_body
from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.car.ground_truth import contact_slots
from aerodima.workbench.car.tip_up import LIFT_COLUMNS
from aerodima.workbench.car.turn_signals import settled_row
from aerodima.workbench.car.verdict import CALM_FOR, CALM_SPIN, FLIP_TILT
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.event_order import nominal_time, row_period
from aerodima.workbench.core.port_wiring import PortMux, add_and_connect, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, TIME, WHEELS

IntArray = NDArray[np.int_]
Signals = Sequence[tuple[Any, Sequence[str]]]

COSTLY = ("roll_estimate", "status", "tail_pitch_torque", "tail_roll_torque")
"""How columns begin that a Python system would compute at every row and no metric needs, or that
come cheaper."""

COS_FLIP = float(np.cos(FLIP_TILT))

STOPPED = "stopped_at_flip_s"
"""Key in `extra` of a log that ends at a flip: the time of its last row, s."""

SETTLED = "settled_s"
"""Key in `extra` of a log that ends once the car has settled after its turn: the time of its last
row, s."""

CONTACT_COLUMNS = (
    *(f"wheel_force_{wheel}_z_truth_n" for wheel in WHEELS),
    *(f"ground_contact_{part}_truth_n" for part in GROUND_CONTACTS),
)


_NUDGE = 1e-3
"""Share of a step by which the motion is varied for the rates of penetration."""

_Height = tuple[FloatArray, FloatArray]
"""The world's z axis in a body (3, n), and the height of its origin (n), m."""


@dataclass(frozen=True)
class _Shape:
    """A sphere or ellipsoid on a body: radii (3), m, rotation (3 x 3) and place (3), m, in it; k
    and d of its pair.
    """

    slot: str
    body: BodyIndex
    radii: FloatArray
    R_BG: FloatArray
    p_BoGo_B: FloatArray
    stiffness: float
    dissipation: float

    def contact(self, up: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Depth (n) in the ground, m; where Drake puts the contact on its body (3, n), m."""
        up_G = self.R_BG.T @ up
        square = self.radii[:, None] ** 2
        half = np.sqrt(np.sum(square * up_G**2, axis=0))
        depth = half - height - self.p_BoGo_B @ up
        # Half way from the deepest point to the ground, on the line to the middle of the shape.
        p_GoC_G = -square * up_G / half * (1.0 - 0.5 * depth / half)
        return depth, self.p_BoGo_B[:, None] + self.R_BG @ p_GoC_G


class GroundLoads:
    """Vertical forces of the level ground on a car, and how high its tyres are above it.

    Args:
        car: with its ground.
    """

    def __init__(self, car: CarPlant) -> None:
        self._plant = car.plant
        self._shapes = list(_shapes(car))
        plant = car.plant
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        self._inboard = {joint.child_body().index(): joint for joint in joints}

    def forces(self, before: FloatArray, after: FloatArray) -> FloatArray:
        """Forces (7, n) in the steps between two positions, N: on the wheels, then cage, board and
        tail.

        Args:
            before, after: positions (nq, n) of the plant at the beginning and the end of each step.
        """
        step = self._plant.time_step()
        change = after - before
        now, ahead, behind = (before + side * _NUDGE * change for side in (0.0, 1.0, -1.0))
        known: list[dict[BodyIndex, _Height]] = [{}, {}, {}]
        slots = (*WHEELS, *GROUND_CONTACTS)
        total = np.zeros((len(slots), before.shape[1]))
        for shape in self._shapes:
            up, height = self._height(shape.body, now, known[0])
            x, p_BoC_B = shape.contact(up, height)
            up_ahead, height_ahead = self._height(shape.body, ahead, known[1])
            up_behind, height_behind = self._height(shape.body, behind, known[2])
            later = height_ahead + np.sum(p_BoC_B * up_ahead, axis=0)
            earlier = height_behind + np.sum(p_BoC_B * up_behind, axis=0)
            rate = (earlier - later) / (2.0 * _NUDGE * step)
            force = (
                shape.stiffness
                * np.maximum(x + step * rate, 0.0)
                * np.maximum(1.0 + shape.dissipation * rate, 0.0)
            )
            total[slots.index(shape.slot)] += np.where(x > 0.0, force, 0.0)
        return total

    def lifts(self, positions: FloatArray) -> FloatArray:
        """Heights (4, n) of the lowest point of each tyre above the ground, m; not above 0 where it
        presses into it.

        Args:
            positions: of the plant (nq, n).
        """
        known: dict[BodyIndex, _Height] = {}
        lowest = np.full((len(WHEELS), positions.shape[1]), math.inf)
        for shape in self._shapes:
            if shape.slot in WHEELS:
                depth, _ = shape.contact(*self._height(shape.body, positions, known))
                wheel = WHEELS.index(shape.slot)
                lowest[wheel] = np.minimum(lowest[wheel], -depth)
        return lowest

    def _height(
        self, body: BodyIndex, positions: FloatArray, known: dict[BodyIndex, _Height]
    ) -> _Height:
        if body not in known:
            joint = self._inboard.get(body)
            if joint is None:  # the world
                return np.array([[0.0], [0.0], [1.0]]), np.zeros(1)
            parent = self._height(joint.parent_body().index(), positions, known)
            known[body] = _through(joint, *parent, positions)
        return known[body]


def _through(joint: Joint, up: FloatArray, height: FloatArray, positions: FloatArray) -> _Height:
    """From the parent of a joint to its child."""
    X_PF = joint.frame_on_parent().GetFixedPoseInBodyFrame()
    if isinstance(joint, WeldJoint):
        X_PF = X_PF.multiply(joint.X_FM())
    X_MC = joint.frame_on_child().GetFixedPoseInBodyFrame().inverse()
    height = height + X_PF.translation() @ up
    up = X_PF.rotation().matrix().T @ up
    start = joint.position_start()
    if isinstance(joint, RevoluteJoint):
        axis = joint.revolute_axis()[:, None]
        c = np.cos(positions[start])
        s = np.sin(positions[start])
        up = c * up - s * np.cross(axis, up, axis=0) + (1.0 - c) * axis * np.sum(axis * up, axis=0)
    elif isinstance(joint, PrismaticJoint):
        height = height + positions[start] * (joint.translation_axis() @ up)
    elif joint.num_positions() == 7:
        up = np.array(rotation_rows(positions[start : start + 4])[2])
        height = positions[start + 6]
    return X_MC.rotation().matrix().T @ up, height + X_MC.translation() @ up


def _shapes(car: CarPlant) -> Iterator[_Shape]:
    inspector = car.scene_graph.model_inspector()
    slots = contact_slots(car)
    for geometry in inspector.GetAllGeometryIds():
        slot = slots.get(geometry.get_value())
        if slot is None:
            continue
        shape: Any = inspector.GetShape(geometry)
        if isinstance(shape, Sphere):
            radii = np.full(3, shape.radius())
        elif isinstance(shape, Ellipsoid):
            radii = np.array([shape.a(), shape.b(), shape.c()])
        else:
            raise TypeError(
                f"{inspector.GetName(geometry)}: a {type(shape).__name__} meets the ground"
            )
        properties: Any = inspector.GetProximityProperties(geometry)
        k = properties.GetProperty("material", "point_contact_stiffness")
        d = properties.GetProperty("material", "hunt_crossley_dissipation")
        share = GROUND_STIFFNESS / (GROUND_STIFFNESS + k)
        X_BG = inspector.GetPoseInFrame(geometry)
        body = car.plant.GetBodyFromFrameId(inspector.GetFrameId(geometry)).index()
        yield _Shape(
            slot, body, radii, X_BG.rotation().matrix(), X_BG.translation(), share * k, share * d
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
        self._stop_after = stop_after
        self._rate = rate
        self._flipped = False
        self.stopped: float | None = None
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.DeclarePeriodicPublishEvent(row_period(rate, plant.time_step()), 0.0, self._look)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, station: Diagram, rate: float, stop_after: float
    ) -> "FlipWatch":
        """Adds a watch to the diagram of a simulated station."""
        state = station.GetOutputPort("plant_state_truth")
        return add_and_connect(
            builder, cls(station, rate, stop_after), "flip_watch", plant_state=state
        )

    def facts(self) -> dict[str, float]:
        """For `extra` of the log: when the watch ended the run, if it did."""
        if self.stopped is None:
            return {}
        return {STOPPED: self.stopped}

    def _look(self, context: Context) -> EventStatus:
        state = vector_of(self._state, context)
        self._flipped = self._flipped or has_flipped(
            state[self._quaternion : self._quaternion + 4].tolist()
        )
        time = nominal_time(context.get_time(), self._rate)
        if not (self._flipped and time >= self._stop_after):
            return EventStatus.Succeeded()
        self.stopped = time
        return EventStatus.ReachedTermination(self, "the car has flipped")


def has_flipped(quaternion: Any) -> Any:
    """Whether a body of this orientation w, x, y, z has tilted beyond the angle of a flip; for
    arrays row by row.
    """
    w, x, y, z = quaternion
    return 1.0 - 2.0 * (x * x + y * y) / (w * w + x * x + y * y + z * z) < COS_FLIP


class OutcomeRecord:
    """Loggers on the ports of a station and its controllers, and the table that they make after the
    run.

    Args:
        builder: of the diagram that holds the station.
        station: simulated, without the truth for a log.
        scenario: of the station.
        signals: ports with their column names (`car_run.assemble`); those that cost Python at every
            row are left out.
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
        # One logger for all ports: each has its share in every instant of the diagram.
        self._rows = add_and_connect(
            builder, VectorLogSink(len(self._names), publish_period=row_period(self._rate, step))
        )
        steps = [station.GetOutputPort("plant_state_truth")]
        self._has_tail = station.HasOutputPort("last_tail_torque_truth")
        if self._has_tail:
            steps.append(station.GetOutputPort("last_tail_torque_truth"))
        size = sum(port.size() for port in steps)
        self._steps_log = add_and_connect(builder, VectorLogSink(size, publish_period=step))
        mux = PortMux(builder)
        mux.route(self._rows.get_input_port(), *(port for port, _ in cheap))
        mux.route(self._steps_log.get_input_port(), *steps)
        mux.add_to_builder("logged")
        self._loads = GroundLoads(self._car)
        chassis = self._plant.GetBodyByName("chassis")
        q = chassis.floating_positions_start()
        v = self._plant.num_positions() + chassis.floating_velocities_start_in_v()
        self._quaternion = slice(q, q + 4)
        self._position = slice(q + 4, q + 7)
        self._spin = slice(v, v + 3)
        self._velocity = slice(v, v + 6)
        still = scenario.wind.is_still or scenario.tail.mode == "none"
        self._look_back = CALM_FOR + 0.05 + 1.0 / self._rate
        self._may_settle = still and scenario.manoeuvre.kind == "turn"

    def is_certain(self, context: Context, turn_end: float) -> bool:
        """Whether the run may end: the car has flipped, or has settled after a single turn in still
        air.

        Args:
            context: of the whole diagram.
            turn_end: s; from then on.
        """
        state = self._states(context)
        time = self._times(context)
        if self._over(state, time, turn_end).any():
            return True
        return self._may_settle and self._is_calm(context, turn_end)

    def _is_calm(self, context: Context, since: float) -> bool:
        """Whether the car has been calm in the last instants, and not before `since`, s."""
        state = self._states(context)
        time = self._times(context)
        first = int(np.searchsorted(time, max(since, time[-1] - self._look_back)))
        if first == time.size or np.sum(state[self._spin, -1] ** 2) > CALM_SPIN**2:
            return False
        motion = self._motion(context, state, slice(first, None))
        since = time[first]
        pressed = dict.fromkeys(CONTACT_COLUMNS, np.full(time.size - first, math.inf))
        if settled_row(motion | pressed, since) is None:
            return False  # whatever the forces of the ground are, which cost most
        contacts = self._contacts(state, self._steps(time[first:]))
        return settled_row(motion | contacts, since) is not None

    def table(self, context: Context, stop_after: float) -> tuple[pd.DataFrame, dict[str, float]]:
        """One row per log time, columns as in a run log; up to that at which a `FlipWatch` at every
        row would stop.

        The second answer is for `extra` of the log: when and why the run ended before its time.

        Args:
            context: of the whole diagram, at the end of the run.
            stop_after: s; a flipped car ends the table from then on.
        """
        state = self._states(context)
        time = self._times(context)
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

    def _times(self, context: Context) -> FloatArray:
        return np.arange(self._rows.FindLog(context).num_samples()) / self._rate

    def _states(self, context: Context) -> FloatArray:
        """[q; v] of the plant at every step."""
        return self._steps_log.FindLog(context).data()[: self._plant.num_multibody_states()]

    def _over(self, state: FloatArray, time: FloatArray, stop_after: float) -> NDArray[np.bool_]:
        """At which rows the run of a car that has flipped is over."""
        rotations = state[self._quaternion][:, self._steps(time)]
        over: NDArray[np.bool_] = np.logical_or.accumulate(has_flipped(rotations)) & (
            time >= stop_after
        )
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
        """Motion of the chassis, by the definitions of `ground_truth.CarTruth`."""
        step = self._scenario.simulation.step
        state = states[:, steps]
        velocity = state[self._velocity]
        change = (velocity - states[self._velocity, np.maximum(steps - 1, 0)]) / step
        R_WB: Any = rotation_rows(state[self._quaternion])
        motion = ChassisMotion(R_WB, velocity[:3], change[:3], change[3:])
        gyro, acceleration = felt_at(motion, (self._scenario.imu.x, 0.0, self._scenario.imu.z))
        up = R_WB[2]
        named = {
            "roll_truth_rad": np.arctan2(up[1], up[2]),
            "pitch_truth_rad": np.arcsin(np.clip(-up[0], -1.0, 1.0)),
            "yaw_truth_rad": np.unwrap(np.arctan2(R_WB[1][0], R_WB[0][0])),
            "tilt_truth_rad": np.arccos(np.clip(up[2], -1.0, 1.0)),
        }
        vectors: dict[str, Any] = {
            "position_{}_truth_m": state[self._position],
            "velocity_{}_truth_m_per_s": in_body(R_WB, velocity[3:]),
            "gyro_{}_truth_rad_per_s": gyro,
            "acceleration_{}_truth_m_per_s2": acceleration,
        }
        for stem, values in vectors.items():
            named |= {stem.format(axis): values[index] for index, axis in enumerate("xyz")}
        return named

    def _tail(self, states: FloatArray, steps: IntArray, context: Context) -> dict[str, FloatArray]:
        """Torques of the tail motors in the step that begins, N m, and their power, W."""
        names = ("tail_pitch_torque_n_m", "tail_roll_torque_n_m")
        if not self._has_tail:
            return {name: np.zeros(steps.size) for name in names}
        # At a step the log has what acted in the step before; at the end of the run nobody has
        # stepped yet.
        port = self._station.GetOutputPort("tail_torque")
        at_end = vector_of(port, self._station.GetMyContextFromRoot(context))
        last = self._steps_log.FindLog(context).data()[self._plant.num_multibody_states() :]
        torques = np.column_stack((last[:, 1:], at_end))[:, steps]
        joints = [self._plant.GetJointByName(f"tail_{name}") for name in ("pitch", "roll")]
        places = [self._plant.num_positions() + joint.velocity_start() for joint in joints]
        rates = states[places][:, steps]
        columns = dict(zip(names, torques, strict=True))
        columns["tail_power_truth_w"] = np.sum(torques * rates, axis=0)
        return columns

    def _contacts(self, states: FloatArray, steps: IntArray) -> dict[str, FloatArray]:
        """Vertical forces of the ground in the step before a row, N; none before the first step."""
        positions = states[: self._plant.num_positions()]
        forces = self._loads.forces(positions[:, np.maximum(steps - 1, 0)], positions[:, steps])
        forces[:, steps == 0] = 0.0
        return dict(zip(CONTACT_COLUMNS, forces, strict=True))


def _is_cheap(names: Sequence[str]) -> bool:
    return not (
        names[0].startswith(COSTLY) or any("_truth_" in name or "plant_" in name for name in names)
    )
