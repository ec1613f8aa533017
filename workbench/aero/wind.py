"""The motion of the air: constant wind, gusts, seeded turbulence and the tunnel's jet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import cos, sin
from pydrake.systems.framework import DiagramBuilder, OutputPort

from aerodima.workbench.aero.section_laws import check_above_zero, check_from_zero, float_of
from aerodima.workbench.aero.sections import Jet
from aerodima.workbench.core.array_types import Vector3
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.event_order import EventPriority, period_of
from aerodima.workbench.core.system_lifetime import SystemParts, scalar_template, weak_callback

_UPDATE_PERIOD = 0.01
"""Time for which the noise is held, s."""
_CALM: Vector3 = (0.0, 0.0, 0.0)
"""No wind, m/s."""


@dataclass(frozen=True)
class WindModel:
    """A wind v_WA(t) = mean + gust sin(2 pi f t) + turbulence, the same everywhere; all in world
    axes.

    Attributes:
        mean: constant part of the wind, m/s (3).
        gust: amplitude of the sinusoidal gust, m/s (3).
        gust_frequency: frequency f of the gust, Hz.
        turbulence: standard deviation of the filtered noise per axis, m/s (3).
        time_constant: time constant of the noise's first-order filter, s; white noise through it
            has correlation exp(-t / time_constant).
        seed: seed of the turbulence; equal seeds give equal turbulence, on every machine and for
            every context.
    """

    mean: Vector3 = _CALM
    gust: Vector3 = _CALM
    gust_frequency: float = 1.0
    turbulence: Vector3 = _CALM
    time_constant: float = 0.5
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("mean", "gust", "turbulence"):
            value = getattr(self, name)
            if len(value) != 3 or not np.all(np.isfinite(value)):
                raise ModelError(
                    f"wind: {name} is {value}, but it must be three finite numbers (m/s)"
                )
        check_from_zero("wind: turbulence", min(self.turbulence), unit="m/s")
        check_above_zero("wind: gust_frequency", self.gust_frequency, unit="Hz")
        check_above_zero("wind: time_constant", self.time_constant, unit="s")
        check_from_zero("wind: seed", self.seed, unit="1")

    @classmethod
    def in_jet(cls, jet: Jet, speed: float) -> WindModel:
        """Makes the tunnel's wind: `speed` (m/s) in the downstream direction of the jet."""
        x, y, z = (speed * part for part in jet.downstream_W)
        return cls(mean=(x, y, z))

    def turbulence_step(self, step: int, previous: Any) -> Any:
        """Returns the filtered noise after one more update; `step` 0 draws from the stationary
        distribution.
        """
        generator = np.random.Generator(np.random.Philox(key=self.seed, counter=[0, 0, 0, step]))
        noise = generator.standard_normal(3)
        deviation = np.array(self.turbulence)
        if step == 0:
            return deviation * noise
        keep = math.exp(-_UPDATE_PERIOD / self.time_constant)
        spread = math.sqrt(1.0 - keep * keep)
        return keep * previous + spread * deviation * noise


class WindParts(SystemParts):
    """The wind of a `WindModel`.

    Output ports:
        wind_velocity (3): velocity v_WA of the air in W, m/s.
        wind_acceleration (3): acceleration of mean and gust, m/s2; turbulence is held between
            updates and has none.
    """

    def declare(self, T: Any, model: WindModel) -> None:
        """Declares ports, and the state of a turbulent wind."""
        self._model = model
        self._omega = 2.0 * math.pi * model.gust_frequency
        self._turbulent = max(model.turbulence) > 0.0
        if self._turbulent:
            self.DeclareDiscreteState(model.turbulence_step(0, None))
            # The update at 0 changes nothing.
            period = period_of(1.0 / _UPDATE_PERIOD, EventPriority.WIND)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)
        self.DeclareVectorOutputPort("wind_velocity", 3, weak_callback(self._calc_velocity))
        self.DeclareVectorOutputPort("wind_acceleration", 3, weak_callback(self._calc_acceleration))

    def arguments(self, T: Any) -> tuple[WindModel]:
        """Returns the arguments of the same system of scalar type T."""
        return (self._model,)

    def _calc_acceleration(self, context: Any, output: Any) -> None:
        wave = self._omega * cos(self._omega * context.get_time())
        output.SetFromVector([gust * wave for gust in self._model.gust])

    def _update(self, context: Any, state: Any) -> None:
        step = round(float_of(context.get_time()) / _UPDATE_PERIOD)
        noise = context.get_discrete_state_vector().CopyToVector()
        state.get_mutable_vector().SetFromVector(self._model.turbulence_step(step, noise))

    def _calc_velocity(self, context: Any, output: Any) -> None:
        model = self._model
        wave = sin(self._omega * context.get_time())
        wind = [mean + gust * wave for mean, gust in zip(model.mean, model.gust, strict=True)]
        if self._turbulent:
            noise = context.get_discrete_state_vector().CopyToVector()
            wind = [steady + part for steady, part in zip(wind, noise, strict=True)]
        output.SetFromVector(wind)


WindSource_ = scalar_template("WindSource_", __name__, WindParts)
"""Template over the scalar type; see `WindParts`."""
WindSource = WindSource_[float]
"""The wind of a `WindModel` as a Drake system; see `add_wind`."""


def add_wind(builder: DiagramBuilder, model: WindModel | None = None) -> OutputPort:
    """Adds a `WindSource`; returns its port for `add_tail_force(..., wind=port)`."""
    return builder.AddNamedSystem("wind", WindSource(model or WindModel())).GetOutputPort(
        "wind_velocity"
    )
