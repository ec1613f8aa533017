"""Numbers of many cars as arrays, read from their scenarios and from the full car: nothing is
fitted, nothing typed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.aero.section_laws import CrossedPlatesLaw, NormalForceLaw
from aerodima.workbench.car.car_air import sail_law, sail_layout
from aerodima.workbench.car.car_model import (
    EDGE_HALF_WIDTH,
    axle_statics,
    rolling_torques,
    stiction_tolerance,
    unsprung_mass,
    wheel_rates,
)
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.laws import shaft_gain, torque_speed_limits
from aerodima.workbench.car.swerve import car_outline
from aerodima.workbench.car.tail_plant import SAIL_TIP_MARGIN
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import AXLES

MIN_REGULARISATION_SPEED = 0.01
"""Least slip over which friction is spread, m/s."""
FAR_UP = 10.0
"""Height of a board that is not there, m."""
MAX_KNOWN_BODIES = 4000
"""Number of cars whose mass properties are remembered."""
_BODIES: dict[str, dict[str, Any]] = {}
"""Mass properties by the parameters that they depend on, as JSON."""


@dataclass(frozen=True)
class VehicleParams:
    """Numbers of n cars; SI units. The last axis of every field is the car.

    Attributes:
        speed: speed on the straight before the turn, m/s.
        friction: friction coefficient of the tyres.
        slip_speed: slip over which that friction is spread, m/s, see `stiction_tolerance`.
        gravity: acceleration of gravity, m/s2.
        air_density: density of the air, kg/m3.
        mass: mass of all that does not move with the tail, kg.
        centre: centre of that mass in B (3, n), m.
        inertia: inertia of that mass about the origin of B (3, 3, n), kg m2.
        com_x: distance of the centre of mass of the car without tail arm, whose course counts,
            ahead of the origin of B, m.
        outline: corners of the car as seen from above, in B (2, corners, n), m.
        wheel: places of the wheels' centres in B (3, 4, n), m.
        tyre_radius, tyre_half_width: half axes of the ellipsoids that the tyres stand on, m.
        edge: distance of these ellipsoids from the wheel's middle, m, one to either side.
        tyre_stiffness: stiffness of one edge of a tyre (4, n), N/m.
        tyre_dissipation: dissipation of a tyre, s/m.
        spring, damper, preload: stiffness, damping and preload of one wheel's suspension (4, n),
            N/m, N s/m, N.
        unsprung: mass that hangs on that suspension (4, n), kg.
        rolling: torque against the rolling of a wheel (4, n), N m.
        wheel_inertia: inertia of one wheel about its axle, kg m2.
        shaft_inertia: inertia of the drive, kg m2.
        shaft_gain: torque of the drive per speed error, N m s/rad.
        shaft_limit: largest torque of the drive, N m.
        rolling_radius: rolling radius of the rear wheels, m.
        board: rear corners of the anti-ramp board in B (3, 2, n), m, radius included; far above
            without a board.
        board_friction: friction coefficient of the board on the ground.
        has_tail: 1 with a tail, 0 without.
        mount: crossing of the tail's joint axes in B (3, n), m.
        tail_mass: mass of the tail beyond its joints, kg.
        tail_centre: distance of that mass from the joints, m.
        tail_inertia: inertia of that mass about the joints in tail axes (3, n), kg m2.
        hub_inertia: inertia of the hub about the pitch axis, kg m2.
        rotor_inertia: inertia of a motor at its joint, kg m2.
        coulomb, viscous, tanh_gain: friction of a joint, N m, N m s/rad, s/rad.
        torque_limit: peak torque of a motor, N m.
        stall_torque: stall torque of a motor, N m.
        no_load_speed: no-load speed of a motor, rad/s.
        torque_scale: ratio of true to nominal torque of a motor.
        roll_stop, pitch_limit: largest angles of the roll and pitch joints, rad.
        tip: distance of the sail's corners from the joints, and from the tail's axis (2, n), m.
        section_distances, section_areas: distances from the joints and areas of the sections of
            the sail (sections, n), m and m2.
        force_across, force_chord: C_N along the sail's normal and its chord.
    """

    speed: FloatArray
    friction: FloatArray
    slip_speed: FloatArray
    gravity: FloatArray
    air_density: FloatArray
    mass: FloatArray
    centre: FloatArray
    inertia: FloatArray
    com_x: FloatArray
    outline: FloatArray
    wheel: FloatArray
    tyre_radius: FloatArray
    tyre_half_width: FloatArray
    edge: FloatArray
    tyre_stiffness: FloatArray
    tyre_dissipation: FloatArray
    spring: FloatArray
    damper: FloatArray
    preload: FloatArray
    unsprung: FloatArray
    rolling: FloatArray
    wheel_inertia: FloatArray
    shaft_inertia: FloatArray
    shaft_gain: FloatArray
    shaft_limit: FloatArray
    rolling_radius: FloatArray
    board: FloatArray
    board_friction: FloatArray
    has_tail: FloatArray
    mount: FloatArray
    tail_mass: FloatArray
    tail_centre: FloatArray
    tail_inertia: FloatArray
    hub_inertia: FloatArray
    rotor_inertia: FloatArray
    coulomb: FloatArray
    viscous: FloatArray
    tanh_gain: FloatArray
    torque_limit: FloatArray
    stall_torque: FloatArray
    no_load_speed: FloatArray
    torque_scale: FloatArray
    roll_stop: FloatArray
    pitch_limit: FloatArray
    tip: FloatArray
    section_distances: FloatArray
    section_areas: FloatArray
    force_across: FloatArray
    force_chord: FloatArray

    @property
    def count(self) -> int:
        """Returns the number of cars."""
        return len(self.mass)

    @classmethod
    def from_scenarios(cls, scenarios: Sequence[Scenario]) -> VehicleParams:
        """Reads the cars of scenarios.

        Raises:
            UserError: a scenario has what the model does not know (free sail, added mass, wind,
                coefficients that are no constants, another linkage or manoeuvre); says what it
                knows.
            ModelError: the full car does not load.
        """
        cars = []
        for scenario in scenarios:
            _refuse_unknown(scenario)
            cars.append(_car(scenario) | _tail(scenario) | _known_bodies(scenario))
        return cls(
            **{
                name: np.stack([np.array(car[name], float) for car in cars], axis=-1)
                for name in cars[0]
            }
        )


def take(batch: Any, places: Any) -> Any:
    """Returns a batch, with all its parts, reduced to the cars at these places."""
    if isinstance(batch, np.ndarray):
        return batch[..., places]
    return type(batch)(**{name: take(value, places) for name, value in vars(batch).items()})


def _car(scenario: Scenario) -> dict[str, Any]:
    car = scenario.car
    drive = scenario.drive
    gravity = scenario.environment.gravity
    front, rear = (axle_statics(car, gravity, axle) for axle in AXLES)
    spring, damper = zip(*(wheel_rates(car, axle) for axle in AXLES), strict=True)
    rolling = rolling_torques(car, gravity)
    half_track = 0.5 * car.track
    ellipsoid = car.tyre_shape == "ellipsoid"
    board_x = car.board_x + car.board_thickness / 2
    board_y = car.board_width / 2 - car.board_thickness / 2
    low = car.board_height if car.board else FAR_UP
    speed = scenario.manoeuvre.speed
    return {
        "speed": speed,
        "friction": car.tyre_friction,
        "slip_speed": max(MIN_REGULARISATION_SPEED, stiction_tolerance(car, speed)),
        "gravity": gravity,
        "air_density": scenario.environment.air_density,
        "com_x": car.com_x,
        "outline": car_outline(car),
        "wheel": [
            _both_sides(car.wheelbase, 0.0),
            [half_track, -half_track] * 2,
            _both_sides(front.wheel_height, rear.wheel_height),
        ],
        "tyre_radius": car.tyre_radius,
        "tyre_half_width": car.tyre_width / 2 if ellipsoid else EDGE_HALF_WIDTH,
        "edge": 0.0 if ellipsoid else car.tyre_width / 2 - EDGE_HALF_WIDTH,
        "tyre_stiffness": _both_sides(car.tyre_stiffness_front / 2, car.tyre_stiffness_rear / 2),
        "tyre_dissipation": car.tyre_dissipation,
        "spring": _both_sides(*spring),
        "damper": _both_sides(*damper),
        "preload": _both_sides(
            -spring[0] * front.spring_reference, -spring[1] * rear.spring_reference
        ),
        "unsprung": _both_sides(*(unsprung_mass(car, axle) for axle in AXLES)),
        "rolling": _both_sides(rolling["front"], rolling["rear"]),
        "wheel_inertia": 0.5 * car.wheel_mass * car.tyre_radius**2,
        "shaft_inertia": drive.rotor_inertia,
        "shaft_gain": shaft_gain(drive, car),
        "shaft_limit": drive.torque_limit,
        "rolling_radius": rear.wheel_height,
        "board_friction": car.cage_friction,
        "board": [(board_x, board_x), (board_y, -board_y), (low, low)],
    }


def _both_sides(front: float, rear: float) -> list[float]:
    """Returns the numbers of the four wheels of two axles."""
    return [front, front, rear, rear]


def _known_bodies(scenario: Scenario) -> dict[str, Any]:
    """Returns `_bodies`, remembered: they do not depend on the tyres' friction, and they take most
    of the time of a car that drives once.
    """
    key = scenario.model_dump_json(
        include={"car", "tail", "tail_motor", "environment", "drive"},
        exclude={"car": {"tyre_friction", "tyre_slip_angle"}, "drive": {"governor"}},
    )
    if key not in _BODIES:
        if len(_BODIES) >= MAX_KNOWN_BODIES:
            _BODIES.clear()
        _BODIES[key] = _bodies(scenario)
    return _BODIES[key]


def _bodies(scenario: Scenario) -> dict[str, Any]:
    """Returns mass properties of car and arm, from the full car."""
    built = add_car_plant(DiagramBuilder(), scenario, drawn=False)
    plant = built.plant
    context = built.plant.CreateDefaultContext()

    def inertia_of(frame: str, bodies: list[Any]) -> SpatialInertia:
        return plant.CalcSpatialInertia(context, plant.GetBodyByName(frame).body_frame(), bodies)

    def indices(*names: str) -> list[Any]:
        return [plant.GetBodyByName(name).index() for name in names]

    bodies = list(plant.GetBodyIndices(built.car))
    arm = {"tail_mass": 0.0, "tail_centre": 0.0, "tail_inertia": np.zeros(3), "hub_inertia": 0.0}
    if built.tail is not None:
        for name in ("tail_roll", "tail_pitch"):
            joint: Any = plant.GetJointByName(name)
            joint.set_angle(context, 0.0)
        bodies += indices("tail_anchor", "tail_hub")
        M_TTo_T = inertia_of("tail_rod", indices("tail_rod", "tail_sail"))
        hub = plant.GetBodyByName("tail_hub").default_rotational_inertia()
        arm = {
            "tail_mass": M_TTo_T.get_mass(),
            "tail_centre": M_TTo_T.get_com()[2],
            "tail_inertia": M_TTo_T.CalcRotationalInertia().get_moments(),
            "hub_inertia": hub.get_moments()[1],
        }
    M_BBo_B = inertia_of("chassis", bodies)
    inertia = M_BBo_B.CalcRotationalInertia().CopyToFullMatrix3()
    return arm | {"mass": M_BBo_B.get_mass(), "centre": M_BBo_B.get_com(), "inertia": inertia}


def _tail(scenario: Scenario) -> dict[str, Any]:
    tail = scenario.tail
    motor = scenario.tail_motor
    friction = scenario.friction
    stall, no_load = torque_speed_limits(motor)
    layout = sail_layout(tail)
    (across, chord) = _coefficients(sail_law(tail)[0])
    return {
        "has_tail": float(scenario.has_tail),
        "mount": (tail.mount_x, 0.0, tail.mount_height),
        "rotor_inertia": motor.reflected_inertia,
        "coulomb": friction.coulomb,
        "viscous": friction.viscous,
        "tanh_gain": friction.tanh_gain,
        "torque_limit": motor.torque_limit,
        "stall_torque": stall,
        "no_load_speed": no_load,
        "torque_scale": 1.0 + motor.torque_error,
        "roll_stop": tail.roll_stop,
        "pitch_limit": tail.pitch_limit,
        "tip": (tail.length - SAIL_TIP_MARGIN, tail.sail_width / 2 - SAIL_TIP_MARGIN),
        "section_distances": layout.distances,
        "section_areas": np.array(layout.areas) * scenario.has_tail,
        "force_across": across,
        "force_chord": chord,
    }


def _coefficients(law: object) -> Pair:
    # A sail that faces the wind has one drag in every direction.
    if isinstance(law, CrossedPlatesLaw):
        return _coefficients(law.normal)[0], _coefficients(law.side)[0]
    if isinstance(law, NormalForceLaw) and not callable(law.coefficient):
        return float(law.coefficient), 0.0
    raise UserError("tail.coefficients: the reduced car knows constants of a normal-force law")


def _refuse_unknown(scenario: Scenario) -> None:
    tail = scenario.tail
    if scenario.car.has_bodies:
        raise UserError(f"car.bodies: {scenario.car.bodies}; the reduced car knows: none")
    if scenario.has_tail and tail.sail == "free":
        raise UserError("tail.sail: 'free'; the reduced car knows: facing, locked")
    if scenario.has_tail and tail.added_mass != 0.0:
        raise UserError(f"tail.added_mass: {tail.added_mass:g} kg; the reduced car knows: 0 kg")
    if not scenario.wind.is_still:
        raise UserError("wind: blows in this scenario; the reduced car knows still air")
    if scenario.servo.linkage != "parallel":
        raise UserError(
            f"servo.linkage: {scenario.servo.linkage!r}; the reduced car knows: parallel"
        )
    manoeuvre = scenario.manoeuvre
    from_rest = not manoeuvre.rolling_start and manoeuvre.turns == 1
    if manoeuvre.direction != "left" or not (
        manoeuvre.kind == "levels" or (manoeuvre.kind == "turn" and from_rest)
    ):
        raise UserError(
            "manoeuvre: the reduced car knows: direction left; kind levels, or turn with "
            "rolling_start false, turns 1"
        )
