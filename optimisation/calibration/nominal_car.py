"""Where the car of `models/parameters` lies among the cars of a calibration, evaluated as a member would be."""

from dataclasses import dataclass

import numpy as np

from aerodima.optimisation.calibration.bracket_design import Runner
from aerodima.optimisation.calibration.calibration import Calibration, log_posterior
from aerodima.optimisation.calibration.car_prior import Prior
from aerodima.workbench.config.array_types import FloatArray


@dataclass(frozen=True)
class Shipped:
    """The shipped car with its tail.

    Attributes:
        values: of its parameters (n), in the order of the keys of car and tail.
        z: (value - mean of the ensemble) / standard deviation of the ensemble (n).
        relative_density: posterior density over that of the best member; 0 when it misses the tailless bracket.
    """

    values: FloatArray
    z: FloatArray
    relative_density: float


def shipped_car(result: Calibration, runner: Runner) -> Shipped:
    """Runs the shipped car as each member was run and compares it with the ensemble."""
    prior, weights = result.draw.prior, result.draw.weights
    members = prior.values(result.draw.coordinates)
    mean = weights @ members
    deviation = np.sqrt(weights @ (members - mean) ** 2)
    own = _values(prior)
    cars = np.vstack([prior.coordinates(own[None])[0], result.draw.coordinates[result.best]])
    shipped, best = log_posterior(result.draw, cars, runner)
    return Shipped(own, (own - mean) / deviation, float(np.exp(shipped - best)))


def _values(prior: Prior) -> FloatArray:
    sections = (key.split(".") for key in prior.keys)
    return np.array([float(getattr(getattr(prior.base, section), name)) for section, name in sections])
