"""The air around the simulated car: the wind of a scenario, the sections of its sail and their
coefficients.

The air acts on the sail only; the chassis feels none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from aerodima.workbench.aero.laws import ROBOT_LIMIT, NormalForceLaw, SectionLaw, facing_law
from aerodima.workbench.aero.sail import FreeSail
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.port_wiring import concatenate
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.tail_parameters import (
    CONSTANT,
    SAIL_LAWS,
    SAIL_SHAPES,
    TailParameters,
)

if TYPE_CHECKING:
    from aerodima.workbench.aero.wind import WindModel


def wind_model(scenario: Scenario) -> WindModel | None:
    """The wind that the scenario's tail meets; None in still air, and for a car without tail, which
    feels no wind.
    """
    wind = scenario.wind
    if wind.is_still or scenario.tail.mode == "none":
        return None
    from aerodima.workbench.aero.wind import WindModel

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
    if model is None:
        return None
    from aerodima.workbench.aero.wind import WindSource

    return builder.AddNamedSystem("wind", WindSource(model))


def sail_law(tail: TailParameters) -> tuple[SectionLaw, float]:
    """Law of the sail as `tail.sail` lets it stand, and the relative speed (m/s) up to which it was
    shown to hold.

    Raises:
        ModelError: there is no such file or it is not a coefficient set; or its law does not know
            the sail's normal, so that the air would not turn the sail.
    """
    law: SectionLaw
    shape = SAIL_SHAPES[tail.sail_shape].coefficients
    name = shape if shape is not None and tail.coefficients == CONSTANT else tail.coefficients
    if name == CONSTANT:
        law = NormalForceLaw(tail.normal_force_coefficient)
        limit = ROBOT_LIMIT
    else:
        from aerodima.workbench.aero.coefficient_files import load_coefficients

        try:
            chosen = load_coefficients(name)
        except ModelError as error:
            raise ModelError(f"tail.coefficients: {error}") from None
        law = chosen.law()
        limit = chosen.quasi_steady_limit
    if tail.sail == "locked":
        return law, limit
    if not law.knows_normal:
        raise ModelError(
            f"tail.coefficients: {tail.coefficients} has a {chosen.law_kind} law; allowed with "
            f"tail.sail {tail.sail!r}: {', '.join(SAIL_LAWS)}"
        )
    return facing_law(law) if tail.sail == "facing" else law, limit


def sail_layout(tail: TailParameters) -> SectionLayout:
    """Sections of a sail that is locked or faces the wind, in the frame of the body `tail_sail`: z
    along the tail.

    The sail is drawn hollow towards +y (models/tail/tail.sdf), and its normal leaves the round
    side.

    Raises:
        ModelError: a tail of its own geometry, which may have several lines of sections; reduced
            cars have one.
    """
    if tail.has_own_geometry:
        raise ModelError(
            f"tail.geometry: {tail.geometry}; allowed: none, for a car with one straight sail"
        )
    (layout,) = tail_geometry(tail).section_layouts()
    return layout


def free_sail(tail: TailParameters, law: SectionLaw) -> FreeSail:
    """The plates of the sail on its bearing."""
    return FreeSail(
        length=tail.sail_length,
        width=tail.sail_width,
        centre_of_pressure=tail.sail_shell_offset * tail.sail_width,
        board_width=tail.board_share * tail.sail_width,
        start=tail.length - tail.sail_length,
        law=law,
        side_coefficient=tail.sail_side_coefficient,
        number=tail.sections,
        shell_share=tail.shell_share,
    )


def sail_strips(tail: TailParameters) -> list[tuple[SectionLayout, SectionLaw]]:
    """Lines of sections of the sail with the law of each, in the frame of body `tail_sail`."""
    law, _ = sail_law(tail)
    if tail.has_own_geometry:
        return [(layout, law) for layout in tail_geometry(tail).section_layouts()]
    if tail.sail != "free":
        return [(sail_layout(tail), law)]
    sail = free_sail(tail, law)
    return [
        (sail.shell_layout, sail.shell_law),
        (sail.board_layout, NormalForceLaw(sail.side_coefficient)),
    ]


@dataclass(frozen=True)
class SailReport:
    """What the air does to the car's sail.

    Attributes:
        sections, validity: of the sail's opening, or of all lines of a tail of its own geometry, as
            `TailForce`.
    """

    sections: OutputPort
    validity: OutputPort


def add_sail_report(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: Scenario, wind: OutputPort | None
) -> SailReport:
    """Adds systems that say what the air does to the sail; the `CarDrives` push the plant."""
    tail = scenario.tail
    _, limit = sail_law(tail)
    air = Air(scenario.environment.air_density, scenario.environment.air_viscosity)
    lines = [
        add_tail_force(
            builder, plant, "tail_sail", layout, law, air=air, wind=wind, quasi_steady_limit=limit,
            applied=False,
            name=f"tail_force_tail_sail_{number}" if number else None,
        )
        for number, (layout, law) in enumerate(sail_strips(tail))
    ]  # fmt: skip
    if tail.sail == "free":
        shown = lines[:1]
    else:
        shown = lines

    def joined(name: str) -> OutputPort:
        ports = [line.GetOutputPort(name) for line in shown]
        if len(ports) == 1:
            return ports[0]
        return concatenate(builder, f"sail_{name}", ports)

    return SailReport(joined("sections"), joined("validity"))
