"""Small plants built in code for the aerodynamic tests."""

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, default_model_instance
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from aerodima.workbench.aero.tail_force import add_tail_force


def add_plant(builder, time_step=0.0, gravity=True):
    """A plant in the builder, without scene graph."""
    plant = builder.AddSystem(MultibodyPlant(time_step))
    plant.set_name("plant")
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    return plant


def add_free_plant(builder):
    """A plant with one free body, finalised."""
    plant = add_plant(builder)
    body = add_free_body(plant)
    plant.Finalize()
    return plant, body


def add_free_body(plant, name="tail", mass=0.5, model=None):
    """A free brick of 0.1 x 0.2 x 0.6 m with its centre of mass at the body origin."""
    model = model or default_model_instance()
    return plant.AddRigidBody(name, model, SpatialInertia.SolidBoxWithMass(mass, 0.1, 0.2, 0.6))


def free_tail(layout, law, wind=(0.0, 0.0, 0.0), **options):
    """A free body whose force meets a wind: diagram, plant, force and source of the wind."""
    builder = DiagramBuilder()
    plant, body = add_free_plant(builder)
    source = builder.AddSystem(ConstantVectorSource(np.array(wind)))
    air = source.get_output_port()
    force = add_tail_force(builder, plant, body, layout, law, wind=air, **options)
    return builder.Build(), plant, force, source


def random_state(plant, rng, speed=8.0):
    """A random multibody state with unit quaternions, rates and speeds up to about `speed`."""
    context = plant.CreateDefaultContext()
    q = rng.normal(size=plant.num_positions())
    plant.SetPositions(context, q)
    for index in plant.GetFloatingBaseBodies():
        body = plant.get_body(index)
        start = body.floating_positions_start()
        q[start : start + 4] /= np.linalg.norm(q[start : start + 4])
    return np.concatenate([q, speed * rng.normal(size=plant.num_velocities())])


def plant_context(diagram, plant, state):
    """A diagram context with the plant at a state."""
    context = diagram.CreateDefaultContext()
    plant.SetPositionsAndVelocities(plant.GetMyMutableContextFromRoot(context), state)
    return context


def accelerations(diagram, plant, state):
    """Rates of the velocities of a plant at a state."""
    context = plant.GetMyContextFromRoot(plant_context(diagram, plant, state))
    return plant.EvalTimeDerivatives(context).CopyToVector()[plant.num_positions() :]


def port_value(system, context, port):
    """A vector output of a subsystem in a root context."""
    return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))
