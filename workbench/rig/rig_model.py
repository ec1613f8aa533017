"""The rigs' SDF models (models/rig) with the numbers of a scenario, and the places of their parts.

Link frames: `mount` at W, the force sensor's point; `bar` (or the robot's `tail`) on the motor
axis; the cheetah `tail` at its root. Everything hangs along -z at angle zero. Signs: design
section 4.
"""

import numpy as np
from pydrake.multibody.tree import UnitInertia

from aerodima.workbench.aero.tail_mass import inertial_of_inertia, total_inertia
from aerodima.workbench.car.tail_plant import ROD_RADIUS
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.sdf_model import Inertial, SdfModel
from aerodima.workbench.rig.rig_layout import pivot_position
from aerodima.workbench.scenario.rig_scenario import (
    BarParameters,
    CheetahTailParameters,
    MountParameters,
    RigScenario,
)
from aerodima.workbench.scenario.tail_parameters import TailParameters

CHEETAH_RIG_SDF = "rig/cheetah_rig.sdf"
ROBOT_RIG_SDF = "rig/robot_rig.sdf"
DIGITS = 12
"""Digits of the numbers in these models; a comparison of motions to 1e-9 needs as many."""


def mount_properties(mount: MountParameters) -> Inertial:
    """Returns mass and inertia of the mounting structure, in W."""
    moments = (mount.inertia_xx, mount.inertia_yy, mount.inertia_zz)
    products = (mount.inertia_xy, mount.inertia_xz, mount.inertia_yz)
    return Inertial(mount.mass, (mount.com_x, mount.com_y, mount.com_z), moments, products)


def bar_properties(bar: BarParameters) -> Inertial:
    """Returns mass, centre of mass from the pivot, and inertia of the bar."""
    moments = (bar.inertia_xx, bar.inertia_yy, bar.inertia_zz)
    return Inertial(bar.mass, (0.0, 0.0, -bar.com_distance), moments)


def cheetah_tail_properties(tail: CheetahTailParameters) -> Inertial:
    """Returns mass, centre of mass from the root, and inertia of a cheetah tail, m L^2 / 12 about
    its centre of mass.

    The inertia of Table 4.2 cannot be about that point (ERRATA E10). About its own axis the tail
    has the inertia of an elliptic cylinder, which no experiment on the rig feels.
    """
    across = tail.mass * tail.length**2 / 12
    along = tail.mass * (tail.major_axis**2 + tail.minor_axis**2) / 16
    return Inertial(tail.mass, (0.0, 0.0, -tail.com_distance), (across, across, along))


def robot_tail_properties(tail: TailParameters) -> Inertial:
    """Returns mass, centre of mass from the motor axis, and inertia of the robot's rod and sail, a
    plate without thickness, as one body.
    """
    sail_mass = tail.mass * tail.sail_mass_fraction
    rod_mass = tail.mass - sail_mass
    across = rod_mass * tail.length**2 / 12
    moments = (across, across, 0.5 * rod_mass * ROD_RADIUS**2)
    rod = Inertial(rod_mass, (0.0, 0.0, -tail.length / 2), moments)
    plate = UnitInertia.SolidBox(tail.sail_width, 0.0, tail.sail_length)
    sail = Inertial.solid(sail_mass, plate, (0.0, 0.0, tail.sail_length / 2 - tail.length))
    return inertial_of_inertia(total_inertia((rod.about_origin(), sail.about_origin())))


def cheetah_rig_sdf(scenario: RigScenario) -> SdfModel:
    """Makes the model of mount and bar, with the tail of the experiment if it has one."""
    model = SdfModel(model_path(CHEETAH_RIG_SDF), DIGITS)
    model.place_link("mount", mount_properties(scenario.mount), (0.0, 0.0, 0.0), 0.0)
    pivot = pivot_position(scenario.mount)
    bar = scenario.bar
    maxon = scenario.maxon
    model.place_link("bar", bar_properties(bar), [*pivot], 0.0)
    size = (bar.width, bar.width, bar.tail_distance)
    model.set_shape("bar", "bar", (0, 0, -bar.tail_distance / 2), size=size)
    model.set_rotor("swing", maxon.reflected_inertia / maxon.gear_ratio**2, maxon.gear_ratio)
    model.set_joint("swing", effort=maxon.torque_constant * maxon.current_limit)
    if not scenario.has_cheetah_tail:
        model.remove_link("tail", "tail_mount")
        return model
    tail = scenario.cheetah_tail
    root = pivot + np.array([0.0, 0.0, -bar.tail_distance - tail.gap])
    tilt = 0.0 - scenario.tunnel.misalignment
    model.place_link("tail", cheetah_tail_properties(tail), [*root], tilt)
    facing = tail.major_axis / 2
    side = tail.minor_axis / 2
    if scenario.experiment.axis == "minor":
        facing, side = side, facing
    model.set_shape("tail", "tail", (0, 0, -tail.length / 2), radii=(facing, side, tail.length / 2))
    return model


def robot_rig_sdf(scenario: RigScenario) -> SdfModel:
    """Makes the model of the mount and the robot's tail on its AK70-10."""
    model = SdfModel(model_path(ROBOT_RIG_SDF), DIGITS)
    tail = scenario.robot_tail
    motor = scenario.robot_motor
    model.place_link("mount", mount_properties(scenario.mount), (0.0, 0.0, 0.0), 0.0)
    model.place_link("tail", robot_tail_properties(tail), [*pivot_position(scenario.mount)], 0.0)
    model.set_shape("tail", "rod", (0, 0, -tail.length / 2), length=tail.length)
    scale = (tail.sail_width, tail.sail_width, tail.sail_length)
    model.set_shape("tail", "sail", (0, 0, -tail.length + tail.sail_length / 2), scale=scale)
    model.set_rotor("swing", motor.rotor_inertia, motor.gear_ratio)
    model.set_joint("swing", effort=motor.torque_limit)
    return model
