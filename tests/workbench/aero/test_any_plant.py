"""A plate on other plants: drag in closed form at three orientations, and what is said of a wrong
layout.
"""

import math
import warnings
from functools import partial

import numpy as np
import pytest
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Linearize

from aerodima.workbench import (
    SectionLayout,
    UserError,
    WindModel,
    add_tail_force,
    add_wind,
    observe,
)
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.tail_force import resolve_body
from aerodima.workbench.core.errors import ModelError
from tests.refusals import assert_refused
from tests.workbench.aero.plants import add_free_body, add_free_plant, add_plant, port_value

MASS, WIDTH, HEIGHT, C_N, DENSITY, START = 0.4, 0.3, 0.5, 1.3, 1.225, 8.0


def plate(angle):
    """Upright; its normal is turned from x by an angle about z."""
    return SectionLayout.strip(
        start=0.1,
        length=HEIGHT,
        width=WIDTH,
        normal_B=(math.cos(angle), math.sin(angle), 0.0),
        number=3,
    )


def jointed(builder, name, joint, axis, time_step=0.0):
    plant = add_plant(builder, time_step)
    body = plant.AddRigidBody(name, SpatialInertia.SolidBoxWithMass(MASS, 0.1, 0.1, 0.1))
    plant.AddJoint(joint("joint", plant.world_frame(), body.body_frame(), axis))
    plant.Finalize()
    return plant


def sled(builder, time_step=0.0):
    """A body that slides along x without friction."""
    return jointed(builder, "sled", PrismaticJoint, [1.0, 0.0, 0.0], time_step)


def pole(builder):
    """A body that turns about y."""
    return jointed(builder, "pole", RevoluteJoint, [0.0, 1.0, 0.0])


@pytest.mark.parametrize("angle", [0.0, math.pi / 4, math.radians(80.0)])
@pytest.mark.parametrize("time_step", [0.0, 1e-3])
def test_drag_of_a_plate_slows_a_sled_as_the_formula_says(angle, time_step):
    """m v' = -1/2 rho A C_N cos^2(angle) v^2, so v = v0 / (1 + k v0 t); a discrete step errs by its
    length.
    """
    builder = DiagramBuilder()
    plant = sled(builder, time_step)
    force = add_tail_force(builder, plant, "sled", plate(angle), C_N)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetVelocities(context, [START])
    area = WIDTH * HEIGHT
    pressed = 0.5 * DENSITY * area * C_N * START**2
    simulator.Initialize()
    if time_step == 0.0:
        wrench = port_value(force, simulator.get_context(), "wrench")
        expected = -pressed * math.cos(angle) * np.array([math.cos(angle), math.sin(angle), 0.0])
        assert wrench[:3] == pytest.approx(expected, rel=1e-12)
        assert wrench[3:6] == pytest.approx(
            np.cross([0.0, 0.0, 0.1 + HEIGHT / 2], expected), rel=1e-12
        )
    simulator.AdvanceTo(1.0)
    k = 0.5 * DENSITY * area * C_N * math.cos(angle) ** 2 / MASS
    exact = START / (1.0 + k * START)
    assert plant.GetVelocities(context)[0] == pytest.approx(
        exact, rel=1e-6 if time_step == 0.0 else 2e-3
    )


@pytest.mark.parametrize("make", [sled, pole], ids=["slide", "swing"])
def test_plate_along_the_flow_is_warned_of_with_its_normal_and_the_right_one(make):
    builder = DiagramBuilder()
    plant = make(builder)
    name = "sled" if make is sled else "pole"
    with pytest.warns(UserWarning, match=r"\(1, 0, 0\)") as said:
        add_tail_force(builder, plant, name, plate(math.pi / 2), C_N)
    (line,) = [str(warning.message) for warning in said]
    assert all(part in line for part in (f"'{name}'", "(0, 1, 0)"))


@pytest.mark.parametrize("wrong", [False, True])
def test_right_normals_and_plants_that_move_any_way_are_not_warned_of(wrong):
    layout = plate(math.pi / 2 if wrong else 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        builder = DiagramBuilder()
        plant, _ = add_free_plant(builder)  # nothing but a floating base
        add_tail_force(builder, plant, "tail", layout, C_N)
        builder = DiagramBuilder()
        add_tail_force(
            builder, sled(builder), "sled", layout, PolarLaw(1.2, 0.4)
        )  # it knows no normal
        builder = DiagramBuilder()
        add_tail_force(
            builder, sled(builder), "sled", layout, C_N, wind=add_wind(builder, WindModel())
        )
        if not wrong:
            builder = DiagramBuilder()
            add_tail_force(builder, pole(builder), "pole", layout, C_N)


@pytest.mark.parametrize("along", [True, False])
def test_observed_wind_that_makes_no_force_is_said_after_the_run(along):
    builder = DiagramBuilder()
    plant = sled(builder)
    wind = add_wind(builder, WindModel(mean=(3.0, 0.0, 0.0)))
    add_tail_force(builder, plant, "sled", plate(math.pi / 2 if along else 0.0), C_N, wind=wind)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with observe(builder, plant):
            Simulator(builder.Build()).AdvanceTo(0.05)
    lines = [str(warning.message) for warning in said if "sections" in str(warning.message)]
    if along:
        (line,) = lines
        assert "tail_force_sled" in line
        assert "3 m/s" in line
    else:
        assert lines == []


def test_linearised_damping_in_wind_is_that_of_the_formula():
    """dF/dv = -rho A C_N U broadside, so the slide's eigenvalue is -rho A C_N U / m."""
    builder = DiagramBuilder()
    plant = sled(builder)
    add_tail_force(
        builder,
        plant,
        "sled",
        plate(0.0),
        C_N,
        wind=add_wind(builder, WindModel(mean=(-5.0, 0.0, 0.0))),
    )
    builder.ExportOutput(plant.get_state_output_port(), "state")
    diagram = builder.Build()
    linear = Linearize(
        diagram, diagram.CreateDefaultContext(), equilibrium_check_tolerance=math.inf
    )
    expected = -DENSITY * WIDTH * HEIGHT * C_N * 5.0 / MASS
    assert linear.A()[1, 1] == pytest.approx(expected, rel=1e-12)


def test_wrong_input_is_refused_by_name():
    builder = DiagramBuilder()
    plant = sled(builder)

    def add(body):
        add_tail_force(builder, plant, body, plate(0.0), C_N)

    assert_refused(lambda: add("tail"), UserError, "'tail'", "sled")
    add("sled")
    assert_refused(lambda: add("sled"), UserError, "'tail_force_sled'", "'sled'")


def test_name_of_two_bodies_and_an_axis_of_two_numbers_are_refused():
    plant = add_plant(DiagramBuilder())
    for model in ("left", "right"):
        add_free_body(plant, model=plant.AddModelInstance(model))
    plant.Finalize()
    assert_refused(lambda: resolve_body(plant, "tail"), ModelError, "left::tail", "right::tail")
    strip = partial(SectionLayout.strip, start=0.1, length=0.5, width=0.1)
    assert_refused(lambda: strip(axis_B=(0, 1)), ModelError, "axis_B", "(0, 1)", "three")
    assert_refused(lambda: strip(normal_B=(0, 1)), ModelError, "normal_B", "(0, 1)", "three")
