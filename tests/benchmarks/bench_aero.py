"""What the aerodynamic wrench costs: per step of a diagram, against five of Drake's wings, and in
AutoDiff.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from pydrake.autodiffutils import InitializeAutoDiff
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer, MultibodyPlant, Wing
from pydrake.multibody.tree import RevoluteJoint, RigidBody, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder

from aerodima.workbench.aero.added_mass import add_added_mass
from aerodima.workbench.aero.coefficient_files import load_coefficients
from aerodima.workbench.aero.section_laws import SectionLaw
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from tests.benchmarks.rows import BenchRow

_STEP = 2e-3
_STEPS = 200
_REPEATS = 40
_LAYOUT = SectionLayout.strip(start=0.1, length=0.5, width=0.2, normal_B=(0.0, 1.0, 0.0))
_VEHICLE, _RIG = 25, 6
_RATE = 5.0
"""Of the chain about its first hinge, rad/s: at rest no section has a force to compute."""

Install = Callable[[DiagramBuilder, MultibodyPlant, RigidBody], None]


def _diagram(bodies: int, install: Install, added_mass: float = 0.0) -> Diagram:
    """A discrete chain of hinged bricks, as many as the car or the rig has bodies; the tail is its
    last one.
    """
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(MultibodyPlant(_STEP))
    parent = plant.world_body()
    for i in range(bodies):
        body = plant.AddRigidBody(f"b{i}", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
        plant.AddJoint(RevoluteJoint(f"j{i}", parent.body_frame(), body.body_frame(), np.eye(3)[0]))
        parent = body
    mass = add_added_mass(plant, parent, _LAYOUT, added_mass) if added_mass else None
    plant.Finalize()
    if mass is not None:
        mass.add_to_builder(builder)
    install(builder, plant, parent)
    return builder.Build()


def _nothing(builder: DiagramBuilder, plant: MultibodyPlant, tail: RigidBody) -> None:
    del builder, plant, tail


def _tail(law: SectionLaw | float) -> Install:
    def install(builder: DiagramBuilder, plant: MultibodyPlant, tail: RigidBody) -> None:
        add_tail_force(builder, plant, tail, _LAYOUT, law)

    return install


def _five_wings(builder: DiagramBuilder, plant: MultibodyPlant, tail: RigidBody) -> None:
    multiplexer = builder.AddSystem(ExternallyAppliedSpatialForceMultiplexer(_LAYOUT.number))
    for i, (place, area) in enumerate(zip(_LAYOUT.p_BoSi_B, _LAYOUT.areas, strict=True)):
        wing: Any = builder.AddSystem(Wing(tail.index(), area, RigidTransform(place)))
        builder.Connect(plant.get_body_poses_output_port(), wing.get_body_poses_input_port())
        builder.Connect(
            plant.get_body_spatial_velocities_output_port(),
            wing.get_body_spatial_velocities_input_port(),
        )
        builder.Connect(wing.get_spatial_force_output_port(), multiplexer.get_input_port(i))
    builder.Connect(multiplexer.get_output_port(), plant.get_applied_spatial_force_input_port())


def _step_times(*diagrams: Diagram) -> list[float]:
    """Process time per simulated step, us: best of many short runs in turns, because other load
    comes in bursts.
    """
    best = [np.inf] * len(diagrams)
    for _ in range(_REPEATS):
        for i, diagram in enumerate(diagrams):
            simulator = Simulator(diagram)
            plant: Any = diagram.GetSystems()[0]
            context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
            plant.GetJointByName("j0").set_angular_rate(context, _RATE)
            simulator.Initialize()
            start = time.process_time()
            simulator.AdvanceTo(_STEPS * _STEP)
            best[i] = min(best[i], (time.process_time() - start) / _STEPS * 1e6)
    return [float(value) for value in best]


def bench_tail_force() -> Iterator[BenchRow]:
    """Five sections, normal-force law: time added to a step, and the step of the same diagram with
    five Wings instead.

    The added time alone is 5 times that of the Wings, which are C++: an empty Python system already
    costs more.
    """
    for label, bodies in (("rig", _RIG), ("vehicle", _VEHICLE)):
        none, ours, wings = _step_times(
            _diagram(bodies, _nothing), _diagram(bodies, _tail(2.0)), _diagram(bodies, _five_wings)
        )
        yield BenchRow(
            f"aero: five sections added to a step, {label} of {bodies} bodies",
            ours - none,
            "us",
            "<= 25",
        )
        yield BenchRow(
            f"aero: step of the diagram against five Wings, {label}", ours, "us", "<= 3", wings
        )
        yield BenchRow(
            f"aero: added time against that of five Wings, {label}",
            ours - none,
            "us",
            "",
            wings - none,
        )


def bench_tables_and_added_mass() -> Iterator[BenchRow]:
    """Angle tables and added mass with its slide."""
    law = load_coefficients("cheetah_tail_1_major").law()
    none, both = _step_times(
        _diagram(_VEHICLE, _nothing), _diagram(_VEHICLE, _tail(law), added_mass=0.02)
    )
    yield BenchRow(
        "aero: tables and added mass added to a step, vehicle", both - none, "us", "<= 60"
    )


def bench_autodiff() -> Iterator[BenchRow]:
    """One evaluation of the wrench and its gradient by the state of the rig."""
    diagram: Any = _diagram(_RIG, _tail(2.0)).ToAutoDiffXd()
    plant, force = (diagram.GetSubsystemByName(s.get_name()) for s in diagram.GetSystems()[:2])
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    force_context = force.GetMyContextFromRoot(context)
    state = InitializeAutoDiff(np.linspace(0.1, 1.0, plant.num_multibody_states()))
    best = np.inf
    for _ in range(_REPEATS):
        start = time.process_time()
        for _ in range(50):
            plant.SetPositionsAndVelocities(plant_context, state)
            force.GetOutputPort("wrench").Eval(force_context)
        best = min(best, (time.process_time() - start) / 50 * 1e6)
    yield BenchRow("aero: AutoDiff evaluation of the wrench, rig", float(best), "us")
