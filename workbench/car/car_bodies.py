"""Bodies of a scenario that are fixed to the chassis and feel the air, such as a rear wing.

Their file has plates and half shells in the frame of the chassis: x forward, y left, z up, origin
on the ground under the rear axle at nominal ride height.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydrake.geometry import Convex
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort

from aerodima.workbench.aero.coefficient_files import load_coefficients
from aerodima.workbench.aero.sections import Air
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.aero.tail_geometry import Plate, TailPart
from aerodima.workbench.aero.tail_pieces import unit_vector
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.quantity import quantity
from aerodima.workbench.core.yaml_files import checked, read_yaml
from aerodima.workbench.scenario.scenario import Scenario

AddBodies = Callable[[DiagramBuilder, MultibodyPlant, OutputPort | None], object]
"""Adds bodies and forces to the plant of a simulated car: called with the builder of the station,
the plant before it is finalised, and a port of the wind's velocity (3), m/s, None in still air. It
may call `plant.Finalize()`, which `add_tail_force` needs."""
SCHEMA = "aerodima/bodies/1"
_THICKNESS = 0.002
"""Thickness with which bodies are drawn, as the hull of their pieces, m."""
_COLOUR = np.array([0.93, 0.74, 0.18, 1.0])
"""Red, green, blue and opacity of the bodies, from 0 to 1."""


class CarBody(Plate):
    """A plate or half shell on the chassis, its vectors in the frame of the chassis."""

    coefficients: str = quantity("1", "set of models/coefficients, or a file", default="flat_plate")


class CarBodies(TailPart):
    """Content of a file of bodies."""

    schema_: str = Field(default=SCHEMA, alias="schema", repr=False)
    bodies: Annotated[tuple[CarBody, ...], Field(strict=False, min_length=1)]


def finalize_with_bodies(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    car: ModelInstanceIndex,
    scenario: Scenario,
    wind: OutputPort | None,
    add_more: AddBodies | None,
) -> None:
    """Welds the bodies of a scenario to the chassis, with mass and shape, lets a user add more,
    finalises the plant and puts the force of the air on the bodies: a `TailForce` for each straight
    run of a plate, named after the body and, from the second run on, with its number.

    Raises:
        ModelError: `car.bodies` is no such file, coefficients are missing or wrong, or the car has
            a body of that name.
    """
    entries: tuple[CarBody, ...] = ()
    if scenario.car.has_bodies:
        path = Path(scenario.car.bodies)
        where = f"car.bodies: {path}"
        content = read_yaml(path, ModelError)
        entries = checked(CarBodies, content, where, ModelError, schema=SCHEMA).bodies
    for entry in entries:
        if plant.HasBodyNamed(entry.name):
            raise ModelError(f"car.bodies: name: the car has a body {entry.name!r} already")
        body = plant.AddRigidBody(entry.name, car, entry.inertia)
        plant.WeldFrames(plant.GetFrameByName("chassis"), body.body_frame())
        near = np.vstack([piece.corners for piece in entry.pieces])
        points: Any = np.vstack([near, near + _THICKNESS * unit_vector(entry.normal)])
        hull = Convex(points=points.T, label=entry.name)
        plant.RegisterVisualGeometry(body, RigidTransform(), hull, entry.name, _COLOUR)
    if add_more is not None:
        add_more(builder, plant, wind)
    if not plant.is_finalized():
        plant.Finalize()
    air = Air(scenario.environment.air_density, scenario.environment.air_viscosity)
    for entry in entries:
        coefficients = load_coefficients(entry.coefficients)
        for number, layout in enumerate(entry.section_layouts()):
            add_tail_force(
                builder,
                plant,
                entry.name,
                layout,
                coefficients.law(),
                air=air,
                wind=wind,
                quasi_steady_limit=coefficients.quasi_steady_limit,
                name=f"{entry.name}_{number}" if number else entry.name,
            )
