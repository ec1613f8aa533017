"""The motion of the air: constant wind, gusts, seeded turbulence, the tunnel's jet, and what a driving car feels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import cos, sin
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder, OutputPort, System

from aerodima.workbench.aero.jet import Jet
from aerodima.workbench.aero.tail_force import resolve_body
from aerodima.workbench.errors import ModelError
from aerodima.workbench.systems.autodiff_system import LeafSystem_, system_template
from aerodima.workbench.systems.event_order import Stage, period_of

Vector3 = tuple[float, float, float]
_CALM: Vector3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class WindModel:
    """v_WA(t) = mean + gust sin(2 pi f t + phase) + turbulence, everywhere the same; all in world axes.

    Attributes:
        mean: m/s (3).
        gust: amplitude of the sinusoidal gust, m/s (3).
        gust_frequency: f, Hz.
        gust_phase: rad.
        turbulence: standard deviation of the filtered noise per axis, m/s (3).
        time_constant: of its first-order filter, s; white noise through it has correlation exp(-t / time_constant).
        update_period: of the noise, s; it is held in between.
        seed: equal seeds give equal turbulence, on every machine and for every context.
    """

    mean: Vector3 = _CALM
    gust: Vector3 = _CALM
    gust_frequency: float = 1.0
    gust_phase: float = 0.0
    turbulence: Vector3 = _CALM
    time_constant: float = 0.5
    update_period: float = 0.01
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("mean", "gust", "turbulence"):
            value = getattr(self, name)
            if len(value) != 3 or not np.all(np.isfinite(value)):
                raise ModelError(f"wind: {name} is {value}, but it must be three finite numbers (m/s)")
        if min(self.turbulence) < 0.0:
            raise ModelError(f"wind: turbulence is {self.turbulence}, but a standard deviation cannot be negative")
        for name in ("gust_frequency", "time_constant", "update_period"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ModelError(f"wind: {name} is {value}, but it must be a finite number above 0")
        if self.seed < 0:
            raise ModelError(f"wind: seed is {self.seed}, but it must be a whole number from 0")

    @classmethod
    def in_jet(cls, jet: Jet, speed: float, **gusts: Any) -> WindModel:
        """The tunnel's wind: `speed` (m/s) in the downstream direction of the jet."""
        x, y, z = (speed * part for part in jet.downstream_W)
        return cls(mean=(x, y, z), **gusts)

    def turbulence_step(self, step: int, previous: Any) -> list[Any]:
        """The filtered noise after one more update; `step` 0 draws from the stationary distribution."""
        noise = np.random.Generator(np.random.Philox(key=self.seed, counter=[0, 0, 0, step])).standard_normal(3)
        if step == 0:
            return [std * x for std, x in zip(self.turbulence, noise, strict=True)]
        keep = math.exp(-self.update_period / self.time_constant)
        spread = math.sqrt(1.0 - keep * keep)
        return [keep * p + spread * std * x for p, std, x in zip(previous, self.turbulence, noise, strict=True)]


@system_template("WindSource_", __name__)
def WindSource_(T: Any) -> Any:  # noqa: N802 (Drake's name for a template)
    """Template over the scalar type; see `WindSource`."""

    class Impl(LeafSystem_[T]):  # type: ignore[misc]  # the base is not in the stubs
        """The wind of a `WindModel`.

        Output ports:
            wind_velocity (3): v_WA of the air in W, m/s.
            wind_acceleration (3): of mean and gust, m/s2; turbulence is held between updates and has none.
        """

        def _construct(self, model: WindModel, converter: Any = None) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            self._model = model
            self._turbulent = max(model.turbulence) > 0.0
            if self._turbulent:
                self.DeclareDiscreteState(model.turbulence_step(0, None))
                # The update at 0 changes nothing.
                self.DeclarePeriodicDiscreteUpdateEvent(
                    period_of(1.0 / model.update_period, Stage.WIND), 0.0, self._update
                )
            self.DeclareVectorOutputPort("wind_velocity", 3, self._calc)
            self.DeclareVectorOutputPort("wind_acceleration", 3, self._calc_acceleration)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other._model, converter)

        def _calc_acceleration(self, context: Any, output: Any) -> None:
            omega = 2.0 * math.pi * self._model.gust_frequency
            wave = omega * cos(omega * context.get_time() + self._model.gust_phase)
            output.SetFromVector([gust * wave for gust in self._model.gust])

        def _update(self, context: Any, state: Any) -> None:
            time = context.get_time()
            seconds = time if isinstance(time, float) else time.value()
            step = round(seconds / self._model.update_period)
            state.get_mutable_vector().SetFromVector(
                self._model.turbulence_step(step, context.get_discrete_state_vector().CopyToVector())
            )

        def _calc(self, context: Any, output: Any) -> None:
            model = self._model
            wave = sin(2.0 * math.pi * model.gust_frequency * context.get_time() + model.gust_phase)
            wind = [mean + gust * wave for mean, gust in zip(model.mean, model.gust, strict=True)]
            if self._turbulent:
                wind = [w + x for w, x in zip(wind, context.get_discrete_state_vector().CopyToVector(), strict=True)]
            output.SetFromVector(wind)

    return Impl


WindSource = WindSource_[float]


@system_template("ApparentWind_", __name__)
def ApparentWind_(T: Any) -> Any:  # noqa: N802 (Drake's name for a template)
    """Template over the scalar type; see `ApparentWind`."""

    class Impl(LeafSystem_[T]):  # type: ignore[misc]  # the base is not in the stubs
        """What a sensor on a moving body feels: v_air - v_point, in body axes. `TailForce` needs no such system.

        Input ports:
            plant_state: multibody state [q; v].
            wind_velocity (optional, 3): v_WA in W, m/s.
        Output ports:
            apparent_wind (3): in body axes, m/s; a car that drives forward in still air reads (-speed, 0, 0).
        """

        def _construct(self, plant: Any, body: Any, p_BoQ_B: Vector3 = _CALM, converter: Any = None) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            self._plant, self._body, self._point = plant, resolve_body(plant, body).index(), p_BoQ_B
            self._kinematics = plant.CreateDefaultContext()
            self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
            self._wind = self.DeclareVectorInputPort("wind_velocity", 3)
            self.DeclareVectorOutputPort("apparent_wind", 3, self._calc)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            plant = other._plant.ToScalarType[T]()
            Impl._construct(self, plant, plant.get_body(other._body), other._point, converter)

        def _calc(self, context: Any, output: Any) -> None:
            plant, kinematics, body = self._plant, self._kinematics, self._plant.get_body(self._body)
            plant.SetPositionsAndVelocities(kinematics, self._state.Eval(context))
            R_WB = plant.EvalBodyPoseInWorld(kinematics, body).rotation().matrix()
            V_WB = plant.EvalBodySpatialVelocityInWorld(kinematics, body)
            v = V_WB.translational() + np.cross(V_WB.rotational(), R_WB @ np.asarray(self._point))
            wind = self._wind.Eval(context) if self._wind.HasValue(context) else np.zeros(3)
            output.SetFromVector(R_WB.T @ (wind - v))

    return Impl


ApparentWind = ApparentWind_[float]


def add_wind(builder: DiagramBuilder, model: WindModel | None = None) -> OutputPort:
    """Adds a `WindSource`; returns its port for `add_tail_force(..., wind=port)`."""
    return builder.AddNamedSystem("wind", WindSource(model or WindModel())).GetOutputPort("wind_velocity")


def add_apparent_wind(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    body: RigidBody | str,
    p_BoQ_B: Vector3 = _CALM,
    wind: OutputPort | None = None,
) -> System:
    """Adds an `ApparentWind` sensor at a point of a body and wires it."""
    sensor = builder.AddSystem(ApparentWind(plant, body, p_BoQ_B))
    builder.Connect(plant.get_state_output_port(), sensor.GetInputPort("plant_state"))
    if wind is not None:
        builder.Connect(wind, sensor.GetInputPort("wind_velocity"))
    return sensor
