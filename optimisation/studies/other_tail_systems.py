"""Tails of other people, built from `models/other_tails`, and what our simulation makes of each: figure -> value.

The squirrel robot, the gecko and XRL are inertial tails (no air). The drag tail and the robot with a sail try what is
published about size; for those the exponents are ours, not the values they are tried at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import SpatialInertia, UnitInertia

from aerodima.optimisation.studies.tail_steering import steer_by_tail
from aerodima.optimisation.studies.tailed_body import (
    Swing,
    TailAir,
    TailedBody,
    at,
    combined,
    moment_about,
    placed,
    swing_tail,
)
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.config.scenario_file import ParameterEntry, load_parameter_file
from aerodima.workbench.resources import model_path

Values = Mapping[str, float]
PITCH, ROLL, YAW = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
"""Axes of hinges."""
LARGER = 1.25
"""Factor by which a size is made larger and smaller to find an exponent."""


@dataclass(frozen=True)
class Measured:
    """A figure of ours; `low` and `high` over what had to be assumed, None where nothing was."""

    value: float
    low: float | None = None
    high: float | None = None


def entries(system: str) -> dict[str, ParameterEntry]:
    """Parameters of a system with unit and source.

    Raises:
        UserError: no such file, or a number without unit or source; names the key.
    """
    return load_parameter_file(model_path(f"other_tails/{system}.yaml"))


def values_of(system: str) -> dict[str, float]:
    """Parameters of a system as numbers."""
    return {key: float(entry.value) for key, entry in entries(system).items()}


def squirrel_robot(values: Values, pose: str = "flight", *, tip: bool = True) -> TailedBody:
    """The squirrel robot with its leg held in a pose, `home` or `flight`; the tail with its tip mass or without."""
    v = values
    semi_axes = (v["trunk_semi_axis_x"], v["trunk_semi_axis_y"], v["trunk_semi_axis_z"])
    trunk = SpatialInertia.SolidEllipsoidWithMass(v["trunk_mass"], *semi_axes)
    parts = [at(trunk, (v["trunk_x"], 0.0, v["trunk_z"]))]
    X_BP, above = RigidTransform(), 0.0
    pads = {"metatarsus": ("heel_pad", 0.0), "phalanx": ("toe_pad", -v["phalanx_length"])}
    for joint, bone in (("hip", "femur"), ("knee", "tibia"), ("ankle", "metatarsus"), ("toes", "phalanx")):
        turned = RollPitchYaw(0.0, math.radians(v[f"{pose}_{joint}"]), 0.0)
        X_BP = X_BP @ RigidTransform(turned, np.array([0.0, 0.0, -above]))
        above, radius = v[f"{bone}_length"], v["phalanx_radius" if bone == "phalanx" else "leg_radius"]
        capsule = SpatialInertia.SolidCapsuleWithMass(v[f"{bone}_mass"], radius, above, np.array(YAW))
        parts.append(placed(at(capsule, (0.0, 0.0, -above / 2.0)), X_BP))
        if bone in pads:
            pad, height = pads[bone]
            ball = SpatialInertia.SolidSphereWithMass(v[f"{pad}_mass"], v[f"{pad}_radius"])
            parts.append(placed(at(ball, (0.0, 0.0, height)), X_BP))
    length = v["tail_length"]
    rod = SpatialInertia.SolidCapsuleWithMass(v["tail_rod_mass"], v["tail_radius"], length, np.array(ROLL))
    end = SpatialInertia.SolidSphereWithMass(v["tail_tip_mass"], v["tail_tip_radius"])
    tail = [at(rod, (-length / 2.0, 0.0, 0.0)), *([at(end, (-length, 0.0, 0.0))] if tip else [])]
    return TailedBody(combined(parts), combined(tail), (v["tail_root_x"], 0.0, v["tail_root_z"]), PITCH)


def measure_squirrel_robot() -> dict[str, Measured]:
    """Inertias of its home pose, and the turn of its body in flight with the tip mass and without."""
    v = values_of("squirrel_robot")
    home = squirrel_robot(v, "home")
    whole, centre = home.locked(), home.locked().get_com()
    trunk = SpatialInertia.SolidEllipsoidWithMass(
        v["trunk_mass"], v["trunk_semi_axis_x"], v["trunk_semi_axis_y"], v["trunk_semi_axis_z"]
    )
    swing = Swing(math.radians(v["swing_start"]), math.radians(v["swing_end"]), v["swing_time"])
    loaded, bare = (swing_tail(squirrel_robot(v, tip=tip), swing) for tip in (True, False))
    hinge_moment = moment_about(home.tail, PITCH)
    return {
        "squirrel_tail_com": Measured(-1e3 * float(home.tail.get_com()[0])),
        "squirrel_tail_inertia": Measured(1e3 * hinge_moment),
        "squirrel_inertia_ratio": Measured(hinge_moment / moment_about(trunk, PITCH)),
        "squirrel_com_x": Measured(1e3 * float(centre[0])),
        "squirrel_com_height": Measured(1e3 * (v["hip_height"] + float(centre[2]))),
        "squirrel_whole_inertia": Measured(1e3 * moment_about(whole, PITCH, central=True)),
        "squirrel_authority": Measured(loaded.turn_per_tail),
        "squirrel_tip_gain": Measured(loaded.turn_per_tail / bare.turn_per_tail),
    }


def gecko(values: Values) -> TailedBody:
    """The gecko with its legs spread, the tail across its body."""
    v = values
    size = (v["body_length"], v["body_width"], v["body_thickness"])
    parts = [at(SpatialInertia.SolidBoxWithMass(v["body_mass"], *size), (0.0, 0.0, 0.0))]
    for leg, end in (("rear", -0.5), ("fore", 0.5)):
        for side in (-1.0, 1.0):
            angle = math.radians(v["leg_spread"])
            along = np.array([math.copysign(math.cos(angle), end), side * math.sin(angle), 0.0])
            mass, length, radius = v[f"{leg}_leg_mass"], v[f"{leg}_leg_length"], v[f"{leg}_leg_width"] / 2.0
            limb = SpatialInertia.SolidCylinderWithMass(mass, radius, length, along)
            corner = np.array([end * v["body_length"], side * v["body_width"] / 2.0, 0.0])
            parts.append(at(limb, corner + 0.5 * length * along))
    mass, length = v["tail_factor"] * v["tail_mass"], v["tail_factor"] * v["tail_length"]
    radius = v["tail_diameter"] / 2.0
    across = 3.0 / 80.0 * length**2 + 3.0 / 20.0 * radius**2  # solid cone about its centre, a quarter up
    along_axis = 3.0 / 10.0 * radius**2
    cone = UnitInertia(across, across, along_axis).ShiftFromCenterOfMass(np.array([0.0, 0.0, -length / 4.0]))
    tail = SpatialInertia(mass, np.array([0.0, 0.0, length / 4.0]), cone)
    return TailedBody(combined(parts), tail, (-v["body_length"] / 2.0, 0.0, 0.0), ROLL)


def measure_gecko() -> dict[str, Measured]:
    """Roll by one turn of the tail across the body, and by the half turn of Jusufi's scenario."""
    v = values_of("gecko")
    spread = entries("gecko")["leg_spread"].prior or (v["leg_spread"],) * 2

    def roll(**changed: float) -> float:
        swing = Swing(0.0, math.radians(v["tail_turn"]), v["swing_time"])
        return abs(math.degrees(swing_tail(gecko({**v, **changed}), swing).turn[-1]))

    rolls = [roll(), roll(leg_spread=spread[0]), roll(tail_factor=1.0)]
    quarter = math.pi / 2.0
    half = swing_tail(gecko(v), Swing(-quarter, quarter, v["swing_time"]))
    return {
        "gecko_roll": Measured(rolls[0], min(rolls), max(rolls)),
        "gecko_jusufi_roll": Measured(abs(math.degrees(half.rpy[-1, 0] - half.rpy[0, 0]))),
    }


def xrl(values: Values) -> TailedBody:
    """XRL: an even box, and a point mass at the end of a weightless tube."""
    v = values
    body = SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1e-3, v["body_height"])
    tail = at(
        SpatialInertia.SolidSphereWithMass(v["tail_mass"], 1e-3 * v["tail_length"]), (-v["tail_length"], 0.0, 0.0)
    )
    return TailedBody(body, tail, (-v["hinge_behind_centre"], 0.0, 0.0), PITCH)


def measure_xrl() -> dict[str, Measured]:
    """Turn of the body over the turn of the tail in space, which is the ratio of their inertias."""
    v, known = values_of("xrl"), entries("xrl")
    swing = Swing(-math.radians(v["swing"]) / 2.0, math.radians(v["swing"]) / 2.0, v["swing_time"])

    def ratio(**changed: float) -> float:
        turn = swing_tail(xrl({**v, **changed}), swing).turn_per_tail
        return -turn / (1.0 + turn)

    varied = [(key, end) for key in ("body_height", "hinge_behind_centre") for end in known[key].prior or ()]
    around = [ratio(**{key: end}) for key, end in varied]
    return {"xrl_effectiveness": Measured(ratio(), min(around), max(around))}


def measure_drag_tail() -> dict[str, Measured]:
    """Exponents of the impulse of the air over a swing of a plate about a fixed hinge."""
    v = values_of("drag_tail")
    swing = Swing(0.0, math.radians(v["swing"]), v["swing_time"])

    def impulse(length: float = 1.0, width: float = 1.0, drag: float = 1.0, mass: float = 1.0) -> float:
        long, wide = length * v["length"], width * v["width"]
        plate = SpatialInertia.SolidBoxWithMass(mass * v["mass"], wide, 1e-3, long)
        layout = SectionLayout.strip(start=0.0, length=long, width=wide, number=10, normal_B=(0.0, 1.0, 0.0))
        stand = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
        system = TailedBody(stand, at(plate, (0.0, 0.0, long / 2)), (0.0, 0.0, 0.0), ROLL)
        air = TailAir(layout, drag * v["normal_force_coefficient"])
        return abs(swing_tail(system, swing, air, held=True).air_impulse)

    return {
        "drag_length": exponent(lambda k: impulse(length=k)),
        "drag_length_and_width": exponent(lambda k: impulse(length=k, width=k)),
        "drag_width": exponent(lambda k: impulse(width=k)),
        "drag_coefficient": exponent(lambda k: impulse(drag=k)),
        "drag_mass": exponent(lambda k: impulse(mass=k)),
    }


def measure_sail_robot() -> dict[str, Measured]:
    """Exponent of the yaw acceleration by a sail over the size of a robot of one shape and density, at one speed."""
    v = values_of("sail_robot")

    def yaw_acceleration(size: float) -> float:
        long, wide = size * v["sail_length"], size * v["sail_width"]
        angle = math.radians(v["sail_angle"])
        plan = (size * v["length"], size * v["width"], size * v["width"])
        body = SpatialInertia.SolidBoxWithMass(size**3 * v["mass"], *plan)
        film = SpatialInertia.SolidBoxWithMass(size**3 * v["sail_mass"], long, 1e-3 * size, wide)
        layout = SectionLayout.strip(
            start=0.0, length=long, width=wide, number=10, axis_B=(-1.0, 0.0, 0.0), normal_B=(0.0, 1.0, 0.0)
        )
        system = TailedBody(body, at(film, (-long / 2, 0, 0)), (-size * v["length"] / 2, 0, 0), YAW)
        air = TailAir(layout, v["normal_force_coefficient"], (-v["speed"], 0.0, 0.0))
        motion = swing_tail(system, Swing(angle, angle, v["time"]), air)
        return abs(2.0 * float(motion.turn[-1]) / float(motion.time[-1]) ** 2)

    return {"sail_size": exponent(yaw_acceleration)}


def exponent(measured: Callable[[float], float]) -> Measured:
    """Exponent of a quantity over a factor of size, between a smaller and a larger one."""
    small, large = measured(1.0 / LARGER), measured(LARGER)
    return Measured(math.log(large / small) / (2.0 * math.log(LARGER)))


def measure_taylroach() -> dict[str, Measured]:
    """Radius, Kohut metric and change of speed of a turn whose angle and mean yaw rate are put in."""
    turn = steer_by_tail(values_of("taylroach"))
    return {
        "taylroach_radius": Measured(turn.radius_in_lengths),
        "taylroach_kohut": Measured(turn.kohut),
        "taylroach_speed_change": Measured(turn.speed_change_percent),
    }


SYSTEMS: dict[str, Callable[[], dict[str, Measured]]] = {
    "squirrel robot": measure_squirrel_robot,
    "gecko": measure_gecko,
    "XRL": measure_xrl,
    "Minitaur's drag tail": measure_drag_tail,
    "SailRoACH": measure_sail_robot,
    "TAYLRoACH": measure_taylroach,
}
"""System -> what measures its figures, by the ids of `models/published/other_tails.csv`."""
