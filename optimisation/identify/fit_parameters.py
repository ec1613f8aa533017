"""What a fit may change: parameters with name, unit, seed and bounds; some of them frozen."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerodima.workbench.errors import FitError


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    Attributes:
        name: unique in its fit.
        unit: SI; `1` for a pure number.
        seed: where the solver starts; the value itself when frozen.
        lower, upper: bounds; infinite by default.
        frozen: keeps its seed and is no unknown.
        scale: typical size, in `unit`: the solvers work on value / scale. By default a quarter of the range between
            finite bounds, else the size of the seed, else 1.
        deviation: standard deviation with which the seed is known beforehand; infinite when nothing is known.

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
        if not math.isfinite(self.seed):
            raise FitError(f"parameter {self.name!r}: the seed is {self.seed}, but it must be a finite number")
        if not self.lower < self.upper:
            raise FitError(
                f"parameter {self.name!r}: the bounds {self.lower:g} .. {self.upper:g} {self.unit} hold no value"
            )
        if not self.frozen and not self.lower <= self.seed <= self.upper:
            raise FitError(
                f"parameter {self.name!r}: the seed {self.seed:g} {self.unit} lies outside its bounds "
                f"{self.lower:g} .. {self.upper:g}; move the seed or widen the bounds"
            )
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0.0):
            raise FitError(f"parameter {self.name!r}: the scale is {self.scale}, but must be a finite number above 0")

    @property
    def size(self) -> float:
        """The scale that the solvers use, in `unit`."""
        if self.scale is not None:
            return self.scale
        if math.isfinite(self.upper - self.lower):
            return 0.25 * (self.upper - self.lower)
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
    def seed(self) -> np.ndarray:
        """Seeds of the unknowns (p)."""
        return np.array([parameter.seed for parameter in self.free])

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds of the unknowns (p)."""
        return np.array([parameter.lower for parameter in self.free])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds of the unknowns (p)."""
        return np.array([parameter.upper for parameter in self.free])

    @property
    def scales(self) -> np.ndarray:
        """Scales of the unknowns (p)."""
        return np.array([parameter.size for parameter in self.free])

    def values(self, x: Sequence[float] | np.ndarray) -> dict[str, float]:
        """All values by name, the frozen ones included, for a vector of the unknowns."""
        free = dict(zip(self.names, (float(value) for value in x), strict=True))
        return {parameter.name: free.get(parameter.name, parameter.seed) for parameter in self.all}

    def starts(self, seeds: Iterable[Mapping[str, float]] = (), random: int = 0, entropy: int = 0) -> list[np.ndarray]:
        """Vectors to start from: the seeds of the parameters, further named ones, and random ones within the bounds.

        Args:
            seeds: values by name; a name that is missing keeps its own seed.
            random: number of random starts, uniform between the bounds (unbounded: seed +- 2 scales).
            entropy: of the random starts.

        Raises:
            FitError: a seed names no free parameter or lies outside the bounds.
        """
        vectors = [self.seed]
        for seed in seeds:
            unknown = sorted(set(seed) - set(self.names))
            if unknown:
                raise FitError(f"seed for {', '.join(unknown)}: the free parameters are {', '.join(self.names)}")
            vectors.append(np.array([replace(p, seed=seed.get(p.name, p.seed)).seed for p in self.free]))
        rng = np.random.default_rng(entropy)
        low = np.where(np.isfinite(self.lower), self.lower, self.seed - 2.0 * self.scales)
        high = np.where(np.isfinite(self.upper), self.upper, self.seed + 2.0 * self.scales)
        vectors += [rng.uniform(low, high) for _ in range(random)]
        return vectors

    def sides(self, x: np.ndarray) -> np.ndarray:
        """Which unknowns sit on a bound (p): -1 on the lower one, 1 on the upper one, else 0."""
        margin = 1e-6 * self.scales
        return np.where(x <= self.lower + margin, -1, np.where(x >= self.upper - margin, 1, 0))

    def active(self, x: np.ndarray) -> dict[str, str]:
        """Unknowns that sit on a bound, with `lower` or `upper`."""
        words = {-1: "lower", 1: "upper"}
        return {name: words[side] for name, side in zip(self.names, self.sides(x).tolist(), strict=True) if side}
