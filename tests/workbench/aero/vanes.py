"""A `FreeSail` on a plant of its own: its body and bearing, the air on it, and the linear vane that
it is.
"""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia, UnitInertia

from aerodima.workbench.aero.sail import FreeSail
from aerodima.workbench.aero.sections import Air
from aerodima.workbench.aero.tail_force import add_tail_force


@dataclass(frozen=True)
class Vane:
    """A sail with its mass (kg), its inertia (kg m2) about the bearing, and the bearing's damping
    (N m s/rad).
    """

    sail: FreeSail
    mass: float
    inertia: float
    damping: float = 0.0

    def frequency(self, wind_speed):
        """Undamped small-angle frequency (rad/s) in a wind (m/s); 0 where the sail turns away."""
        stiffness = (
            0.5
            * Air().density
            * self.sail.side_coefficient
            * wind_speed**2
            * side_moment(self.sail)
        )
        return math.sqrt(max(stiffness, 0.0) / self.inertia)

    def damping_ratio(self, wind_speed):
        """Share zeta of critical damping by air and bearing in a wind (m/s) that the sail faces."""
        rate = (
            0.5
            * Air().density
            * self.sail.side_coefficient
            * wind_speed
            * side_moment(self.sail, 2)
        )
        return (rate + self.damping) / (2 * self.inertia * self.frequency(wind_speed))


def side_moment(sail, power=1):
    """Sum of side area x (distance behind the bearing)^power, m^(2 + power)."""
    plates = (
        (sail.shell_share * sail.width, sail.centre_of_pressure),
        (sail.board_width, sail.board_place),
    )
    return sail.length * sum(width * behind**power for width, behind in plates)


def add_vane(plant, vane, name="sail"):
    """Body of a sail that is balanced on its bearing, and the bearing, upright in the world."""
    middle = np.array([0.0, 0.0, vane.sail.start + vane.sail.length / 2])
    radius = vane.inertia / vane.mass
    along = vane.sail.length**2 / 12
    # A plate with its mass on the axis: G_zz is given, the others follow from the length and half
    # of G_zz each.
    shape = UnitInertia(along + radius / 2, along + radius / 2, radius)
    body = plant.AddRigidBody(
        name, SpatialInertia(vane.mass, middle, shape.ShiftFromCenterOfMass(middle))
    )
    frames = plant.world_frame(), body.body_frame()
    return body, plant.AddJoint(RevoluteJoint(f"{name}_joint", *frames, np.eye(3)[2], vane.damping))


def add_air(builder, plant, sail, body="sail", *, wind):
    """Force of the air on shell and board."""
    shell = add_tail_force(builder, plant, body, sail.shell_layout, sail.shell_law, wind=wind)
    board = add_tail_force(
        builder,
        plant,
        body,
        sail.board_layout,
        sail.side_coefficient,
        wind=wind,
        name="board_force",
    )
    return shell, board
