"""The motion of the air: constant wind, gusts, seeded turbulence and the tunnel's jet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import cos, sin
from pydrake.systems.framework import DiagramBuilder, OutputPort

from aerodima.workbench.aero.laws import check_above_zero, check_from_zero
from aerodima.workbench.aero.sections import Jet
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.event_order import EventPriority, period_of
from aerodima.workbench.core.system_lifetime import LeafSystem_, system_template, weak_callback

Vector3 = tuple[float, float, float]
_CALM: Vector3 = (0.0, 0.0, 0.0)
"""No wind, m/s."""


@dataclass(frozen=True)
class WindModel:
    """v_WA(t) = mean + gust sin(2 pi f t + phase) + turbulence, everywhere the same; all in world
    axes.

    Attributes:
        mean: m/s (3).
        gust: amplitude of the sinusoidal gust, m/s (3).
        gust_frequency: f, Hz.
        gust_phase: rad.
        turbulence: standard deviation of the filtered noise per axis, m/s (3).
        time_constant: of its first-order filter, s; white noise through it has correlation exp(-t /
            time_constant).
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
                raise ModelError(
                    f"wind: {name} is {value}, but it must be three finite numbers (m/s)"
                )
        check_from_zero("wind: turbulence", min(self.turbulence), unit="m/s")
        for name, unit in (
            ("gust_frequency", "Hz"),
            ("time_constant", "s"),
            ("update_period", "s"),
        ):
            check_above_zero(f"wind: {name}", getattr(self, name), unit=unit)
        check_from_zero("wind: seed", self.seed, unit="1")

    @classmethod
    def in_jet(cls, jet: Jet, speed: float, **gusts: Any) -> WindModel:
        """The tunnel's wind: `speed` (m/s) in the downstream direction of the jet."""
        x, y, z = (speed * part for part in jet.downstream_W)
        return cls(mean=(x, y, z), **gusts)

    def turbulence_step(self, step: int, previous: Any) -> list[Any]:
        """Filtered noise after one more update; `step` 0 draws from the stationary distribution."""
        noise = np.random.Generator(
            np.random.Philox(key=self.seed, counter=[0, 0, 0, step])
        ).standard_normal(3)
        if step == 0:
            return [std * x for std, x in zip(self.turbulence, noise, strict=True)]
        keep = math.exp(-self.update_period / self.time_constant)
        spread = math.sqrt(1.0 - keep * keep)
        return [
            keep * p + spread * std * x
            for p, std, x in zip(previous, self.turbulence, noise, strict=True)
        ]


@system_template("WindSource_", __name__)
def WindSource_(T: Any) -> Any:  # noqa: N802 (Drake's name for a template)
    """Template over the scalar type; see `WindSource`."""

    class Impl(LeafSystem_[T]):  # type: ignore[misc]  # the base is not in the stubs
        """The wind of a `WindModel`.

        Output ports:
            wind_velocity (3): v_WA of the air in W, m/s.
            wind_acceleration (3): of mean and gust, m/s2; turbulence is held between updates and
                has none.
        """

        def _construct(self, model: WindModel, converter: Any = None) -> None:
            LeafSystem_[T].__init__(self, converter=converter)
            self._model = model
            self._turbulent = max(model.turbulence) > 0.0
            if self._turbulent:
                self.DeclareDiscreteState(model.turbulence_step(0, None))
                # The update at 0 changes nothing.
                self.DeclarePeriodicDiscreteUpdateEvent(
                    period_of(1.0 / model.update_period, EventPriority.WIND), 0.0, self._update
                )
            self.DeclareVectorOutputPort("wind_velocity", 3, weak_callback(self._calc))
            self.DeclareVectorOutputPort(
                "wind_acceleration", 3, weak_callback(self._calc_acceleration)
            )

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other._model, converter)

        def _calc_acceleration(self, context: Any, output: Any) -> None:
            omega = 2.0 * math.pi * self._model.gust_frequency
            wave = omega * cos(omega * context.get_time() + self._model.gust_phase)
            output.SetFromVector([gust * wave for gust in self._model.gust])

        def _update(self, context: Any, state: Any) -> None:
            time = context.get_time()
            if isinstance(time, float):
                seconds = time
            else:
                seconds = time.value()
            step = round(seconds / self._model.update_period)
            state.get_mutable_vector().SetFromVector(
                self._model.turbulence_step(
                    step, context.get_discrete_state_vector().CopyToVector()
                )
            )

        def _calc(self, context: Any, output: Any) -> None:
            model = self._model
            wave = sin(2.0 * math.pi * model.gust_frequency * context.get_time() + model.gust_phase)
            wind = [mean + gust * wave for mean, gust in zip(model.mean, model.gust, strict=True)]
            if self._turbulent:
                wind = [
                    w + x
                    for w, x in zip(
                        wind, context.get_discrete_state_vector().CopyToVector(), strict=True
                    )
                ]
            output.SetFromVector(wind)

    return Impl


WindSource = WindSource_[float]


def add_wind(builder: DiagramBuilder, model: WindModel | None = None) -> OutputPort:
    """Adds a `WindSource`; returns its port for `add_tail_force(..., wind=port)`."""
    return builder.AddNamedSystem("wind", WindSource(model or WindModel())).GetOutputPort(
        "wind_velocity"
    )
