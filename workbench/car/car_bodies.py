"""Bodies of a scenario that are fixed to the chassis and feel the air, such as a rear wing.

Their file has plates and half shells in the frame of the chassis: x forward, y left, z up, origin
on the ground under the rear axle at nominal ride height.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from pydrake.geometry import Convex
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort

from aerodima.workbench.aero.sections import Air
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.aero.tail_geometry import Plate, TailPart
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.quantity import quantity
from aerodima.workbench.core.yaml_files import checked, read_yaml
from aerodima.workbench.scenario.scenario import Scenario

SCHEMA: Literal["aerodima/bodies/1"] = "aerodima/bodies/1"
_THICKNESS = 0.002
"""Thickness with which a plate is drawn, m."""
_COLOUR = np.array([0.93, 0.74, 0.18, 1.0])
"""Red, green, blue and opacity of the bodies, from 0 to 1."""


class CarBody(Plate):
    """A plate or half shell on the chassis, its vectors in the frame of the chassis."""

    coefficients: str = quantity("1", "set of models/coefficients, or a file", default="flat_plate")


class CarBodies(TailPart):
    """Content of a file of bodies."""

    schema_: Literal["aerodima/bodies/1"] = Field(default=SCHEMA, alias="schema", repr=False)
    bodies: Annotated[tuple[CarBody, ...], Field(strict=False, min_length=1)]


def car_bodies(scenario: Scenario) -> tuple[CarBody, ...]:
    """Reads the bodies of a scenario; ModelError names `car.bodies` and the file."""
    if not scenario.car.has_bodies:
        return ()
    path = Path(scenario.car.bodies)
    content = read_yaml(path, ModelError)
    return checked(CarBodies, content, f"car.bodies: {path}", ModelError, schema=SCHEMA).bodies


def weld_car_bodies(
    plant: MultibodyPlant, car: ModelInstanceIndex, scenario: Scenario, drawn: bool
) -> None:
    """Welds the bodies of a scenario to the chassis, with their mass, before the plant is
    finalised.

    Raises:
        ModelError: a file is wrong, or the car has a body of that name.
    """
    for entry in car_bodies(scenario):
        if plant.HasBodyNamed(entry.name):
            raise ModelError(
                f"car.bodies: {scenario.car.bodies}: name: {entry.name!r} must be the name of no "
                "other body of the car"
            )
        body = plant.AddRigidBody(entry.name, car, entry.inertia)
        plant.WeldFrames(plant.GetFrameByName("chassis"), body.body_frame())
        for number, piece in enumerate(entry.pieces if drawn else []):
            faces = [piece.corners + side * _THICKNESS / 2 * piece.normal for side in (-1.0, 1.0)]
            hull: Any = Convex(points=np.vstack(faces).T, label=entry.name)
            plant.RegisterVisualGeometry(
                body, RigidTransform(), hull, f"{entry.name}_{number}", _COLOUR
            )


def add_car_body_forces(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: Scenario, wind: OutputPort | None
) -> None:
    """Puts the force of the air on the bodies of a scenario: a `TailForce` for each straight run of
    a plate, named after the body and, from the second run on, with its number.

    Raises:
        ModelError: coefficients are missing or wrong.
    """
    from aerodima.workbench.aero.coefficient_files import load_coefficients

    air = Air(scenario.environment.air_density, scenario.environment.air_viscosity)
    for entry in car_bodies(scenario):
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
