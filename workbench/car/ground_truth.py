"""Ground truth of the simulated car: motion, contact and tail quantities that no sensor gives, for
logs and metrics.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults, MultibodyPlant, PointPairContactInfo
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from aerodima.workbench.aero.section_laws import cross
from aerodima.workbench.aero.section_watch import SECTION_COLUMNS
from aerodima.workbench.car.car_plant import CarPlant, own_instances
from aerodima.workbench.car.car_sensors import (
    CHASSIS_MOTION_SIZE,
    ChassisMotion,
    chassis_motion,
    in_body,
    motion_at_imu,
)
from aerodima.workbench.car.plant_ports import tail_rate_places
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.port_wiring import declare_output, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import CAR_TRUTH, GROUND_CONTACTS, WHEELS, names_of

BASE_COLUMNS = [
    name
    for name in names_of(CAR_TRUTH["body_truth"])
    if not name.startswith(("acceleration", "com"))
]
"""Columns of a base, named as those of the car's body: position, roll, pitch, yaw, tilt, velocity
and angular velocity."""
COM_COLUMNS = [f"com_{axis}_truth_m" for axis in "xyz"] + [
    f"com_velocity_{axis}_truth_m_per_s" for axis in "xyz"
]
"""Columns of position and velocity of the centre of mass of the whole plant in W."""
BODY_TRUTH = PortFields("BodyTruth", tuple(names_of(CAR_TRUTH["body_truth"])))
CONTACT_TRUTH = PortFields("ContactTruth", tuple(names_of(CAR_TRUTH["contact_truth"])))
TAIL_TRUTH = PortFields("TailTruth", tuple(names_of(CAR_TRUTH["tail_truth"])))
AIR_TRUTH = "_air_truth"
"""Ending of the names of a station's ports with the force of the air on a body other than its
tail."""
LEAST_LOAD = 1e-9
"""Least load by which the sum of contact points is divided, N; the contact point of a wheel in the
air is then the origin."""


def pose_columns(body: str) -> list[str]:
    """Returns columns of the pose of a body in W: quaternion, then position of its origin, m."""
    return [f"pose_{body}_{part}" for part in ("qw", "qx", "qy", "qz")] + [
        f"pose_{body}_{axis}_m" for axis in "xyz"
    ]


def air_columns(stem: str) -> list[str]:
    """Returns columns of the air on a tail in W: force, moment about Wo, ends of its sections."""
    parts = (("", "n"), ("_moment", "n_m"), ("_root", "m"), ("_tip", "m"))
    return [f"{stem}{what}_{axis}_truth_{unit}" for what, unit in parts for axis in "xyz"]


def section_columns(stem: str, number: int) -> list[str]:
    """Returns the columns of the port `sections` of a `TailForce`."""
    return [f"{stem}_section_{index}_{name}" for index in range(number) for name in SECTION_COLUMNS]


class _Kinematics(LeafSystem):
    """Reads a plant's state and puts a context of its own into it; bodies are kept by index, see
    design section 13.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        super().__init__()
        self._plant = plant
        self._kinematics = plant.CreateDefaultContext()
        self._state_port = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._known = b""

    def _kinematics_at(self, context: Context) -> Context:
        state = vector_of(self._state_port, context)
        known = state.tobytes()
        if known != self._known:  # else what was computed at this state stays
            self._plant.SetPositionsAndVelocities(self._kinematics, state)
            self._known = known
        return self._kinematics


def _body_truth(place: Any, velocity: Any, motion: ChassisMotion, p_BoImu_B: Any) -> list[float]:
    """Returns position, attitude, tilt and velocities of a body, and acceleration at its IMU."""
    angles, gyro, acceleration = motion_at_imu(motion, p_BoImu_B)
    tilt = math.acos(min(max(motion.R_WB[2][2], -1.0), 1.0))
    return [*place, *angles, tilt, *in_body(motion.R_WB, velocity), *gyro, *acceleration]


class PlantTruth(_Kinematics):
    """Motion of a plant, evaluated only when something reads it, such as the run log.

    Everything comes from the plant's state through a context of its own.

    Input ports:
        plant_state: state [q; v] of the plant.
        <name of a tail force> (9): its `wrench`.
    Output ports:
        base (13): `BASE_COLUMNS`; only with a base.
        com (6): `COM_COLUMNS`.
        poses (7 n): `pose_columns` of each body; only with bodies.
        <name of a tail force>_air (12): `air_columns`.

    Args:
        plant: finalised plant.
        base: body whose roll, tilt and speed count; None for a plant that has none.
        bodies: bodies whose poses are output.
        tails: `TailForce` systems on bodies of this plant.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        base: BodyIndex | None,
        bodies: Sequence[BodyIndex],
        tails: Sequence[Any],
    ) -> None:
        super().__init__(plant)
        self._base = base
        self._bodies = list(bodies)
        self._instances = own_instances(plant)
        declare_output(self, "com", len(COM_COLUMNS), self._calc_com)
        if base is not None:
            declare_output(self, "base", len(BASE_COLUMNS), self._calc_base)
        if self._bodies:
            declare_output(self, "poses", 7 * len(self._bodies), self._calc_poses)
        for tail in tails:
            self._declare_tail(tail)

    def _declare_tail(self, tail: Any) -> None:
        wrench_port = self.DeclareVectorInputPort(tail.get_name(), 9)
        body = tail.body.index()
        root: Any = np.array(tail.layout.p_BoRo_B)
        tip = tail.layout.p_BoTip_B

        def calc(context: Context, output: BasicVector) -> None:
            force, moment, p_WBo = np.split(vector_of(wrench_port, context), 3)
            X_WB = self._plant.EvalBodyPoseInWorld(
                self._kinematics_at(context), self._plant.get_body(body)
            )
            ends = (X_WB.multiply(root), X_WB.multiply(tip))
            output.SetFromVector(
                np.concatenate([force, moment + cross(p_WBo.tolist(), force.tolist()), *ends])
            )

        self.DeclareVectorOutputPort(f"{tail.get_name()}_air", 12, calc)

    def _calc_com(self, context: Context, output: BasicVector) -> None:
        kinematics = self._kinematics_at(context)
        plant = self._plant
        place = plant.CalcCenterOfMassPositionInWorld(kinematics, self._instances)
        velocity = plant.CalcCenterOfMassTranslationalVelocityInWorld(kinematics, self._instances)
        output.SetFromVector(np.concatenate([place, velocity]))

    def _calc_base(self, context: Context, output: BasicVector) -> None:
        assert self._base is not None
        kinematics = self._kinematics_at(context)
        body = self._plant.get_body(self._base)
        X_WB = self._plant.EvalBodyPoseInWorld(kinematics, body)
        V_WB = self._plant.EvalBodySpatialVelocityInWorld(kinematics, body)
        still = np.zeros(3)
        motion = ChassisMotion(X_WB.rotation().matrix(), V_WB.rotational(), still, still)
        truth = _body_truth(X_WB.translation(), V_WB.translational(), motion, still)
        output.SetFromVector(np.array(truth[: len(BASE_COLUMNS)]))

    def _calc_poses(self, context: Context, output: BasicVector) -> None:
        kinematics = self._kinematics_at(context)
        rows = []
        for index in self._bodies:
            X_WB = self._plant.EvalBodyPoseInWorld(kinematics, self._plant.get_body(index))
            rows += [X_WB.rotation().ToQuaternion().wxyz(), X_WB.translation()]
        output.SetFromVector(np.concatenate(rows))


class CarTruth(_Kinematics):
    """Ground truth of the car: motion, contacts and tail, as no sensor gives them.

    It is evaluated only when something reads it, such as the run log.

    Accelerations and contact forces are those of the plant's last step. Fields, units and axes:
    `aerodima.workbench.scenario.signal_table`.

    Input ports:
        plant_state: state [q; v] of the plant.
        chassis_motion (20): motion of the chassis, see `CHASSIS_MOTION_SIZE`.
        contact_results: ContactResults, from the plant.
        drive_torque (1): torque of the drive on the shaft, N m.
        tail_torque (2): torques of the tail motors, N m; only with a tail.
        tail_air (6): moment of the air on the tail about the origin of the chassis, N m, and its
            force, N, in W; only with a tail.
    Output ports:
        body_truth, contact_truth, and with a tail tail_truth.
    """

    def __init__(self, car_plant: CarPlant, scenario: Scenario):
        plant = car_plant.plant
        super().__init__(plant)
        self._tail = car_plant.tail
        self._instances = car_plant.instances
        self._chassis = plant.GetBodyByName("chassis").index()
        self._p_BoImu_B = np.array([scenario.imu.x, 0.0, scenario.imu.z])
        self._step = plant.time_step()
        shaft = plant.GetJointByName("drive_shaft_spin")
        self._shaft = plant.num_positions() + shaft.velocity_start()
        self._contact_slots = contact_slots(car_plant)
        self._motion_port = self.DeclareVectorInputPort("chassis_motion", CHASSIS_MOTION_SIZE)
        self._contact_port = self.DeclareAbstractInputPort(
            "contact_results", Value(ContactResults())
        )
        self._drive_port = self.DeclareVectorInputPort("drive_torque", 1)
        declare_output(self, "body_truth", BODY_TRUTH.size, self._calc_body)
        declare_output(self, "contact_truth", CONTACT_TRUTH.size, self._calc_contact)
        if self._tail is not None:
            self._p_ToTip_T = tail_geometry(scenario.tail).arm.points[-1]
            self._rod = plant.GetBodyByName("tail_rod").index()
            self._tail_rates = tail_rate_places(plant)
            self._torque_port = self.DeclareVectorInputPort("tail_torque", 2)
            self._air_port = self.DeclareVectorInputPort("tail_air", 6)
            declare_output(self, "tail_truth", TAIL_TRUTH.size, self._calc_tail)

    def _calc_body(self, context: Context, output: BasicVector) -> None:
        values = vector_of(self._motion_port, context)
        x = values.tolist()
        motion = chassis_motion(values, self._step)
        com: Any = self._plant.CalcCenterOfMassPositionInWorld(
            self._kinematics_at(context), self._instances
        )
        truth = _body_truth(x[4:7], x[10:13], motion, self._p_BoImu_B)
        output.SetFromVector(np.array([*truth, *com.tolist()]))

    def _calc_contact(self, context: Context, output: BasicVector) -> None:
        results: Any = self._contact_port.Eval(context)
        forces, points = np.zeros((2, len(WHEELS), 3))
        ground = dict.fromkeys(GROUND_CONTACTS, 0.0)
        for slot, force, info in ground_forces(results, self._contact_slots):
            if slot in ground:
                ground[slot] += float(np.linalg.norm(force))
            else:
                wheel = WHEELS.index(slot)
                forces[wheel] += force
                points[wheel] += force[2] * info.contact_point()
        points /= np.maximum(forces[:, 2:], LEAST_LOAD)
        power = (
            vector_of(self._drive_port, context)[0]
            * vector_of(self._state_port, context)[self._shaft]
        )
        output.SetFromVector(
            np.concatenate([forces.ravel(), points.ravel(), [*ground.values(), power]])
        )

    def _calc_tail(self, context: Context, output: BasicVector) -> None:
        kinematics = self._kinematics_at(context)
        plant = self._plant
        assert self._tail is not None
        tail = [self._tail]
        X_WT = plant.EvalBodyPoseInWorld(kinematics, plant.get_body(self._rod))
        momentum = plant.CalcSpatialMomentumInWorldAboutPoint(kinematics, tail, np.zeros(3))
        moment, force = np.split(vector_of(self._air_port, context), 2)
        p_WBo = plant.EvalBodyPoseInWorld(kinematics, plant.get_body(self._chassis)).translation()
        torque = vector_of(self._torque_port, context)
        rates = vector_of(self._state_port, context)[self._tail_rates]
        output.SetFromVector(
            np.concatenate(
                [
                    X_WT.multiply(self._p_ToTip_T),
                    plant.CalcCenterOfMassPositionInWorld(kinematics, tail),
                    momentum.translational(),
                    momentum.rotational(),
                    force,
                    moment + cross(p_WBo.tolist(), force.tolist()),
                    [torque @ rates],
                ]
            )
        )


def ground_forces(
    results: ContactResults, slots: dict[int, str]
) -> Iterator[tuple[str, FloatArray, PointPairContactInfo]]:
    """Yields for each contact its slot (`contact_slots`), the ground's force (3) in W, N, and
    Drake's own description.
    """
    for index in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(index)
        pair = info.point_pair()
        force: Any = info.contact_force()
        for shape, on_it in ((pair.id_A, -1.0 * force), (pair.id_B, force)):
            if shape.get_value() in slots:
                yield slots[shape.get_value()], on_it, info


def contact_slots(car_plant: CarPlant) -> dict[int, str]:
    """Returns the wheel, or `cage`, `board`, `tail`, that each collision shape belongs to, by the
    value of the shape's GeometryId; shapes of a user's bodies are left out.
    """
    plant = car_plant.plant
    inspector = car_plant.scene_graph.model_inspector()
    slots: dict[int, str] = {}
    for instance in car_plant.instances:
        for index in plant.GetBodyIndices(instance):
            body = plant.get_body(index)
            for geometry in plant.GetCollisionGeometriesForBody(body):
                shape = inspector.GetName(geometry).split("::")[-1]
                if shape.startswith("tyre"):
                    part = body.name().removesuffix("_wheel")
                else:
                    part = shape.split("_")[0]
                if part in (*WHEELS, *GROUND_CONTACTS):
                    slots[geometry.get_value()] = part
    return slots
