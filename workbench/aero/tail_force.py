"""The aerodynamic wrench on a tail as a Drake system, and functions that wire it to a plant."""

import warnings
from typing import Any

import numpy as np
from pydrake.multibody.math import SpatialForce_
from pydrake.multibody.plant import (
    ExternallyAppliedSpatialForce_,
    ExternallyAppliedSpatialForceMultiplexer,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from aerodima.workbench.aero.idle_normal import idle_normal
from aerodima.workbench.aero.section_laws import (
    LineMotion,
    NormalForceLaw,
    SectionLaw,
    angle_of_attack,
    cross,
    dot,
    float_of,
    length,
    rotated,
    wind_direction,
)
from aerodima.workbench.aero.section_watch import (
    BEYOND_QUASI_STEADY,
    EXTRAPOLATED,
    MEASURED,
    NOT_EXPOSED,
)
from aerodima.workbench.aero.sections import Air, Jet, SectionLayout
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.port_wiring import (
    add_and_connect,
    declare_output,
    declare_spatial_forces,
)
from aerodima.workbench.core.system_lifetime import SystemParts, scalar_template

ADDED_MASS_PREFIX = "added_mass_"
"""Beginning of the names of model instances and bodies of added mass."""


class TailForceParts(SystemParts):
    """Aerodynamic wrench on a body made of sections on a straight line.

    The law is a `NormalForceLaw`, `TwoSidedLaw` or `PolarLaw` (design section 5), quasi-steady
    and smooth in the velocity, also at zero airspeed. Every section has the rigid-body velocity
    of its centre, omega x r included, so a driving car makes its own apparent wind.

    Body pose and velocity come from the plant's state through a context of our own: the two
    list ports of the plant cost 22-29 us per step on a car of 25 bodies, because every element
    becomes a Python object; the state port with forward kinematics costs 10 us. The geometry is
    therefore that of the plant at Finalize: frames moved in a context later are not seen. A
    system evaluates one context at a time; give each thread its own diagram.

    Input ports:
        plant_state: multibody state [q; v] of the plant.
        wind_velocity (optional, 3): v_WA of the air in W, m/s; still air when not connected.
    Output ports:
        spatial_forces: list[ExternallyAppliedSpatialForce], one wrench on the body.
        wrench (9): force on the body in W, N; moment about the body origin in W, N m; body
            origin in W, m.
        sections (4 n): for each section |v_rel| m/s, gamma rad, Reynolds number, magnitude of the
            force N.
        validity (n): for each section 0 outside the jet, 1 inside the measured range, 2 outside it
            (edge value held), 3 inside it but above the quasi-steady limit.
        wind_direction (1): direction of the wind, rad, see the function of that name; the angle
            by which a sail that faces the wind has turned.

    Attributes:
        plant, layout, law: see below.

    Args:
        plant: finalised plant, of double scalar; read for its kinematics only.
        body: body that carries the sections, or its name.
        layout: sections in the body frame.
        law: a `SectionLaw`, or a number for a constant C_N.
        air: density and viscosity of the air.
        jet: part of space where the wind blows and forces act (`Jet`); everywhere when
            None.
        quasi_steady_limit: relative speed up to which the model was shown to hold, m/s; no
            limit when None.
    """

    def declare(
        self,
        T: Any,
        plant: Any,
        body: Any,
        layout: SectionLayout,
        law: SectionLaw | float,
        air: Air | None = None,
        jet: Any = None,
        quasi_steady_limit: float | None = None,
    ) -> None:
        """Declares ports for a scalar type; arguments as above."""
        if isinstance(law, int | float):
            law = NormalForceLaw(law)
        self.plant = plant
        self._body = resolve_body(plant, body).index()  # not the object: design section 13
        self.layout = layout
        self.law = law
        self._air = air or Air()
        self._jet = jet
        self._quasi_steady_limit = quasi_steady_limit
        self._kinematics = plant.CreateDefaultContext()
        self._p_BoRo_B = layout.p_BoRo_B
        self._force = ExternallyAppliedSpatialForce_[T]()
        self._force.body_index = self._body
        self._force.p_BoBq_B = list(layout.p_BoRo_B)
        self._SpatialForce = SpatialForce_[T]
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self._wind = self.DeclareVectorInputPort("wind_velocity", 3)
        declare_spatial_forces(self, self._calc_forces, T)
        for name, size, calc in (
            ("wrench", 9, self._calc_wrench),
            ("sections", 4 * layout.number, self._calc_sections),
            ("validity", layout.number, self._calc_validity),
            ("wind_direction", 1, self._calc_wind_direction),
        ):
            declare_output(self, name, size, calc)

    def arguments(self, T: Any) -> tuple[Any, ...]:
        """Returns the arguments of the same system of scalar type T."""
        plant = self.plant.ToScalarType[T]()
        return plant, plant.get_body(self._body), *self._settings

    @property
    def _settings(self) -> tuple[Any, ...]:
        return self.layout, self.law, self._air, self._jet, self._quasi_steady_limit

    def reporter(self) -> Any:
        """Makes the same system again, to be read beside a diagram that hides its ports."""
        make: Any = type(self)
        return make(self.plant, self.body, *self._settings)

    @property
    def body(self) -> Any:
        """The body that carries the sections."""
        return self.plant.get_body(self._body)

    def _motion(self, context: Any) -> tuple[Any, LineMotion]:
        """Returns the body's pose (three rows of [R | p]) and the sections' motion in the air."""
        kinematics = self._kinematics
        plant = self.plant
        body = self.body
        plant.SetPositionsAndVelocities(kinematics, self._state.Eval(context))
        X_WB = plant.EvalBodyPoseInWorld(kinematics, body).GetAsMatrix34().tolist()
        V_WB = plant.EvalBodySpatialVelocityInWorld(kinematics, body)
        velocity = V_WB.get_coeffs().tolist()
        wind = None
        if self._wind.HasValue(context):
            wind = self._wind.Eval(context).tolist()
        return X_WB, self.layout.motion(X_WB, velocity[:3], velocity[3:], wind)

    def _exposed(self, X_WB: Any, a: Any) -> tuple[Any, Any]:
        """Returns distances and areas of the sections; with a jet those of the exposed part, areas
        0 without exposure.
        """
        if self._jet is None:
            return self.layout.distances, self.layout.areas
        p_WRo = tuple(dot(row, self._p_BoRo_B) + row[3] for row in X_WB)
        return self._jet.exposed_sections(self.layout, p_WRo, a)

    def _line_force(self, context: Any) -> tuple[Any, Any]:
        X_WB, line = self._motion(context)
        distances, areas = self._exposed(X_WB, line.a)
        return X_WB, self.law.line_force(line, distances, areas, self._air.density)

    def _calc_forces(self, context: Any, output: Any) -> None:
        _, (f_x, f_y, f_z, m_x, m_y, m_z) = self._line_force(context)
        self._force.F_Bq_W = self._SpatialForce(np.array((m_x, m_y, m_z, f_x, f_y, f_z)))
        output.set_value([self._force])

    def _calc_wrench(self, context: Any, output: Any) -> None:
        X_WB, force = self._line_force(context)
        shifts = cross(rotated(X_WB, self._p_BoRo_B), force[:3])
        moment = [m + shift for m, shift in zip(force[3:], shifts, strict=True)]
        output.SetFromVector([*force[:3], *moment, *(row[3] for row in X_WB)])

    def _section_rows(self, context: Any) -> list[tuple[Any, ...]]:
        """Lists for each section relative velocity (3), area, |v_rel|, gamma, axis, normal."""
        X_WB, line = self._motion(context)
        a = line.a
        rows = []
        for s, area in zip(*self._exposed(X_WB, a), strict=True):
            v = line.velocity(s)
            rows.append((v, area, length(v), angle_of_attack(v, a), a, line.n))
        return rows

    def _calc_sections(self, context: Any, output: Any) -> None:
        chord_by_viscosity = self.layout.chord * self._air.density / self._air.viscosity
        values: list[Any] = []
        for v, area, speed, angle, a, n in self._section_rows(context):
            force = length(self.law.section_force(v, a, n, area, self._air.density))
            values += [speed, angle, chord_by_viscosity * speed, force]
        output.SetFromVector(values)

    def _calc_validity(self, context: Any, output: Any) -> None:
        rows = self._section_rows(context)
        output.SetFromVector([self._validity(*map(float_of, row[1:4])) for row in rows])

    def _calc_wind_direction(self, context: Any, output: Any) -> None:
        X_WB, line = self._motion(context)
        output.SetFromVector([wind_direction(line, *self._exposed(X_WB, line.a))])

    def _validity(self, area: float, speed: float, angle: float) -> float:
        if area <= 0.0:
            return NOT_EXPOSED
        if not self.law.covers(speed, angle):
            return EXTRAPOLATED
        limit = self._quasi_steady_limit
        return BEYOND_QUASI_STEADY if limit is not None and speed > limit else MEASURED


TailForce_ = scalar_template("TailForce_", __name__, TailForceParts)
"""Template over the scalar type; see `TailForceParts`."""
TailForce = TailForce_[float]
"""Aerodynamic wrench on a body made of sections on a straight line, as a Drake system; see
`add_tail_force`."""


def bodies_of(plant: MultibodyPlant) -> list[RigidBody]:
    """Returns all bodies of a plant, the world first."""
    return [plant.get_body(BodyIndex(index)) for index in range(plant.num_bodies())]


def resolve_body(plant: Any, body: Any, place: str = "tail force") -> Any:
    """Returns the body that a body or a name stands for; ModelError when the plant has no such
    body, or is not finalised.

    Args:
        place: name of the caller, for messages.
    """
    if not plant.is_finalized():
        raise ModelError(f"{place}: the plant is not finalised; call plant.Finalize() first")
    if isinstance(body, str):
        bodies = bodies_of(plant)
        named = [other for other in bodies if other.name() == body]
        if len(named) != 1:
            names = ", ".join(other.scoped_name().get_full() for other in bodies)
            raise ModelError(
                f"{place}: body '{body}' is {len(named)} bodies of the plant ({names}); must be "
                "the name of one, or a body itself"
            )
        return named[0]
    if body.GetParentPlant() is not plant:
        raise ModelError(f"{place}: body '{body.name()}' does not belong to this plant")
    return body


def add_tail_force(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    body: RigidBody | str,
    layout: SectionLayout,
    law: SectionLaw | float,
    *,
    air: Air | None = None,
    wind: OutputPort | None = None,
    jet: Jet | None = None,
    quasi_steady_limit: float | None = None,
    name: str | None = None,
    applied: bool = True,
) -> System:
    """Adds a `TailForce` for one body and wires it: the plant's state in, its force out, and the
    wind when given.

    Several aerodynamic bodies, and other systems that apply spatial forces, may share a plant: see
    `connect_spatial_forces`.

    Args:
        builder: builder that owns the plant.
        law: a `SectionLaw`, or a number for a constant C_N.
        wind: port of the wind's velocity v_WA (3), m/s; None for still air.
        name: name of the system; `tail_force_<body>` by default.
        applied: whether the force acts on the plant; if not, the system only reports.

    In still air a normal along which no joint moves the sections gives a `UserWarning`: a swing
    then feels nothing.

    Raises:
        ModelError: the plant is not finalised or not in the builder, the body is not in the plant,
            another system has the name, or the jet meets the sections at no reachable angle.
    """
    if plant not in builder.GetSystems():
        raise ModelError(
            f"tail force: plant '{plant.get_name()}' is not in this builder; add it first"
        )
    carrier = resolve_body(plant, body)
    name = name or f"tail_force_{carrier.name()}"
    if builder.HasSubsystemNamed(name):
        raise ModelError(
            f"tail force: this builder has a system named '{name}' already; a second one on body "
            f"'{carrier.name()}' needs another name="
        )
    if jet is not None:
        jet.require_reachable(plant, carrier, layout)
    force = TailForce(plant, carrier, layout, law, air, jet, quasi_steady_limit)
    if wind is None and jet is None and force.law.knows_normal:
        line = idle_normal(plant, carrier, layout)
        if line:
            warnings.warn(line, UserWarning, stacklevel=2)
    inputs = {"plant_state": plant.get_state_output_port()}
    if wind is not None:
        inputs["wind_velocity"] = wind
    system = add_and_connect(builder, force, name, **inputs)
    if applied:
        connect_spatial_forces(builder, plant, system.GetOutputPort("spatial_forces"))
    return system


def connect_spatial_forces(
    builder: DiagramBuilder, plant: MultibodyPlant, forces: OutputPort
) -> None:
    """Connects one more list of applied spatial forces to a plant, behind a multiplexer when the
    port is already taken.

    Raises:
        ModelError: the plant's port was exported, so that nothing more can join it.
    """
    port = plant.get_applied_spatial_force_input_port()
    if not builder.IsConnectedOrExported(port):
        builder.Connect(forces, port)
        return
    source = builder.connection_map().get((plant, port.get_index()))
    if source is None:
        raise ModelError(
            f"plant '{plant.get_name()}': applied_spatial_force is exported; connect the "
            "aerodynamic bodies first"
        )
    present = source[0].get_output_port(source[1])
    builder.Disconnect(present, port)
    multiplexer = builder.AddSystem(ExternallyAppliedSpatialForceMultiplexer(2))
    multiplexer.set_name(f"applied_spatial_forces_{len(builder.GetSystems())}")
    builder.Connect(present, multiplexer.get_input_port(0))
    builder.Connect(forces, multiplexer.get_input_port(1))
    builder.Connect(multiplexer.get_output_port(), port)
