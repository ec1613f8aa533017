"""A `FreeSail` on a plant of its own: its body and bearing, the air on it, and the linear vane that it is."""

from __future__ import annotations

import math

import numpy as np
from pydrake.multibody.tree import RevoluteJoint, RigidBody, SpatialInertia, UnitInertia

from aerodima.workbench.aero.sail import FreeSail
from aerodima.workbench.aero.sections import Air
from aerodima.workbench.aero.tail_force import add_tail_force


def add_vane(plant, sail: FreeSail, name: str = "sail") -> tuple[RigidBody, RevoluteJoint]:
    """Body of a sail that is balanced on its bearing, and the bearing, upright in the world."""
    middle = np.array([0.0, 0.0, sail.start + sail.length / 2])
    radius, along = sail.inertia / sail.mass, sail.length**2 / 12
    # A plate with its mass on the axis: G_zz is given, the others follow from the length and half of G_zz each.
    shape = UnitInertia(along + radius / 2, along + radius / 2, radius)
    body = plant.AddRigidBody(name, SpatialInertia(sail.mass, middle, shape.ShiftFromCenterOfMass(middle)))
    frames = plant.world_frame(), body.body_frame()
    return body, plant.AddJoint(RevoluteJoint(f"{name}_joint", *frames, np.eye(3)[2], sail.bearing_damping))


def add_air(builder, plant, sail: FreeSail, body="sail", *, wind):
    """Force of the air on shell and board."""
    shell = add_tail_force(builder, plant, body, sail.shell_layout, sail.shell_law, wind=wind)
    board = add_tail_force(
        builder, plant, body, sail.board_layout, sail.side_coefficient, wind=wind, name="board_force"
    )
    return shell, board


def damping_ratio(sail: FreeSail, wind_speed: float) -> float:
    """Share zeta of critical damping by air and bearing in a wind (m/s) that the sail faces."""
    rate = 0.5 * Air().density * sail.side_coefficient * wind_speed * sail.side_moment(2)
    frequency = sail.vane_frequency(wind_speed)
    return (rate + sail.bearing_damping) / (2 * sail.inertia * frequency) if frequency else math.inf
