"""The car on level ground as a `MultibodyPlant`, with or without its tail arm.

Discrete plant with point contact, `kLagged` approximation and tyres that stand on their edges
(design section 7). Body frame B: x forward, y left, z up, origin on the ground under the rear axle
at nominal ride height.
"""

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import (
    ContactModel,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import DiagramBuilder, OutputPort

from aerodima.workbench.aero.added_mass import AddedMass, add_added_mass
from aerodima.workbench.aero.tail_force import ADDED_MASS_PREFIX
from aerodima.workbench.car.car_bodies import AddBodies, finalize_with_bodies
from aerodima.workbench.car.car_model import car_sdf, stiction_tolerance
from aerodima.workbench.car.tail_plant import MIN_INERTIA_FRACTION, added_mass_layout, tail_sdf
from aerodima.workbench.control.swing_library import resting_tail
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import models_dir
from aerodima.workbench.core.sdf_model import SdfModel
from aerodima.workbench.scenario.scenario import Scenario

GROUND_STIFFNESS = 1.0e10
"""Contact stiffness (N/m) of the ground: rigid against any tyre, so that the pair has the tyre's
stiffness to 1e-5."""

HALF_SPACE_WARNING = (
    "Rigid (non-deformable) half spaces are not currently supported for deformable contact; "
    "registration is allowed, but no contact data will be reported."
)
"""Warning that Drake gives about every half space that a deformable body could touch. The car has
no deformable body."""

MODELS_PACKAGE = "aerodima_models"


@dataclass(frozen=True)
class CarPlant:
    """A finalised plant with its scene graph; `tail` is None for the car without tail arm.

    Added mass of the air is a model instance of its own and no part of the vehicle.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    car: ModelInstanceIndex
    tail: ModelInstanceIndex | None

    @property
    def instances(self) -> list[ModelInstanceIndex]:
        """Model instances of the whole vehicle, without the added mass of the air."""
        return own_instances(self.plant)


def own_instances(plant: MultibodyPlant) -> list[ModelInstanceIndex]:
    """Returns the model instances with bodies, but not the world's or those of added mass."""
    instances = [ModelInstanceIndex(index) for index in range(1, plant.num_model_instances())]
    return [
        instance
        for instance in instances
        if plant.GetBodyIndices(instance)
        and not plant.GetModelInstanceName(instance).startswith(ADDED_MASS_PREFIX)
    ]


def add_car_plant(
    builder: DiagramBuilder,
    scenario: Scenario,
    wind_acceleration: OutputPort | None = None,
    *,
    sampled_outputs: bool = True,
    drawn: bool = True,
    wind: OutputPort | None = None,
    add_bodies: AddBodies | None = None,
) -> CarPlant:
    """Adds the car of a scenario, standing at the origin and heading along x, to a diagram.

    Args:
        wind_acceleration: port of the acceleration of the air in W (3), m/s2, which pushes the
            added mass; None for steady wind.
        sampled_outputs: whether accelerations and contact forces on the plant's ports are those of
            the last step; if not, they are those of the step that begins, and a step need not keep
            them.
        drawn: whether the car has its visuals, each of which Drake places in every step.
        wind: port of the velocity of the air in W (3), m/s, on bodies of the scenario; None for
            still air.
        add_bodies: function that adds a user's bodies.

    Raises:
        ModelError: a model file is missing or does not load with these numbers, or
            `tail.added_mass` is too negative.
    """
    plant, scene_graph = add_plant(builder, scenario.simulation.step)
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -scenario.environment.gravity])
    _add_ground(plant, scenario.car.tyre_friction)
    car = parse_model(plant, car_sdf(scenario), drawn)
    tail = None
    added: AddedMass | None = None
    if scenario.has_tail:
        tail = _add_tail_arm(plant, scenario, drawn)
        if scenario.tail.added_mass != 0.0:
            # All of it is on the rod: it does not turn with a free sail.
            rod = plant.GetBodyByName("tail_rod")
            layout = added_mass_layout(scenario.tail)
            added = add_added_mass(plant, rod, layout, scenario.tail.added_mass)
    plant.set_stiction_tolerance(stiction_tolerance(scenario.car, scenario.manoeuvre.speed))
    plant.set_contact_model(ContactModel.kPoint)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.SetUseSampledOutputPorts(sampled_outputs)
    finalize_with_bodies(builder, plant, car, scenario, wind, add_bodies)
    result = CarPlant(plant, scene_graph, car, tail)
    _exclude_self_collisions(plant, scene_graph, result.instances)
    if added is not None:
        try:
            added.add_to_builder(
                builder,
                wind_acceleration=wind_acceleration,
                min_inertia_fraction=MIN_INERTIA_FRACTION,
            )
        except ModelError as error:
            raise ModelError(f"tail.added_mass: {error}") from None
    return result


def _add_tail_arm(plant: Any, scenario: Scenario, drawn: bool) -> ModelInstanceIndex:
    """Adds the tail arm on the gearbox, at the angles at which it rests."""
    arm = tail_sdf(scenario.tail, scenario.tail_motor, scenario.car)
    if scenario.tail.sail != "free":
        arm.fix_joint("tail_sail_turn")
    tail = parse_model(plant, arm, drawn)
    reach = scenario.tail.mount_x - scenario.car.gearbox_x
    X_GT = RigidTransform(np.array([reach, 0.0, scenario.car.gearbox_height / 2]))
    plant.WeldFrames(plant.GetFrameByName("gearbox"), plant.GetFrameByName("tail_anchor"), X_GT)
    for joint, angle in zip(("roll", "pitch"), resting_tail(scenario), strict=True):
        plant.GetJointByName(f"tail_{joint}").set_default_angle(angle)
    return tail


def add_plant(builder: DiagramBuilder, step: float) -> tuple[Any, SceneGraph]:
    """Adds a plant and its scene graph, as Drake's `AddMultibodyPlantSceneGraph` does, whose
    systems Drake 1.51 never frees.

    Args:
        step: length of the plant's step, s; 0 for a continuous plant.
    """
    plant: Any = builder.AddNamedSystem("plant", MultibodyPlant(step))
    scene_graph: Any = builder.AddNamedSystem("scene_graph", SceneGraph())
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    builder.Connect(plant.get_geometry_pose_output_port(), scene_graph.get_source_pose_port(source))
    builder.Connect(scene_graph.get_query_output_port(), plant.get_geometry_query_input_port())
    return plant, scene_graph


def strict_parser(plant: MultibodyPlant) -> Parser:
    """Makes a parser that finds the meshes of `models/` and treats a warning as an error."""
    parser = Parser(plant)
    parser.package_map().Add(MODELS_PACKAGE, str(models_dir()))
    parser.SetStrictParsing()
    return parser


def parse_model(plant: MultibodyPlant, model: SdfModel, drawn: bool = True) -> ModelInstanceIndex:
    """Parses a model strictly, with its visuals if `drawn`: a warning of Drake's parser is an error
    naming the file.
    """
    if not drawn:
        for link in model.model.findall("link"):
            model.remove_shapes(str(link.get("name")), kind="visual")
    try:
        (instance,) = strict_parser(plant).AddModelsFromString(model.text(), "sdf")
    except RuntimeError as error:
        raise ModelError(f"{model.path}: does not load in Drake: {error}") from None
    return instance


def _add_ground(plant: MultibodyPlant, friction: float) -> None:
    # The logger does not add a filter a second time.
    logging.getLogger("drake").addFilter(drop_half_space_warning)
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=0.0,
        point_stiffness=GROUND_STIFFNESS,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    plant.RegisterCollisionGeometry(
        plant.world_body(),
        HalfSpace.MakePose(np.array([0.0, 0.0, 1.0]), np.zeros(3)),
        HalfSpace(),
        "ground",
        properties,
    )


def _exclude_self_collisions(
    plant: MultibodyPlant, scene_graph: SceneGraph, instances: list[ModelInstanceIndex]
) -> None:
    """Excludes contacts between parts of the car; the tail's range is a limit of its joints."""
    geometries: list[GeometryId] = []
    for instance in instances:
        for body in plant.GetBodyIndices(instance):
            geometries += plant.GetCollisionGeometriesForBody(plant.get_body(body))
    scene_graph.collision_filter_manager().Apply(
        CollisionFilterDeclaration().ExcludeWithin(GeometrySet(geometries))
    )


def drop_half_space_warning(record: logging.LogRecord) -> bool:
    """Returns False for the warning that Drake gives about the ground of every car."""
    return record.getMessage() != HALF_SPACE_WARNING
