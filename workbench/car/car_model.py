"""The car's SDF (models/car/car.sdf) with the numbers of a scenario: masses, springs and what
follows from statics.

At nominal ride height every suspension joint is at zero: the springs are preloaded with the static
load of the car without its tail arm, and the wheel centres sit one static tyre deflection below the
unloaded radius.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import UnitInertia

from aerodima.workbench.car.tail_plant import ground_partner_friction
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.sdf_model import Inertial, SdfModel
from aerodima.workbench.scenario.car_parameters import CarParameters
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import AXLES, SIDES
from aerodima.workbench.scenario.tail_parameters import TailParameters

CAR_SDF = "car/car.sdf"

SHAFT_MASS = 0.02
"""Mass (kg) of the motor shaft link; the drive's inertia is the rotor inertia of its actuator."""

SHAFT_RADIUS = 0.01
"""Radius (m) of the ball that has the inertia of the motor shaft link."""
UPRIGHT_RADIUS = 0.03
"""Radius (m) of the ball that has the inertia of an upright."""
KNUCKLE_RADIUS = 0.02
"""Radius (m) of the ball that has the inertia of a steering knuckle."""
CAGE_STIFFNESS = 1.0e5
"""Contact stiffness (N/m) of cage and board: stiff against the tyres; acts in a crash only."""
EDGE_HALF_WIDTH = 0.002
"""Half the width (m) of each edge of a tyre: narrow against any tyre, so that its contact point
stays on it."""
REAR_DECK_X = -0.02
"""Middle (m, x in B) of the drawn rear deck."""
REAR_DECK_HEIGHT = 0.19
"""Height (m) of the middle of the drawn rear deck where the tail joints leave it room."""
JOINTS_OVER_REAR_DECK = 0.02
"""Least height (m) of the tail joints over the rear deck: a car with low joints has a lower deck,
or its tail would stand in the deck at every angle."""
MIN_STICTION_TOLERANCE = 1e-4
"""Slip (m/s) over which Drake spreads friction by default; rigid tyres have it."""


def stiction_tolerance(car: CarParameters, speed: float) -> float:
    """Returns the slip (m/s) over which tyre friction is spread, at the speed (m/s) of a run.

    A tyre that slips at v feels friction x load x v / sqrt(v^2 + tolerance^2), along and across
    alike: at small slip angles its cornering stiffness is friction x load / `tyre_slip_angle`, the
    same for both axles.
    """
    return max(MIN_STICTION_TOLERANCE, math.tan(car.tyre_slip_angle) * speed)


@dataclass(frozen=True)
class AxleStatics:
    """One axle at rest: load per wheel on the ground (N), wheel-centre height (m), preload (m)."""

    wheel_load: float
    wheel_height: float
    spring_reference: float


def axle_statics(car: CarParameters, gravity: float, axle: str) -> AxleStatics:
    """Computes the static equilibrium of the car without its tail arm on level ground."""
    front = axle == "front"
    share = car.com_x / car.wheelbase
    load = 0.5 * car.mass * gravity * (share if front else 1 - share)
    tyre = car.tyre_stiffness_front if front else car.tyre_stiffness_rear
    spring, _ = wheel_rates(car, axle)
    sprung_load = load - gravity * unsprung_mass(car, axle)
    return AxleStatics(load, car.tyre_radius - load / tyre, -sprung_load / spring)


def wheel_rates(car: CarParameters, axle: str) -> Pair:
    """Returns spring rate (N/m) and damping (N s/m) at one wheel: those of its suspension unit
    times the motion ratio squared.

    Table 6.1 has the rates of the units, which were pressed on their own (thesis 6.1.2); the wheel
    moves further.
    """
    front = axle == "front"
    squared = car.suspension_motion_ratio**2
    stiffness = car.suspension_stiffness_front if front else car.suspension_stiffness_rear
    damping = car.suspension_damping_front if front else car.suspension_damping_rear
    return squared * stiffness, squared * damping


def rolling_torques(car: CarParameters, gravity: float) -> dict[str, float]:
    """Returns by axle the torque (N m) against a wheel's rolling, at its standing load without tail
    arm.
    """
    statics = {axle: axle_statics(car, gravity, axle) for axle in AXLES}
    return {
        axle: car.rolling_resistance * one.wheel_load * one.wheel_height
        for axle, one in statics.items()
    }


def unsprung_mass(car: CarParameters, axle: str) -> float:
    """Returns the mass (kg) that moves with one wheel of an axle."""
    return car.wheel_mass + car.upright_mass + (car.knuckle_mass if axle == "front" else 0.0)


def chassis_inertial(car: CarParameters, tail: TailParameters, gravity: float) -> Inertial:
    """Returns mass and inertia of the chassis with which the whole car has the scenario's mass and
    centre of mass.

    Raises:
        ModelError: gearbox and wheels alone are heavier than the car, or the chassis' own centre of
            mass would be outside the car.
    """
    mass, x, z = chassis_centre(car, tail, gravity)
    if mass <= 0:
        raise ModelError(
            f"car.mass: {car.mass:g} kg; allowed: more than its parts, {car.mass - mass:g} kg"
        )
    if not 0 < z < 2 * car.com_height:
        raise ModelError(
            f"car.com_height: {car.com_height:g} m puts the chassis alone at {z:g} m; lower "
            "gearbox or raise it"
        )
    roll = car.gyration_roll
    pitch = car.gyration_pitch
    yaw = car.gyration_yaw
    return Inertial(mass, (x, 0.0, z), (mass * roll**2, mass * pitch**2, mass * yaw**2))


def chassis_centre(
    car: CarParameters, tail: TailParameters, gravity: float
) -> tuple[float, float, float]:
    """Returns mass (kg) and place (x, z in B, m) of the chassis alone: the car without gearbox,
    wheels and anti-ramp board.

    Parameters that are arrays of one shape give arrays; nothing is checked.
    """
    parts = [(car.gearbox_mass, car.gearbox_x, gearbox_height(car, tail))]
    for axle, x in (("front", car.wheelbase), ("rear", 0.0)):
        parts.append(
            (2 * unsprung_mass(car, axle), x, axle_statics(car, gravity, axle).wheel_height)
        )
    parts.append((SHAFT_MASS, 0.0, axle_statics(car, gravity, "rear").wheel_height))
    if car.board:
        parts.append((car.board_mass, *board_centre(car)))
    mass = car.mass - sum(part[0] for part in parts)
    x = (car.mass * car.com_x - sum(m * px for m, px, _ in parts)) / mass
    z = (car.mass * car.com_height - sum(m * pz for m, _, pz in parts)) / mass
    return mass, x, z


def board_centre(car: CarParameters) -> Pair:
    """Returns the place (x, z in B, m) of the anti-ramp board's centre."""
    return car.board_x + car.board_length / 2, car.board_height + car.board_thickness / 2


def gearbox_height(car: CarParameters, tail: TailParameters) -> float:
    """Returns the gearbox centre's height (m); the tail joints are as high as its upper face."""
    return tail.mount_height - car.gearbox_height / 2


def car_sdf(scenario: Scenario) -> SdfModel:
    """Makes the car model with the numbers of a scenario."""
    car = scenario.car
    tail = scenario.tail
    drive = scenario.drive
    gravity = scenario.environment.gravity
    model = SdfModel(model_path(CAR_SDF))
    model.set_inertial("chassis", chassis_inertial(car, tail, gravity))
    friction = ground_partner_friction(car)
    for link in ("chassis", "gearbox", "board"):
        model.set_contact(link, None, CAGE_STIFFNESS, 1.0, friction)
    _set_gearbox(model, car, tail)
    height = min(REAR_DECK_HEIGHT, tail.mount_height - JOINTS_OVER_REAR_DECK)
    model.set_shape("chassis", "rear_deck", (REAR_DECK_X, 0, height))
    _set_board(model, car)
    shaft = Inertial.solid(SHAFT_MASS, UnitInertia.SolidSphere(SHAFT_RADIUS))
    model.place_link("drive_shaft", shaft, (0, 0, axle_statics(car, gravity, "rear").wheel_height))
    model.set_rotor("drive_shaft_spin", drive.rotor_inertia, 1.0)
    model.set_joint("drive_shaft_spin", effort=drive.torque_limit)
    for axle in AXLES:
        _set_axle(model, car, axle, axle_statics(car, gravity, axle))
    for side in SIDES:
        joint = f"front_{side}_steering"
        model.set_controller_gains(joint, scenario.servo.stiffness, scenario.servo.damping)
        model.set_joint(joint, effort=scenario.servo.torque_limit)
    return model


def _set_gearbox(model: SdfModel, car: CarParameters, tail: TailParameters) -> None:
    length = car.gearbox_length
    width = car.gearbox_width
    height = car.gearbox_height
    inertial = Inertial.solid(car.gearbox_mass, UnitInertia.SolidBox(length, width, height))
    model.place_link("gearbox", inertial, (car.gearbox_x, 0, gearbox_height(car, tail)))
    model.set_shape("gearbox", "gearbox", size=(length, width, height))
    reach = tail.mount_x - car.gearbox_x
    model.set_shape("gearbox", "shaft", (reach / 2, 0, height / 2), length=max(abs(reach), 0.001))


def _set_board(model: SdfModel, car: CarParameters) -> None:
    """Places the anti-ramp board, which touches the ground with the ends of its rear edge, or takes
    it away.
    """
    if not car.board:
        model.remove_link("board", "board_mount")
        return
    length = car.board_length
    width = car.board_width
    thickness = car.board_thickness
    x, z = board_centre(car)
    inertial = Inertial.solid(car.board_mass, UnitInertia.SolidBox(length, width, thickness))
    model.place_link("board", inertial, (x, 0, z))
    model.set_shape("board", "board", size=(length, width, thickness))
    radius = thickness / 2
    for side, sign in (("left", 1), ("right", -1)):
        corner = (radius - length / 2, sign * (width / 2 - radius), 0.0)
        model.set_shape("board", f"board_{side}", corner, radius=radius)


def _set_axle(model: SdfModel, car: CarParameters, axle: str, statics: AxleStatics) -> None:
    front = axle == "front"
    stiffness, damping = wheel_rates(car, axle)
    tyre = car.tyre_stiffness_front if front else car.tyre_stiffness_rear
    radius = car.tyre_radius
    width = car.tyre_width
    cylinder = UnitInertia.SolidCylinder(radius, width, np.array([0.0, 1.0, 0.0]))
    wheel_inertial = Inertial.solid(car.wheel_mass, cylinder)
    upright = Inertial.solid(car.upright_mass, UnitInertia.SolidSphere(UPRIGHT_RADIUS))
    knuckle = Inertial.solid(car.knuckle_mass, UnitInertia.SolidSphere(KNUCKLE_RADIUS))
    for side, sign in (("left", 1), ("right", -1)):
        wheel = f"{axle}_{side}"
        position = (car.wheelbase if front else 0.0, sign * car.track / 2, statics.wheel_height)
        model.place_link(f"{wheel}_upright", upright, position)
        model.set_joint(
            f"{wheel}_suspension",
            lower=-car.suspension_travel,
            upper=car.suspension_travel,
            damping=damping,
            spring_stiffness=stiffness,
            spring_reference=statics.spring_reference,
        )
        if front:
            model.place_link(f"{wheel}_knuckle", knuckle, position)
        model.place_link(f"{wheel}_wheel", wheel_inertial, position)
        model.set_shape(f"{wheel}_wheel", "rim", radius=0.6 * radius, length=width + 0.002)
        _set_tyre(model, f"{wheel}_wheel", car, tyre)


def _set_tyre(model: SdfModel, link: str, car: CarParameters, stiffness: float) -> None:
    """Sets the shapes of one wheel.

    A cylinder stands on its two edges, each with half of the tyre's stiffness.

    Drake gives a cylinder on level ground a single contact point, which hops from edge to edge with
    the sign of the camber: roll moments up to the weight times half the width would then cost no
    roll, and each hop makes energy.
    """
    radius = car.tyre_radius
    width = car.tyre_width
    model.set_shape(link, "tyre_tread", radius=radius, length=width)
    model.set_shape(link, "spoke", size=(1.05 * radius, width + 0.004, 0.18 * radius))
    edges = {"tyre_left": width / 2 - EDGE_HALF_WIDTH, "tyre_right": EDGE_HALF_WIDTH - width / 2}
    half_width = EDGE_HALF_WIDTH
    if car.tyre_shape == "ellipsoid":
        model.remove_shapes(link, "tyre_right", "collision")
        edges = {"tyre_left": 0.0}
        half_width = width / 2
    for shape, y in edges.items():
        model.set_shape(link, shape, (0.0, y, 0.0), radii=(radius, half_width, radius))
        model.set_contact(
            link, shape, stiffness / len(edges), car.tyre_dissipation, car.tyre_friction
        )
