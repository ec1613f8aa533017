"""Aims of a swerve, by name or as a function of the user's, and its score."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from aerodima.workbench.car.swerve import (
    LATER,
    Measure,
    Swerve,
    aside,
    course_change,
    max_side_lift,
    sustained,
    swerve_counts,
)
from aerodima.workbench.control.user_law import load_named, traceback_and_reason
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.key_errors import nearest

USUAL_SIZE = 0.3
"""Usual value of a user's aim, for the solver."""
FAILED = -1e3
"""Highest score of a swerve that does not count; the score falls as two wheels lift higher."""
LIFT_WEIGHT = 1e2
"""Weight of that lift in the score, 1/m."""


@dataclass(frozen=True)
class Aim:
    """Number of a swerve that is maximised.

    Attributes:
        name: name by which the aim is asked for.
        function: function of a `Swerve` that returns the value of each car (n,).
        unit: unit of the value.
        size: magnitude of a usual value, for the solver.
    """

    name: str
    function: Measure
    unit: str
    size: float

    def __call__(self, swerve: Swerve) -> FloatArray:
        """Returns the value of each car (n,).

        Raises:
            SweepError: the function raises, or returns something else.
        """
        shape = swerve.com_x.shape
        try:
            numbers = np.asarray(self.function(swerve), np.float64)
            if numbers.shape == shape:
                return numbers
            reason = f"returned {numbers.tolist()!s:.80}"
        except Exception as error:
            reason = traceback_and_reason(error)[1]
        raise SweepError(
            f"aim {self.name}: {reason}; must take a Swerve and return a number per car, {shape}"
        )


AIMS: Mapping[str, Aim] = {
    aim.name: aim
    for aim in (
        Aim("aside-0.5", aside, "m", 0.3),
        Aim("aside-1.0", partial(aside, after=LATER), "m", 1.5),
        Aim("course", course_change, "rad", 0.6),
        Aim("sustained", sustained, "m/s2", 4.0),
    )
}
"""Aims by the name that asks for them."""


def find_aim(name: str) -> Aim:
    """Returns an aim by name, or the function of a user's file, `mine.py:my_aim`.

    Raises:
        UserError: no such aim, file or function.
    """
    if ".py:" in name:
        function = load_named("--aim", name, "function", "mine.py:my_aim")
        return Aim(name, function, "", USUAL_SIZE)
    if name not in AIMS:
        raise SweepError(f"aim {name!r}: {nearest(name, list(AIMS))}, or mine.py:my_aim")
    return AIMS[name]


def as_aim(aim: Aim | Measure | str) -> Aim:
    """Returns an aim as it is, or makes one from a name or a function."""
    if isinstance(aim, Aim):
        return aim
    if isinstance(aim, str):
        return find_aim(aim)
    return Aim(aim.__name__, aim, "", USUAL_SIZE)


def score(swerve: Swerve, aim: Measure) -> FloatArray:
    """Returns scores of swerves (n,): the aim where a swerve counts, `FAILED` or less elsewhere."""
    value = aim(swerve)
    lifted = FAILED - LIFT_WEIGHT * np.maximum(max_side_lift(swerve), 0.0)
    return np.where(swerve_counts(swerve) & np.isfinite(value), value, lifted)
