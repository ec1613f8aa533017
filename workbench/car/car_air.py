"""The air around the simulated car: the wind of a scenario, the sections of its sail with their
coefficients, and their force on the tail.

The air acts on the sail, and on the bodies of `car_bodies`; the chassis feels none.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
)

from aerodima.workbench.aero.sail import FreeSail, SailMotion, generalised_force, sail_motion
from aerodima.workbench.aero.section_laws import (
    ROBOT_LIMIT,
    NormalForceLaw,
    SectionLaw,
    cross,
    facing_law,
    rotated,
    wind_direction,
)
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.aero.tail_force import add_tail_force
from aerodima.workbench.aero.wind import WindModel, WindSource
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.port_wiring import (
    add_and_connect,
    concatenate,
    declare_output,
    vector_of,
)
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.tail_parameters import (
    CONSTANT,
    SAIL_LAWS,
    SAIL_SHAPES,
    TailParameters,
)


def wind_model(scenario: Scenario, more_bodies: bool = False) -> WindModel | None:
    """Returns the wind that the scenario's tail and bodies meet; None in still air, and for a car
    without tail and bodies, which feels no wind.

    Args:
        more_bodies: whether there are bodies that the scenario does not know.
    """
    wind = scenario.wind
    has_bodies = more_bodies or scenario.car.has_bodies
    if wind.is_still or (not scenario.has_tail and not has_bodies):
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


def add_wind(
    builder: DiagramBuilder, scenario: Scenario, more_bodies: bool
) -> tuple[OutputPort | None, OutputPort | None]:
    """Adds the wind of a scenario to a diagram; returns the ports of its velocity, None where
    `wind_model` returns None, and of its acceleration, None without gusts.
    """
    model = wind_model(scenario, more_bodies)
    if model is None:
        return None, None
    wind = builder.AddNamedSystem("wind", WindSource(model))
    gust = None
    if scenario.wind.gust_amplitude > 0.0:
        gust = wind.GetOutputPort("wind_acceleration")
    return wind.GetOutputPort("wind_velocity"), gust


def sail_law(tail: TailParameters) -> tuple[SectionLaw, float]:
    """Returns the force law of a sail that stands as `tail.sail` says, and the relative speed (m/s)
    up to which the law was shown to hold.

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
    """Returns the sections of a sail that is locked or faces the wind, in the frame of the body
    `tail_sail`: z along the tail.

    The sail is drawn hollow towards +y (models/tail/tail.sdf), and its normal leaves the round
    side.

    Raises:
        ModelError: the tail has its own geometry, which may have several lines of sections; reduced
            cars have one.
    """
    if tail.has_own_geometry:
        raise ModelError(
            f"tail.geometry: {tail.geometry}; allowed: none, for a car with one straight sail"
        )
    (layout,) = tail_geometry(tail).section_layouts()
    return layout


def free_sail(tail: TailParameters, law: SectionLaw) -> FreeSail:
    """Makes the plates that stand for the sail on its bearing."""
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
    """Returns the lines of sections of the sail, each with its law, in the frame of `tail_sail`."""
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


class TailAerodynamics(LeafSystem):
    """The air on the car's tail, as a generalised force on chassis and joints.

    Each line of sections has a `SectionLaw`; the motion of the sail is in closed form, by test
    equal to Drake's. A list of spatial forces would make a Python object per step.

    Input ports:
        tail_motion (16): quaternion w, x, y, z, angular velocity, rad/s, and velocity, m/s, of the
            chassis in W; angles, rad, and rates, rad/s, of pitch, roll and sail joint.
        wind_velocity (3): velocity v_WA of the air in W, m/s; only if the air moves.
    Output ports:
        force (9): moment on the chassis about its origin, N m, and force on it, N, in W; torques
            on pitch, roll and sail joint, N m.
        wind_direction (1): direction of the wind at the first line of sections, rad, as the port
            of that name of `TailForce`.

    Args:
        scenario: scenario with the tail and the density of the air.
        p_BoSo_B: crossing point of the tail's joint axes in the chassis frame (3), m.
        windy: whether the air moves.
    """

    def __init__(self, scenario: Scenario, p_BoSo_B: FloatArray, windy: bool) -> None:
        super().__init__()
        self.set_name("tail_aerodynamics")
        self._lines = sail_strips(scenario.tail)
        self._density = scenario.environment.air_density
        self._p_BoSo_B = p_BoSo_B.tolist()
        self._motion = self.DeclareVectorInputPort("tail_motion", 16)
        self._wind = self.DeclareVectorInputPort("wind_velocity", 3) if windy else None
        declare_output(self, "force", 9, self._calc_force)
        declare_output(self, "wind_direction", 1, self._calc_wind_direction)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        scenario: Scenario,
        plant: MultibodyPlant,
        *,
        tail_motion: OutputPort,
        wind: OutputPort | None,
    ) -> TailAerodynamics:
        """Adds the air around the tail of a plant; still air without `wind`."""
        chassis = plant.GetFrameByName("chassis")
        sail = plant.GetFrameByName("tail_sail")
        X_BS = plant.CalcRelativeTransform(plant.CreateDefaultContext(), chassis, sail)
        air = cls(scenario, X_BS.translation(), wind is not None)
        add_and_connect(builder, air, tail_motion=tail_motion)
        if wind is not None:
            builder.Connect(wind, air.GetInputPort("wind_velocity"))
        return air

    def _sail(self, context: Context) -> tuple[SailMotion, Any]:
        """Returns the motion of the sail, and the velocity of the air, None where it is still."""
        x = vector_of(self._motion, context).tolist()
        sail = sail_motion(x[:4], x[4:10], x[10:13], x[13:], self._p_BoSo_B)
        wind = None if self._wind is None else vector_of(self._wind, context).tolist()
        return sail, wind

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        sail, wind = self._sail(context)
        loads = []
        for layout, law in self._lines:
            line = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind)
            load = law.line_force(line, layout.distances, layout.areas, self._density)
            if any(layout.p_BoRo_B):
                shift = cross(rotated(sail.R_WS, layout.p_BoRo_B), load[:3])
                load = (*load[:3], *(m + d for m, d in zip(load[3:], shift, strict=True)))
            loads.append(load)
        total = [sum(parts) for parts in zip(*loads, strict=True)]
        output.SetFromVector(np.array(generalised_force(sail, total[:3], total[3:])))

    def _calc_wind_direction(self, context: Context, output: BasicVector) -> None:
        sail, wind = self._sail(context)
        (layout, _) = self._lines[0]
        line = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind)
        output[0] = wind_direction(line, layout.distances, layout.areas)


def add_sail_report(
    builder: DiagramBuilder, plant: MultibodyPlant, scenario: Scenario, wind: OutputPort | None
) -> dict[str, OutputPort]:
    """Adds systems that report the air on the sail; `TailAerodynamics` applies its force.

    Returns:
        The ports `sections` and `validity` of `TailForce`: those of the sail's opening, or those of
        all lines of a tail with its own geometry.
    """
    tail = scenario.tail
    _, limit = sail_law(tail)
    air = Air(scenario.environment.air_density, scenario.environment.air_viscosity)
    lines = [
        add_tail_force(
            builder,
            plant,
            "tail_sail",
            layout,
            law,
            air=air,
            wind=wind,
            quasi_steady_limit=limit,
            applied=False,
            name=f"tail_force_tail_sail_{number}" if number else None,
        )
        for number, (layout, law) in enumerate(sail_strips(tail))
    ]
    if tail.sail == "free":
        lines = lines[:1]
    report = {}
    for name in ("sections", "validity"):
        ports = [line.GetOutputPort(name) for line in lines]
        if len(ports) == 1:
            report[name] = ports[0]
        else:
            report[name] = concatenate(builder, f"sail_{name}", ports)
    return report
