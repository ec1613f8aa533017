"""The air around the simulated car: the wind of a scenario, the sections of its sail and their coefficients.

The air acts on the sail only; the chassis feels none.
"""

import math

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, System

from workbench.aero.coefficient_files import load_coefficients
from workbench.aero.laws import NormalForceLaw, SectionLaw, TwoSidedLaw
from workbench.aero.published_coefficients import ROBOT_LIMIT
from workbench.aero.sections import Air, SectionLayout
from workbench.aero.tail_force import add_to_builder as add_tail_force
from workbench.aero.wind import WindModel, WindSource
from workbench.coefficient_names import CONSTANT
from workbench.errors import ModelError
from workbench.parameters import TailParameters
from workbench.scenario import Scenario


def wind_model(scenario: Scenario) -> WindModel | None:
    """The wind that the scenario's tail meets; None in still air, and for a car without tail, which feels no wind."""
    wind = scenario.wind
    if wind.is_still or scenario.tail.mode == "none":
        return None
    gust = wind.gust_amplitude
    return WindModel(
        mean=(wind.mean_x, wind.mean_y, wind.mean_z),
        gust=(gust * math.cos(wind.gust_direction), gust * math.sin(wind.gust_direction), 0.0),
        gust_frequency=1.0 / wind.gust_period,
        turbulence=(wind.turbulence,) * 3,
        time_constant=wind.turbulence_time_constant,
        seed=scenario.seed,
    )


def add_wind_source(builder: DiagramBuilder, scenario: Scenario) -> System | None:
    """Adds the wind of a scenario to a diagram; nothing, and None, where there is none."""
    model = wind_model(scenario)
    return None if model is None else builder.AddNamedSystem("wind", WindSource(model))


def sail_law(tail: TailParameters) -> tuple[SectionLaw, float]:
    """Law of the sail, and the relative speed (m/s) up to which it was shown to hold.

    Raises:
        ModelError: there is no such file or it is not a coefficient set; or its law does not know the sail's normal, so
            that the air would not turn a free sail.
    """
    if tail.coefficients == CONSTANT:
        return NormalForceLaw(tail.normal_force_coefficient), ROBOT_LIMIT
    try:
        chosen = load_coefficients(tail.coefficients)
    except ModelError as error:
        raise ModelError(f"tail.coefficients: {error}") from None
    if tail.sail == "free" and chosen.law_kind == "polar":
        raise ModelError(
            f"tail.coefficients: {tail.coefficients} has a polar law; allowed with tail.sail 'free': normal_force, "
            "two_sided"
        )
    return chosen.law(), chosen.quasi_steady_limit


def sail_layout(tail: TailParameters, law: SectionLaw) -> SectionLayout:
    """Sections of the sail in the frame of the body `tail_sail`: z along the tail, chord along x, normal along y.

    The centre of pressure of a free sail lies behind its axis, see `FreeSail`. A sail with two different sides is drawn
    hollow towards +y (models/tail/tail.sdf), and the normal of `TwoSidedLaw` leaves the round side.
    """
    behind = tail.sail_centre_of_pressure if tail.sail == "free" else 0.0
    return SectionLayout.robot_tail(
        start=tail.length - tail.sail_length,
        length=tail.sail_length,
        width=tail.sail_width,
        number=tail.sections,
        p_BoRo_B=(-behind, 0.0, 0.0),
        normal_B=(0.0, -1.0 if isinstance(law, TwoSidedLaw) else 1.0, 0.0),
    )


def add_sail_force(builder: DiagramBuilder, plant: MultibodyPlant, scenario: Scenario, wind: System | None) -> System:
    """Adds the force of the air on the car's sail and wires it to the plant, and to the wind where there is one."""
    law, limit = sail_law(scenario.tail)
    return add_tail_force(
        builder,
        plant,
        "tail_sail",
        sail_layout(scenario.tail, law),
        law,
        air=Air(scenario.environment.air_density, scenario.environment.air_viscosity),
        wind=None if wind is None else wind.GetOutputPort("wind_velocity"),
        quasi_steady_limit=limit,
    )
