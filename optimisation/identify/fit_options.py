"""What a user may choose for any fit of a rig log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from aerodima.optimisation.fit.fit_parameters import Parameter
from aerodima.optimisation.fit.least_squares import Loss
from aerodima.optimisation.identify.hold_mean import Drift, HoldLoss
from aerodima.workbench.errors import FitError


@dataclass(frozen=True)
class FitOptions:
    """Choices that every fit of a rig log understands; what a fit has no use for is refused by its command.

    Attributes:
        loss: `huber` holds samples back that lie far off.
        bounds: lower and upper bound by name of the parameter, in place of the model's own.
        rig: name or file of the rig scenario that the log was made on; the log's own by default, else `models/`.
        settings: overrides on top of it, `section.key=value`.
        free: constants of the rig and errors of its instruments (`constants`) that are unknowns without a prior.
        drift, hold_loss: of the force sensor in static holds, see `hold_mean`.
    """

    loss: Loss = "squares"
    bounds: tuple[tuple[str, float, float], ...] = ()
    rig: str = ""
    settings: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    drift: Drift = "linear"
    hold_loss: HoldLoss = "squares"

    def limits(self, parameter: Parameter) -> tuple[float, float]:
        """The bounds of a parameter."""
        found = {name: (low, high) for name, low, high in self.bounds}
        return found.get(parameter.name, (parameter.lower, parameter.upper))

    def require_known(self, names: Sequence[str]) -> None:
        """FitError for a bound on something that the fit does not have."""
        unknown = [name for name, _, _ in self.bounds if name not in names]
        if unknown:
            raise FitError(f"bound on {unknown[0]!r}: the free parameters are {', '.join(names)}")


FREE = FitOptions()
"""Least squares within the model's own bounds, on the rig that the log names."""
