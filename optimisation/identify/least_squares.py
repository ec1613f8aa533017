"""The statement of a least-squares fit: parameters with bounds and priors, residual, solution.

`fit_program` states it as a `MathematicalProgram`, `gauss_newton` solves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from aerodima.workbench.core.array_types import FloatArray, IntArray, Texts, Values
from aerodima.workbench.core.deprecation import warn_renamed
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.key_errors import require_unique

Residual = Callable[[FloatArray], FloatArray]
Jacobian = Callable[[FloatArray], FloatArray]
T = TypeVar("T")

_DIFFERENCE = 1e-5
"""Step of one-sided differences, in scales: sqrt(1e-10), for rollouts that repeat to about ten
digits."""
_CENTRAL_DIFFERENCE = 5e-4
"""Step of central differences, in scales: cube root of 1e-10."""
_AT_BOUND = 1e-6
"""Distance from a bound, in scales, within which an unknown is at it."""


def _accept_seed(kind: type[T]) -> type[T]:
    """Let a class take the deprecated keyword `seed` for `initial`."""
    untyped: Any = kind
    make = untyped.__init__

    @wraps(make)
    def make_with_seed(self: T, *arguments: Any, **options: Any) -> None:
        if "seed" in options:
            warn_renamed("Parameter(seed=)", "initial=")
            options["initial"] = options.pop("seed")
        make(self, *arguments, **options)

    untyped.__init__ = make_with_seed
    return kind


@_accept_seed
@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Attributes:
        name: name of the parameter, unique in its fit.
        unit: SI unit; `1` for a pure number.
        initial: value at which the solver starts; the value itself when fixed.
        lower: lower bound; minus infinity by default.
        upper: upper bound; infinity by default.
        fixed: whether the parameter keeps its initial value and is no unknown.
        scale: typical size, in `unit`: the solver works on value / scale. By default a quarter of
            the range between finite bounds, else the size of the initial value, else 1.
        prior_std: standard deviation with which the initial value is known beforehand; infinite
            when nothing is known. Fits with constants of a rig and of a car use it; a problem of
            your own has a row (value - initial) / prior_std in its weighted residual.
        seed: deprecated name of `initial`.

    Raises:
        FitError: bounds that are NaN, empty or exclude the initial value, an initial value that is
            not finite, or a scale that is not a finite number above 0.
    """

    name: str
    unit: str
    initial: float = math.nan
    lower: float = -math.inf
    upper: float = math.inf
    fixed: bool = False
    scale: float | None = None
    prior_std: float = math.inf

    def __post_init__(self) -> None:
        who = f"parameter {self.name!r}"
        bounds = f"{self.lower:g} .. {self.upper:g}"
        if not math.isfinite(self.initial):
            raise FitError(f"{who}: the initial value is {self.initial}, but must be finite")
        if not self.lower < self.upper:
            raise FitError(f"{who}: the bounds {bounds} {self.unit} hold no value")
        if not self.fixed and not self.lower <= self.initial <= self.upper:
            raise FitError(
                f"{who}: the initial value {self.initial:g} {self.unit} lies outside its bounds "
                f"{bounds}; move it or widen the bounds"
            )
        if self.scale is not None and not 0.0 < self.scale < math.inf:
            raise FitError(f"{who}: the scale is {self.scale}, but must be a finite number above 0")

    @property
    def seed(self) -> float:
        """Return the initial value, in `unit`; deprecated."""
        warn_renamed("Parameter.seed", "initial")
        return self.initial

    @property
    def size(self) -> float:
        """Scale that the solver uses, in `unit`."""
        if self.scale is not None:
            return self.scale
        span = self.upper - self.lower
        if math.isfinite(span):
            return 0.25 * span
        return abs(self.initial) or 1.0

    @property
    def has_prior(self) -> bool:
        """True if the initial value is known beforehand."""
        return math.isfinite(self.prior_std)

    def starting_at(self, value: float) -> Parameter:
        """Make the parameter with another initial value, moved into the bounds."""
        return replace(self, initial=min(max(value, self.lower), self.upper))


@dataclass(frozen=True)
class Parameters:
    """An ordered set of parameters; vectors of a fit hold the free ones in this order.

    Attributes:
        all: parameters of the fit, the fixed ones included.

    Raises:
        FitError: two parameters have the same name, or none is free.
    """

    all: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        require_unique([parameter.name for parameter in self.all], "parameter", FitError)
        if not self.free:
            raise FitError("no parameter is free; there is nothing to fit")

    @classmethod
    def of(cls, parameters: Iterable[Parameter]) -> Parameters:
        """Make the set of these parameters."""
        return cls(tuple(parameters))

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Parameters that are not fixed: the unknowns."""
        return tuple(parameter for parameter in self.all if not parameter.fixed)

    @property
    def names(self) -> Texts:
        """Names of the unknowns."""
        return tuple(parameter.name for parameter in self.free)

    @property
    def initial(self) -> FloatArray:
        """Initial values of the unknowns (p)."""
        return np.array([parameter.initial for parameter in self.free])

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of the unknowns (p)."""
        return np.array([parameter.lower for parameter in self.free])

    @property
    def upper(self) -> FloatArray:
        """Upper bounds of the unknowns (p)."""
        return np.array([parameter.upper for parameter in self.free])

    @property
    def scales(self) -> FloatArray:
        """Scales of the unknowns (p)."""
        return np.array([parameter.size for parameter in self.free])

    def values(self, x: Sequence[float] | FloatArray) -> dict[str, float]:
        """List all values by name, the fixed ones included, for a vector of the unknowns."""
        return {parameter.name: parameter.initial for parameter in self.all} | self.by_name(x)

    def by_name(self, x: Iterable[float]) -> dict[str, float]:
        """List numbers of the unknowns (p) by their names."""
        return dict(zip(self.names, map(float, x), strict=True))

    def starts(self, starts: Iterable[Values] = ()) -> list[FloatArray]:
        """List the vectors to start from: the initial values, then further ones by name.

        A missing name keeps its initial value.

        Raises:
            FitError: a start names no free parameter or lies outside the bounds.
        """
        vectors = [self.initial]
        for start in starts:
            unknown = sorted(set(start) - set(self.names))
            if unknown:
                raise FitError(
                    f"start for {', '.join(unknown)}: the free parameters are "
                    f"{', '.join(self.names)}"
                )
            moved = [replace(p, initial=start.get(p.name, p.initial)) for p in self.free]
            vectors.append(Parameters.of(moved).initial)
        return vectors

    def sides(self, x: FloatArray) -> IntArray:
        """Tell on which bound each unknown sits (p): -1 lower, 1 upper, 0 none."""
        margin = _AT_BOUND * self.scales
        return np.where(x <= self.lower + margin, -1, np.where(x >= self.upper - margin, 1, 0))


@dataclass(frozen=True)
class Problem:
    """A least-squares problem: minimise |residual|^2 / 2 over the free parameters within bounds.

    Attributes:
        parameters: parameters of the model, free and fixed.
        residual: function that returns the weighted residual (m) of the unknowns (p) in their
            units; raises `FitError` where the model does not exist.
        jacobian: function that returns d residual / d unknowns (m x p); finite differences are
            taken without it.
        name: name of the fit, for messages.
        steps: steps of the one-sided differences (p), in the units of the unknowns, for residuals
            that are rough; 1e-5 scales by default.
    """

    parameters: Parameters
    residual: Residual
    jacobian: Jacobian | None = None
    name: str = "fit"
    steps: FloatArray | None = None

    def finite_residual(self, x: FloatArray) -> FloatArray:
        """Compute the residual (m); FitError that names the unknowns when it is not finite."""
        r = np.asarray(self.residual(x), float)
        bad = np.flatnonzero(~np.isfinite(r))
        if bad.size:
            raise FitError(
                f"the residual is not finite ({r[bad[0]]} in row {bad[0]}) at {self.describe(x)}"
            )
        return r

    def forward_jacobian(self, x: FloatArray, at_x: FloatArray) -> FloatArray:
        """Compute the Jacobian (m x p): the given one, or one-sided differences within the bounds.

        Args:
            x: unknowns (p).
            at_x: residual at x (m).

        Raises:
            FitError: the Jacobian is not finite.
        """
        if self.jacobian is not None:
            J = np.asarray(self.jacobian(x), float)
        else:
            steps = self.steps
            if steps is None:
                steps = _DIFFERENCE * self.parameters.scales
            steps = np.where(x + steps > self.parameters.upper, -steps, steps)
            rows = np.array([self.residual(vector) for vector in x + np.diag(steps)], float)
            J = ((rows - at_x) / steps[:, None]).T
        if not np.all(np.isfinite(J)):
            raise FitError(f"the derivative is not finite at {self.describe(x)}")
        return J

    def central_jacobian(self, x: FloatArray) -> FloatArray:
        """Compute the Jacobian for the covariance (m x p): the given one, or central differences.

        Differences are one-sided at a bound, and where the model ends on one side.

        Raises:
            FitError: the model ends on both sides.
        """
        if self.jacobian is not None:
            return np.asarray(self.jacobian(x), float)
        parameters = self.parameters
        columns = []
        steps = _CENTRAL_DIFFERENCE * parameters.scales
        for i, step in enumerate(steps):
            ends = []
            for value in (x[i] + step, x[i] - step):
                if not parameters.lower[i] <= value <= parameters.upper[i]:
                    value = x[i]
                ends.append(self._end_of_difference(x, i, value))
            (high, above), (low, below) = ends
            if high <= low:
                raise FitError(
                    f"{self.name}: no derivative by {parameters.names[i]}: the model ends on both "
                    f"sides of {self.describe(x)}"
                )
            columns.append((above - below) / (high - low))
        return np.array(columns).T

    def _end_of_difference(
        self, x: FloatArray, index: int, value: float
    ) -> tuple[float, FloatArray]:
        """Compute value and residual (m) at one end; those of x where the model does not exist."""
        moved = x.copy()
        moved[index] = value
        try:
            return value, self.finite_residual(moved)
        except FitError:
            return x[index], self.finite_residual(x)

    def describe(self, x: FloatArray) -> str:
        """Describe the unknowns in words."""
        pairs = zip(self.parameters.free, x, strict=True)
        return ", ".join(f"{p.name} = {value:.6g} {p.unit}" for p, value in pairs)


@dataclass(frozen=True)
class StartResult:
    """The result of one start.

    Attributes:
        start: unknowns at which the solver started (p).
        x: unknowns at which the solver ended (p).
        cost: value of all costs of the program; infinite when there never was a finite one.
        added_cost: part of `cost` that was added to |residual|^2 / 2.
        success: whether the solver met its tolerances.
        status: reason of the end, in the solver's words.
        iterations: number of steps of the solver.
        jacobian: Jacobian of the residual (m x p), as the last step took it; None if it is out of
            date.
    """

    start: FloatArray
    x: FloatArray
    cost: float
    success: bool
    status: str
    iterations: int
    jacobian: FloatArray | None = None
    added_cost: float = 0.0


@dataclass(frozen=True)
class Solution:
    """The result of the best start, with all others.

    Attributes:
        problem: problem that was solved.
        x: unknowns of the solution (p).
        residual: weighted residual at x (m).
        jacobian: Jacobian of the weighted residual at x (m x p).
        best: result of the start from which x was found.
        attempts: results of all starts, in order.
    """

    problem: Problem
    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    best: StartResult
    attempts: tuple[StartResult, ...]
