"""Options of a fit of a rig log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from aerodima.optimisation.identify.huber import Loss
from aerodima.optimisation.identify.least_squares import Parameter
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Settings

Knowledge = Literal["uncertain", "exact"]


@dataclass(frozen=True)
class FitOptions:
    """Options that every fit of a rig log understands; those that a fit has no use for are refused
    by its command.

    Attributes:
        loss: loss function, `squares` or `huber`, which holds back samples that lie far off.
        bounds: name of a parameter with its lower and upper bound, in place of the model's own.
        rig: name or file of the rig scenario that the log was made on; the log's own by default,
            else `models/`.
        settings: overrides on top of the rig, `section.key=value`.
        free: constants of the rig and errors of its instruments (`models/rig/constants.csv`) that
            are unknowns without a prior.
        constants: knowledge of the rig's constants: `uncertain`, by the scenario's section
            `uncertainty`, or `exact`, with intervals from noise alone.
    """

    loss: Loss = "squares"
    bounds: tuple[tuple[str, float, float], ...] = ()
    rig: str = ""
    settings: Settings = ()
    free: tuple[str, ...] = ()
    constants: Knowledge = "uncertain"

    def bounded(self, parameters: Sequence[Parameter]) -> list[Parameter]:
        """Put parameters and their initial values within these bounds; FitError for a bound that
        belongs to none of them.
        """
        self.require_known([p.name for p in parameters])
        limits = {name: (low, high) for name, low, high in self.bounds}
        within = []
        for p in parameters:
            if not p.fixed:
                low, high = limits.get(p.name, (p.lower, p.upper))
                p = replace(p, initial=min(max(p.initial, low), high), lower=low, upper=high)
            within.append(p)
        return within

    def require_known(self, names: Sequence[str]) -> None:
        """Raise FitError for a bound on something that the fit does not have."""
        unknown = [name for name, _, _ in self.bounds if name not in names]
        if unknown:
            raise FitError(f"bound on {unknown[0]!r}: the free parameters are {', '.join(names)}")


FREE = FitOptions()
"""Default options: least squares within the model's own bounds, on the rig that the log names."""
