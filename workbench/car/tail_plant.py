"""The car's tail as a `TailGeometry`, and its SDF: hub, rod and sail with three joints
(models/tail/tail.sdf).

Joint signs: roll 0 = straight up, positive to the right (-y), axis +x; pitch axis +y, positive
tilts forward; sail about the tail's own axis (design section 4). At sail angle 0 the sail is hollow
towards +y; one that faces the wind is welded there, since its angle follows from the wind at every
instant (`TailForce`, port `wind_direction`).
"""

import math
from typing import NamedTuple

from pydrake.multibody.tree import UnitInertia

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_geometry import Plate, TailArm, TailGeometry
from aerodima.workbench.car.tail_file import read_tail, set_tail_shapes
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.sdf_model import Inertial, SdfModel
from aerodima.workbench.scenario.car_parameters import CarParameters
from aerodima.workbench.scenario.tail_parameters import (
    SHELL_DEPTH,
    TailMotorParameters,
    TailParameters,
)

TAIL_SDF = "tail/tail.sdf"
ROD_RADIUS = 0.006
"""Radius of the tail rod (m), as drawn in the SDF; used for its inertia about its own axis only."""
HUB_RADIUS = 0.03
"""Radius (m) of the ball that has the inertia of the tail's hub."""
BOARD_THICKNESS = 0.002
"""Thickness of the backing board as drawn, m."""
SAIL_TIP_MARGIN = 0.01
"""Radius (m) of the spheres that feel the ground at the sail's tip corners, as in the SDF."""
TAIL_CONTACT_STIFFNESS = 1.0e4
"""Contact stiffness (N/m) of the sail's corners: film and a half ring, soft against the tyres; acts
in a crash only."""
ADDED_MASS_PARTS = 5
"""Equal parts of the tail that carry the added mass (design section 5, thesis section 4.6)."""
MIN_INERTIA_FRACTION = 0.03
"""Share of every inertia that a negative `tail.added_mass` must leave: with 3 % a swing of a tail
of 0.17 kg is the same at steps of 2 ms and 0.5 ms; with less than 1 % Drake's solver gives up."""


class ArmInertia(NamedTuple):
    """Inertia (kg m2) of the moving arm about its joints with the added mass of the air, without
    the rotors.

    Args:
        roll: inertia of rod and sail about the roll axis.
        pitch_upright: inertia of hub, rod and sail about the pitch axis, arm straight up.
        pitch_sideways: the same inertia with the arm along the pitch axis.
        pitch_product: product of inertia yz of rod and sail about the joints; 0 for a tail that is
            symmetric about the plane y = 0.
    """

    roll: float
    pitch_upright: float
    pitch_sideways: float
    pitch_product: float = 0.0


def inertia_about_joints(arm: ArmInertia, roll_angle: float) -> Pair:
    """Returns the inertia (kg m2) about pitch and roll axis at a roll angle, rad.

    It is the diagonal of the arm's mass matrix.
    """
    sideways = math.sin(roll_angle) ** 2
    pitch = arm.pitch_upright + sideways * (arm.pitch_sideways - arm.pitch_upright)
    return pitch - arm.pitch_product * math.sin(2.0 * roll_angle), arm.roll


def arm_inertia(tail: TailParameters, motor: TailMotorParameters, car: CarParameters) -> ArmInertia:
    """Returns the inertia of the arm as `tail_sdf` builds it, with the added mass on it.

    Added mass acts across the tail only: about the roll axis and about the pitch axis of an upright
    arm it counts with its distance from the joints; an arm along the pitch axis turns about itself
    and moves no air.
    """
    model = tail_sdf(tail, motor, car)
    arm = model.inertial("tail_rod").about_origin()
    arm += model.inertial("tail_sail").about_origin()
    about_joints = arm.CalcRotationalInertia().CopyToFullMatrix3()
    hub = model.inertial("tail_hub").moments[1]
    air = 0.0
    if tail.added_mass != 0.0:
        air = tail.added_mass * sum(distance**2 for distance in added_mass_layout(tail).distances)
    return ArmInertia(
        roll=float(about_joints[0, 0]) + air,
        pitch_upright=hub + float(about_joints[1, 1]) + air,
        pitch_sideways=hub + float(about_joints[2, 2]),
        pitch_product=float(about_joints[1, 2]),
    )


def added_mass_layout(tail: TailParameters) -> SectionLayout:
    """Returns the parts that carry added mass, in the frame of `tail_rod`: z along the tail."""
    return tail_geometry(tail).added_mass_layout(ADDED_MASS_PARTS)


def tail_geometry(tail: TailParameters) -> TailGeometry:
    """Returns the tail of a scenario as an object, with mass and inertia from its parameters.

    The rod is a uniform thin rod from the roll axis to the tip, the sail ends at the tip, see
    `sail_inertial`. The densities are these masses over length and area: `from_densities` is the
    same tail to rounding. With `tail.geometry` the tail is that of the tail file.

    Raises:
        ModelError: the tail file is missing or wrong.
    """
    if tail.has_own_geometry:
        try:
            return read_tail(tail.geometry)
        except ModelError as error:
            raise ModelError(f"tail.geometry: {error}") from None
    sail = sail_inertial(tail)
    rod_mass = tail.mass - sail.mass
    rod = rod_mass * tail.length**2 / 12
    arm = TailArm(lengths=(tail.length,), density=rod_mass / tail.length, radius=ROD_RADIUS)
    moments = (rod, rod, 0.5 * rod_mass * ROD_RADIUS**2)
    plate = Plate(
        name="sail",
        root=(0.0, 0.0, tail.length - tail.sail_length),
        lengths=(tail.sail_length,),
        chords=(tail.sail_width, tail.sail_width),
        normal=(0.0, -1.0, 0.0),
        density=sail.mass / (tail.sail_length * tail.sail_width),
        depth=tail.sail_depth,
        sections=tail.sections,
    )
    return TailGeometry(
        name=tail.name,
        arm=arm,
        plates=(plate,),
        arm_inertial=Inertial(rod_mass, (0, 0, tail.length / 2), moments),
        sail_inertial=sail,
    )


def tail_sdf(
    tail: TailParameters,
    motor: TailMotorParameters,
    car: CarParameters,
    geometry: TailGeometry | None = None,
) -> SdfModel:
    """Makes the tail model with the numbers of a scenario.

    Args:
        geometry: tail whose mass and inertia the model has; by default that of the parameters, see
            `tail_geometry`.
    """
    model = SdfModel(model_path(TAIL_SDF))
    geometry = geometry or tail_geometry(tail)
    model.set_inertial(
        "tail_hub", Inertial.solid(tail.hub_mass, UnitInertia.SolidSphere(HUB_RADIUS))
    )
    model.set_inertial("tail_rod", geometry.arm_mass)
    model.set_inertial("tail_sail", geometry.sail_mass)
    if tail.has_own_geometry:
        corners = set_tail_shapes(model, geometry, SAIL_TIP_MARGIN)
    else:
        corners = _set_sail_shapes(model, tail)
    for shape in corners:
        model.set_contact(
            "tail_sail", shape, TAIL_CONTACT_STIFFNESS, 1.0, ground_partner_friction(car)
        )
    for joint, limit in (("tail_pitch", tail.pitch_limit), ("tail_roll", tail.roll_stop)):
        model.set_joint(joint, lower=-limit, upper=limit, effort=motor.torque_limit)
        model.set_rotor(joint, motor.rotor_inertia, motor.gear_ratio)
    model.set_joint("tail_sail_turn", damping=tail.sail_bearing_damping)
    return model


def sail_inertial(tail: TailParameters) -> Inertial:
    """Returns mass and inertia of shell and board: a uniform box as long and wide as the sail and
    as deep as both, balanced on its axis.
    """
    box = UnitInertia.SolidBox(tail.sail_width, tail.sail_depth, tail.sail_length)
    mass = tail.mass * tail.sail_mass_fraction
    return Inertial.solid(mass, box, (0, 0, tail.length - tail.sail_length / 2))


def _set_sail_shapes(model: SdfModel, tail: TailParameters) -> list[str]:
    """Places the drawn shell, which opens to +y, before the bearing and the board behind the shell;
    returns the names of the corners.
    """
    model.set_shape("tail_rod", "rod", (0, 0, tail.length / 2), length=tail.length)
    width = tail.sail_width
    middle = tail.length - tail.sail_length / 2
    deep = max(tail.shell_share / SHELL_DEPTH * width, BOARD_THICKNESS)
    scale = (width, deep, tail.sail_length)
    model.set_shape("tail_sail", "sail", (0, tail.sail_front, middle), scale=scale)
    board = tail.board_share * width
    if board:
        behind = tail.sail_front - tail.shell_share * width - board / 2
        size = (BOARD_THICKNESS, board, tail.sail_length)
        model.set_shape("tail_sail", "backing_board", (0, behind, middle), size=size)
    else:
        model.remove_shapes("tail_sail", "backing_board")
    for shape, side in (("tail_tip_front", 1), ("tail_tip_rear", -1)):
        corner = (side * (tail.sail_width / 2 - SAIL_TIP_MARGIN), 0, tail.length - SAIL_TIP_MARGIN)
        model.set_shape("tail_sail", shape, corner)
    return ["tail_tip_front", "tail_tip_rear"]


def ground_partner_friction(car: CarParameters) -> float:
    """Returns the friction that cage, board and tail must carry so that Drake combines it with the
    ground's to `cage_friction`.

    Drake combines mu = 2 mu1 mu2 / (mu1 + mu2); the ground carries the tyre friction, so that the
    tyres' own pair gives exactly that. A scenario's cage friction is below twice its tyre friction.
    """
    return car.cage_friction * car.tyre_friction / (2 * car.tyre_friction - car.cage_friction)
