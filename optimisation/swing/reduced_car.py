"""The car as the reduced model sees it: masses, levers and springs of the full car, and how it lifts and leans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.actuators.ak70 import torque_speed_limits
from aerodima.workbench.aero.laws import CrossedPlatesLaw, NormalForceLaw, TwoSidedLaw
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import AXLES
from aerodima.workbench.errors import SwingError
from aerodima.workbench.plants.car import add_car_plant
from aerodima.workbench.plants.car_model import wheel_rates
from aerodima.workbench.stations.car_air import sail_law, sail_layout

Array = NDArray  # float64, or complex128 in a complex step

LIFT_WIDTH = 0.012
"""Roll over which the inner tyres leave the ground, rad: width of a smooth step."""
LOAD_ROUNDING = 0.15
"""Rounding of the corner where an inner tyre's load becomes zero, as a share of the load."""


@dataclass(frozen=True)
class ReducedCar:
    """Numbers of the reduced model; SI units. Nothing is typed here: `of` reads the full car.

    Attributes:
        mass: of all that does not move with the tail, kg.
        com_height, com_x: of that mass above the ground at nominal ride height and ahead of the rear axle, m.
        wheelbase: m.
        inertia: of it about its own centre of mass, forward axis, kg m2.
        half_track: m; the centre of mass stands this far inside the outer contact line.
        tyre_radius, tyre_half_width: half axes of the tyre's ellipsoid, m; of no width for the edge of a cylinder.
        wheel_spin_inertia: of the four wheels about their axles together, kg m2.
        side_stiffness: suspension and tyres of one side in series, both axles, at the lever of `half_track`, N/m.
        side_damping: suspension of one side, both axles, alike, N s/m.
        axis_height, axis_x: of the tail's joints above the ground and ahead of the rear axle, m.
        tail_mass: of rod and sail, kg; `tail_com` its centre on the tail's axis from the joints, m.
        tail_inertia: of rod and sail about the joints, tail axes x (roll), y, z (along the tail), kg m2.
        hub_inertia: of the hub about the pitch axis, kg m2.
        rotor_inertia: of one motor, reflected to its joint, kg m2.
        tail_length: m; `sail_half_width` m.
        section_distances, section_areas: of the sail from the joints, m, and m2, shape (n,).
        force_along, force_against: C_N for air along and against the sail's normal; `force_chord` along its chord, 0
            unless the sail faces the wind.
        normal_side: +1 or -1, direction of that normal along y of an upright tail.
        coulomb, viscous, tanh_gain: friction of a tail joint, N m, N m s/rad, s/rad.
        torque_limit: N m; `stall_torque` N m and `no_load_speed` rad/s of the torque-speed line.
        roll_limit, pitch_limit: tail range to either side, rad.
        gravity: m/s2; `air_density` kg/m3.
    """

    mass: float
    com_height: float
    com_x: float
    wheelbase: float
    inertia: float
    half_track: float
    tyre_radius: float
    tyre_half_width: float
    wheel_spin_inertia: float
    side_stiffness: float
    side_damping: float
    axis_height: float
    axis_x: float
    tail_mass: float
    tail_com: float
    tail_inertia: tuple[float, float, float]
    hub_inertia: float
    rotor_inertia: float
    tail_length: float
    sail_half_width: float
    section_distances: tuple[float, ...]
    section_areas: tuple[float, ...]
    force_along: float
    force_against: float
    force_chord: float
    normal_side: float
    coulomb: float
    viscous: float
    tanh_gain: float
    torque_limit: float
    stall_torque: float
    no_load_speed: float
    roll_limit: float
    pitch_limit: float
    gravity: float
    air_density: float

    @classmethod
    def of(cls, scenario: Scenario) -> ReducedCar:
        """The reduced car of a scenario.

        Raises:
            SwingError: the car has no tail, or one that the reduced model does not know (free sail, added mass,
                tables of coefficients, wind).
            ModelError: the full car does not load.
        """
        _refuse_unknown(scenario)
        built = add_car_plant(DiagramBuilder(), scenario.varied(tail={"mode": "swing"}))
        plant, tail, car = built.plant, scenario.tail, scenario.car
        context = plant.CreateDefaultContext()
        for name in ("tail_roll", "tail_pitch"):
            joint: Any = plant.GetJointByName(name)
            joint.set_angle(context, 0.0)
        bodies = [
            *plant.GetBodyIndices(built.car),
            *(plant.GetBodyByName(name).index() for name in ("tail_anchor", "tail_hub")),
        ]
        M_BBo_B = plant.CalcSpatialInertia(context, plant.GetBodyByName("chassis").body_frame(), bodies)
        p_BoBcm = M_BBo_B.get_com()
        I_BBcm = M_BBo_B.Shift(p_BoBcm).CalcRotationalInertia()
        arm = [plant.GetBodyByName(name).index() for name in ("tail_rod", "tail_sail")]
        M_TTo_T = plant.CalcSpatialInertia(context, plant.GetBodyByName("tail_rod").body_frame(), arm)
        J_x, J_y, J_z = M_TTo_T.CalcRotationalInertia().get_moments()
        hub = plant.GetBodyByName("tail_hub").default_rotational_inertia()
        wheels = [
            plant.GetBodyByName(f"{axle}_{side}_wheel") for axle in ("front", "rear") for side in ("left", "right")
        ]
        law, _ = sail_law(tail)
        layout = sail_layout(tail)
        along, against, chord = _coefficients(law)
        springs, dampers = zip(*(wheel_rates(car, axle) for axle in AXLES), strict=True)
        lever = 0.5 * car.track / car.outer_half_track
        stall, no_load = torque_speed_limits(scenario.tail_motor)
        return cls(
            mass=float(M_BBo_B.get_mass()),
            com_height=float(p_BoBcm[2]),
            com_x=float(p_BoBcm[0]),
            wheelbase=car.wheelbase,
            inertia=float(I_BBcm.get_moments()[0]),
            half_track=car.outer_half_track,
            tyre_radius=car.tyre_radius,
            tyre_half_width=car.track / 2 + car.tyre_width / 2 - car.outer_half_track,
            wheel_spin_inertia=float(sum(wheel.default_rotational_inertia().get_moments()[1] for wheel in wheels)),
            side_stiffness=lever**2
            * (_series(springs[0], car.tyre_stiffness_front) + _series(springs[1], car.tyre_stiffness_rear)),
            side_damping=lever**2 * sum(dampers),
            axis_height=tail.mount_height,
            axis_x=tail.mount_x,
            tail_mass=float(M_TTo_T.get_mass()),
            tail_com=float(M_TTo_T.get_com()[2]),
            tail_inertia=(float(J_x), float(J_y), float(J_z)),
            hub_inertia=float(hub.get_moments()[1]),
            rotor_inertia=scenario.tail_motor.rotor_inertia * scenario.tail_motor.gear_ratio**2,
            tail_length=tail.length,
            sail_half_width=tail.sail_width / 2,
            section_distances=tuple(float(s) for s in layout.distances),
            section_areas=tuple(float(area) for area in layout.areas),
            force_along=along,
            force_against=against,
            force_chord=chord,
            normal_side=float(layout.normal_B[1]),
            coulomb=scenario.friction.coulomb,
            viscous=scenario.friction.viscous,
            tanh_gain=scenario.friction.tanh_gain,
            torque_limit=scenario.tail_motor.torque_limit,
            stall_torque=stall,
            no_load_speed=no_load,
            roll_limit=tail.roll_limit,
            pitch_limit=tail.pitch_limit,
            gravity=scenario.environment.gravity,
            air_density=scenario.environment.air_density,
        )


def lift_roll(car: ReducedCar) -> float:
    """Roll at which the inner tyres leave the ground in a slow turn, rad."""
    return (car.mass + car.tail_mass) * car.gravity / (2 * car.half_track * car.side_stiffness)


def lift_state(roll: Array, car: ReducedCar) -> tuple[Array, Array, Array]:
    """Compression of the outer side (m), share of the lift (0 inner tyres loaded, 1 lifted) and its slope (1/rad)."""
    x = np.exp((roll - lift_roll(car)) / LIFT_WIDTH)  # up to e^260 for a car on its roof
    share = 1.0 - 1.0 / (1.0 + x)
    return car.half_track * (roll - LIFT_WIDTH * np.log(1.0 + x)), share, share * (1.0 - share) / LIFT_WIDTH


def wheel_height(s: Array, c: Array, car: ReducedCar) -> tuple[Array, Array, Array]:
    """Height of the outer wheels' centres over the ground for an ellipsoid tyre, m, and its slopes with roll."""
    R2, w2 = car.tyre_radius**2, car.tyre_half_width**2
    height = np.sqrt(R2 * c * c + w2 * s * s)
    slope = -(R2 - w2) * s * c / height
    return height, slope, (-(R2 - w2) * (c * c - s * s) - slope * slope) / height


def suspension_moment(roll: Array, roll_rate: Array, lifted: Array, car: ReducedCar) -> Array:
    """Moment of springs and dampers about the body's middle, N m: load moved outwards, at most all of it."""
    weight = (car.mass + car.tail_mass) * car.gravity
    moved = 2 * car.half_track * (car.side_stiffness * roll + car.side_damping * roll_rate) / weight
    clipped = 0.5 * (np.sqrt((moved + 1) ** 2 + LOAD_ROUNDING**2) - np.sqrt((moved - 1) ** 2 + LOAD_ROUNDING**2))
    return -weight * car.half_track * (1.0 - lifted) * clipped


def _refuse_unknown(scenario: Scenario) -> None:
    tail = scenario.tail
    if tail.mode == "none":
        raise SwingError("tail.mode: 'none', the car has no tail to swing; allowed: held, swing")
    if tail.sail == "free":
        raise SwingError("tail.sail: 'free'; the reduced model knows: facing, locked")
    if tail.added_mass != 0.0:
        raise SwingError(f"tail.added_mass: {tail.added_mass:g} kg; the reduced model knows: 0 kg")
    if not scenario.wind.is_still:
        raise SwingError("wind: blows in this scenario; the reduced model knows still air")


def _coefficients(law: object) -> tuple[float, float, float]:
    """C_N of both sides of the sail and along its chord; SwingError for a law that is not made of constants."""
    if isinstance(law, CrossedPlatesLaw):  # a sail that faces the wind has one drag in every direction
        along, against, _ = _coefficients(law.normal)
        return along, against, _coefficients(law.side)[0]
    if isinstance(law, TwoSidedLaw):
        return law.along_normal, law.against_normal, 0.0
    if isinstance(law, NormalForceLaw) and not callable(law.coefficient):
        return float(law.coefficient), float(law.coefficient), 0.0
    raise SwingError(
        "tail.coefficients: depend on speed or angle; the reduced model knows constants and two-sided sets"
    )


def _series(first: float, second: float) -> float:
    return first * second / (first + second)
