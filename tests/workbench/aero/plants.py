"""Small plants built in code for the aerodynamic tests."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody, SpatialInertia
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, System


def add_plant(
    builder: DiagramBuilder, time_step: float = 0.0, gravity: bool = True
) -> MultibodyPlant:
    """A plant in the builder, without scene graph."""
    plant = builder.AddSystem(MultibodyPlant(time_step))
    plant.set_name("plant")
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    return plant


def add_free_body(plant: MultibodyPlant, name: str = "tail", mass: float = 0.5) -> RigidBody:
    """A free brick of 0.1 x 0.2 x 0.6 m with its centre of mass at the body origin."""
    return plant.AddRigidBody(name, SpatialInertia.SolidBoxWithMass(mass, 0.1, 0.2, 0.6))


def random_state(plant: MultibodyPlant, rng: np.random.Generator, speed: float = 8.0) -> np.ndarray:
    """A random multibody state with unit quaternions, rates and speeds up to about `speed`."""
    context = plant.CreateDefaultContext()
    q = rng.normal(size=plant.num_positions())
    plant.SetPositions(context, q)
    for index in plant.GetFloatingBaseBodies():
        body = plant.get_body(index)
        start = body.floating_positions_start()
        q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    return np.concatenate([q, speed * rng.normal(size=plant.num_velocities())])


def plant_context(diagram: Diagram, plant: MultibodyPlant, state: np.ndarray) -> Context:
    """A diagram context with the plant at a state."""
    context = diagram.CreateDefaultContext()
    plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), state)
    return context


def port_value(system: System, context: Context, port: str) -> np.ndarray:
    """A vector output of a subsystem in a root context."""
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))
