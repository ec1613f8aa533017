"""A least-squares problem: parameters, residual, what becomes of its starts, the best of them,
Huber's loss.

The loss has squares within a limit and is straight beyond it, so that a few wild values do not
decide a fit. The limit stands in units of a scale taken from the data: 1.4826 times the median
deviation of the residual, which is the standard deviation of normal data however far a minority
lies off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import FitError

Residual = Callable[[FloatArray], FloatArray]
Jacobian = Callable[[FloatArray], FloatArray]

_DIFFERENCE = 1e-5
"""Step of one-sided differences, in scales: sqrt(1e-10), for rollouts that repeat to about ten
digits."""
_CENTRAL_DIFFERENCE = 5e-4
"""Step of differences to both sides: cube root of 1e-10."""
_SAME_COST = 1.01
"""Costs within this factor are the same minimum."""
Loss = Literal["squares", "huber"]
LOSSES: tuple[Loss, ...] = ("squares", "huber")
LIMIT = 1.345
"""In standard deviations: 95 % efficient on normal data."""
_NORMAL = 1.4826
"""Standard deviation of normal data over its median deviation."""
_SETTLED = 0.05
"""Relative change of the scale below which it has settled."""
_MOST_SCALES = 4
"""Most fits with the scale taken anew."""


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Attributes:
        name: unique in its fit.
        unit: SI; `1` for a pure number.
        seed: where the solver starts; the value itself when frozen.
        lower, upper: bounds; infinite by default.
        frozen: keeps its seed and is no unknown.
        scale: typical size, in `unit`: the solvers work on value / scale. By default a quarter of
            the range between finite bounds, else the size of the seed, else 1.
        deviation: standard deviation with which the seed is known beforehand; infinite when nothing
            is known.

    Raises:
        FitError: bounds that are NaN, empty or exclude the seed, or a seed that is not finite.
    """

    name: str
    unit: str
    seed: float
    lower: float = -math.inf
    upper: float = math.inf
    frozen: bool = False
    scale: float | None = None
    deviation: float = math.inf

    def __post_init__(self) -> None:
        who = f"parameter {self.name!r}"
        bounds = f"{self.lower:g} .. {self.upper:g}"
        if not math.isfinite(self.seed):
            raise FitError(f"{who}: the seed is {self.seed}, but it must be a finite number")
        if not self.lower < self.upper:
            raise FitError(f"{who}: the bounds {bounds} {self.unit} hold no value")
        if not self.frozen and not self.lower <= self.seed <= self.upper:
            raise FitError(
                f"{who}: the seed {self.seed:g} {self.unit} lies outside its bounds {bounds}; "
                "move the seed or widen the bounds"
            )
        scale = self.scale
        if scale is not None and not (math.isfinite(scale) and scale > 0.0):
            raise FitError(f"{who}: the scale is {scale}, but must be a finite number above 0")

    @property
    def size(self) -> float:
        """The scale that the solvers use, in `unit`."""
        if self.scale is not None:
            return self.scale
        span = self.upper - self.lower
        if math.isfinite(span):
            return 0.25 * span
        return abs(self.seed) or 1.0


@dataclass(frozen=True)
class Parameters:
    """An ordered set of parameters; vectors of a fit hold the free ones in this order.

    Raises:
        FitError: two parameters have the same name, or none is free.
    """

    all: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        names = [parameter.name for parameter in self.all]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise FitError(f"parameters named twice: {', '.join(twice)}")
        if not self.free:
            raise FitError("no parameter is free; there is nothing to fit")

    @classmethod
    def of(cls, parameters: Iterable[Parameter]) -> Parameters:
        """The set of these parameters."""
        return cls(tuple(parameters))

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The unknowns."""
        return tuple(parameter for parameter in self.all if not parameter.frozen)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(parameter.name for parameter in self.free)

    @property
    def seed(self) -> FloatArray:
        """Seeds of the unknowns (p)."""
        return np.array([parameter.seed for parameter in self.free])

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
        """All values by name, the frozen ones included, for a vector of the unknowns."""
        free = dict(zip(self.names, (float(value) for value in x), strict=True))
        return {parameter.name: free.get(parameter.name, parameter.seed) for parameter in self.all}

    def starts(self, seeds: Iterable[Mapping[str, float]] = ()) -> list[FloatArray]:
        """Vectors to start from: the seeds of the parameters, then further ones by name; a missing
        name keeps its seed.

        Raises:
            FitError: a seed names no free parameter or lies outside the bounds.
        """
        vectors = [self.seed]
        for seed in seeds:
            unknown = sorted(set(seed) - set(self.names))
            if unknown:
                raise FitError(
                    f"seed for {', '.join(unknown)}: the free parameters are "
                    f"{', '.join(self.names)}"
                )
            vectors.append(
                np.array([replace(p, seed=seed.get(p.name, p.seed)).seed for p in self.free])
            )
        return vectors

    def sides(self, x: FloatArray) -> IntArray:
        """Which unknowns sit on a bound (p): -1 on the lower one, 1 on the upper one, else 0."""
        margin = 1e-6 * self.scales
        return np.where(x <= self.lower + margin, -1, np.where(x >= self.upper - margin, 1, 0))

    def active(self, x: FloatArray) -> dict[str, str]:
        """Unknowns that sit on a bound, with `lower` or `upper`."""
        words = {-1: "lower", 1: "upper"}
        return {
            name: words[side]
            for name, side in zip(self.names, self.sides(x).tolist(), strict=True)
            if side
        }


@dataclass(frozen=True)
class Problem:
    """A least-squares problem: minimise |residual|^2 / 2 over the free parameters within their
    bounds.

    Attributes:
        parameters: what may change.
        residual: weighted residual (m) of the unknowns (p) in their units; `FitError` where the
            model does not exist.
        jacobian: d residual / d unknowns (m x p); finite differences without it.
        name: of the fit, for messages.
    """

    parameters: Parameters
    residual: Residual
    jacobian: Jacobian | None = None
    name: str = "fit"

    def differences(self, x: FloatArray, at_x: FloatArray) -> FloatArray:
        """The Jacobian (m x p): given, or one-sided differences that stay within the bounds."""
        if self.jacobian is not None:
            return np.asarray(self.jacobian(x), float)
        steps = _DIFFERENCE * self.parameters.scales
        steps = np.where(x + steps > self.parameters.upper, -steps, steps)
        rows = np.array([self.residual(vector) for vector in x + np.diag(steps)], float)
        return ((rows - at_x) / steps[:, None]).T

    def central_differences(self, x: FloatArray) -> FloatArray:
        """The Jacobian for the covariance (m x p): differences to both sides.

        One-sided at a bound, and where the model ends on the other side; FitError when it ends on
        both.
        """
        if self.jacobian is not None:
            return np.asarray(self.jacobian(x), float)
        count = len(x)
        parameters = self.parameters
        steps = _CENTRAL_DIFFERENCE * parameters.scales
        up = np.where(x + steps > parameters.upper, x, x + steps)
        down = np.where(x - steps < parameters.lower, x, x - steps)
        moved = np.concatenate([x + np.diag(up - x), x + np.diag(down - x)])
        rows = [self._residual_or_none(v) for v in moved]
        lost = np.array([row is None for row in rows])
        if np.any(lost):
            here = finite_residual(self, x)
            rows = [here if row is None else row for row in rows]
            up = np.where(lost[:count], x, up)
            down = np.where(lost[count:], x, down)
        if np.any(up <= down):
            name = parameters.names[int(np.argmax(up <= down))]
            raise FitError(
                f"{self.name}: no derivative by {name}: the model ends on both sides of "
                f"{self.describe(x)}"
            )
        rise = np.array(rows[:count]) - np.array(rows[count:])
        return (rise / (up - down)[:, None]).T

    def _residual_or_none(self, x: FloatArray) -> FloatArray | None:
        """The residual; None where the model does not exist or is not finite."""
        try:
            row = np.asarray(self.residual(x), float)
        except FitError:
            return None
        return row if np.all(np.isfinite(row)) else None

    def describe(self, x: FloatArray) -> str:
        """The unknowns in words."""
        free = self.parameters.free
        return ", ".join(
            f"{p.name} = {value:.6g} {p.unit}" for p, value in zip(free, x, strict=True)
        )


@dataclass(frozen=True)
class Attempt:
    """What became of one start.

    Attributes:
        start, x: unknowns (p).
        cost: |residual|^2 / 2; infinite when the solver never got a finite one.
        success: the solver met its tolerances.
        status: in the solver's words.
        iterations: steps of Levenberg-Marquardt, or evaluations of the residual by SNOPT.
    """

    start: FloatArray
    x: FloatArray
    cost: float
    success: bool
    status: str
    iterations: int


@dataclass(frozen=True)
class Solution:
    """The best attempt, with all others.

    Attributes:
        problem: that was solved.
        x: unknowns (p).
        residual: weighted, at x (m).
        jacobian: of the weighted residual at x (m x p).
        best: the attempt that x is from.
        attempts: one per start, in order.
    """

    problem: Problem
    x: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    best: Attempt
    attempts: tuple[Attempt, ...]


Solver = Callable[[Problem, FloatArray], Attempt]


def solve(problem: Problem, method: Solver, starts: Sequence[FloatArray] | None = None) -> Solution:
    """Runs a solver from every start and keeps the lowest cost; of costs within 1 % the one of a
    success.

    Raises:
        FitError: no start gave a finite residual; the message has the reason of each.
    """
    if starts is None:
        starts = [problem.parameters.seed]
    else:
        starts = list(starts)
    attempts = tuple(method(problem, np.asarray(start, float)) for start in starts)
    least = min(attempt.cost for attempt in attempts)
    near = [attempt for attempt in attempts if attempt.cost <= _SAME_COST * least]
    best = min(near, key=lambda attempt: (not attempt.success, attempt.cost), default=attempts[0])
    if not np.isfinite(best.cost):
        reasons = "; ".join(dict.fromkeys(attempt.status for attempt in attempts))
        raise FitError(f"{problem.name}: no start of {len(attempts)} could be solved: {reasons}")
    residual = np.asarray(problem.residual(best.x), float)
    return Solution(problem, best.x, residual, problem.central_differences(best.x), best, attempts)


def finite_residual(problem: Problem, x: FloatArray) -> FloatArray:
    """The residual; FitError that names the unknowns when it is not finite."""
    r = np.asarray(problem.residual(x), float)
    bad = np.flatnonzero(~np.isfinite(r))
    if bad.size:
        raise FitError(
            f"the residual is not finite ({r[bad[0]]} in row {bad[0]}) at {problem.describe(x)}"
        )
    return r


def finite_differences(problem: Problem, x: FloatArray, at_x: FloatArray) -> FloatArray:
    """`Problem.differences`; FitError that names the unknowns when they are not finite."""
    J = problem.differences(x, at_x)
    if not np.all(np.isfinite(J)):
        raise FitError(f"the derivative is not finite at {problem.describe(x)}")
    return J


def huber(residual: FloatArray, limit: float = LIMIT) -> FloatArray:
    """Residuals whose squares are twice the Huber loss: unchanged within the limit, growing like a
    root beyond it.
    """
    size = np.abs(residual)
    beyond = np.sqrt(np.maximum(2.0 * limit * size - limit * limit, 0.0))
    return np.where(size <= limit, residual, np.sign(residual) * beyond)


def spread(values: FloatArray) -> float:
    """1.4826 times the median deviation from the median."""
    return _NORMAL * float(np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True)
class HuberSolution:
    """A solution under Huber's loss.

    Attributes:
        solution: x, and residual and Jacobian of the problem as it was given; its attempts end with
            the robust one.
        influence: the same x with the clipped residual, and the Jacobian times the share of the
            residuals within the limit: J^+ S J^+' of it is Huber's asymptotic covariance.
        scale: standard deviation of the residual without its outliers.
        beyond: number of residuals that the loss holds back more than three scales.
    """

    solution: Solution
    influence: Solution
    scale: float
    beyond: int


def solve_huber(problem: Problem, method: Solver, squares: Solution) -> HuberSolution:
    """Minimises Huber's loss from the least-squares solution on; the scale is taken anew until it
    settles.

    Raises:
        FitError: no finite residual on the way.
    """
    found = squares
    scale = spread(found.residual)
    # Residuals that vanish (fewer rows than unknowns, exact data) have no outliers.
    least = 1e-9 * max(float(np.max(np.abs(found.residual))), 1e-300)
    for _ in range(_MOST_SCALES if scale > least else 0):
        robust = solve(_huberised(problem, scale), method, [found.x])
        residual = np.asarray(problem.residual(robust.x), float)
        found = replace(squares, x=robust.x, residual=residual, best=robust.best)
        before = scale
        scale = max(spread(residual), least)
        if abs(scale - before) <= _SETTLED * before:
            break
    if found is not squares:
        best = replace(found.best, status=f"Huber: {found.best.status}")
        attempts = (*squares.attempts, best)
        jacobian = problem.central_differences(found.x)
        found = replace(found, jacobian=jacobian, best=best, attempts=attempts)
    if scale <= least:
        return HuberSolution(found, found, scale, 0)
    residual = found.residual
    sizes = np.abs(residual)
    limit = LIMIT * scale
    clipped = np.clip(residual, -limit, limit)
    within = float(np.mean(sizes <= limit))
    influence = replace(found, residual=clipped, jacobian=within * found.jacobian)
    outliers = int(np.sum(sizes > 3.0 * scale))
    return HuberSolution(found, influence, scale, outliers)


def _huberised(problem: Problem, scale: float) -> Problem:
    """The problem whose squares are Huber's loss."""
    inner = problem.residual
    jacobian = problem.jacobian

    def slope(x: FloatArray) -> FloatArray:
        size = np.abs(np.asarray(inner(x), float)) / scale
        square = LIMIT * LIMIT
        beyond = LIMIT / np.sqrt(np.maximum(2.0 * LIMIT * size - square, square))
        assert jacobian is not None
        weight = np.where(size <= LIMIT, 1.0, beyond)
        return weight[:, None] * np.asarray(jacobian(x), float)

    return replace(
        problem,
        residual=lambda x: scale * huber(np.asarray(inner(x), float) / scale),
        jacobian=None if jacobian is None else slope,
    )
