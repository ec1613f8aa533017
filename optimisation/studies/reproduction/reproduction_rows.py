"""A row of the reproduction report, and the rules by which it gets its verdict.

- reproduced: the published figure lies in the band of the ensemble, and the band is at most half as wide as the figure
  is large (a wider one excludes too little); or the median is within 10 % of it.
- direction only: a published change has the same sign in at least 90 % of the weight, but its size is not met.
- not reproduced: neither, or less than 90 % of the weight survives the run that the published car survived.
- not computable: something is missing, and the row says what; also an input of the run, which no run can predict.

Beside the verdict stands what agreement is worth: a prediction is evidence, what the ensemble was calibrated to (or
what follows from it) is none, and arithmetic on printed numbers says nothing about the car.
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from aerodima.workbench.config.ensemble import weighted_quantiles

Verdict = Literal["reproduced", "direction only", "not reproduced", "not computable"]

Basis = Literal["prediction", "calibrated to", "printed numbers", ""]

LEVELS = (0.05, 0.5, 0.95)
WIDEST = 0.5
CLOSE = 0.1
SURE = 0.9
"""Quantiles of a band; the widest band (share of the published figure) that may count as reproduced; how close its
median must be; the weight of the ensemble that a verdict needs."""
ROUNDING = 1e-9
"""Of a sum of weights."""


@dataclass(frozen=True)
class Row:
    """One claim.

    Attributes:
        place: table, figure or section.
        claim: in words.
        unit: of the numbers.
        published: as printed; empty when there is no number.
        ours: median of the ensemble, or the recomputed number.
        low, high: band that holds 90 % of the weight; None for what needs no car.
        verdict: by the rules of this module.
        evidence: what the verdict rests on, or what is missing.
        basis: what agreement is worth; empty for what is not computable.
    """

    place: str
    claim: str
    unit: str
    published: float | None
    ours: float | None
    low: float | None
    high: float | None
    verdict: Verdict
    evidence: str
    basis: Basis = "prediction"

    def as_row(self) -> dict[str, Any]:
        """For the CSV."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def figure_row(
    place: str,
    claim: str,
    unit: str,
    published: float,
    values: NDArray,
    weights: NDArray,
    evidence: str,
    basis: Basis = "prediction",
) -> Row:
    """A published number of a run that survived, beside the ensemble's; NaN for members that did not survive it."""
    low, median, high = (float(value) for value in weighted_quantiles(values, weights, LEVELS))
    if not np.isfinite(median):
        return Row(place, claim, unit, published, None, None, None, "not reproduced", f"{evidence}; no number", basis)
    inside = low <= published <= high and high - low <= WIDEST * abs(published)
    close = abs(median - published) <= CLOSE * abs(published)
    enough = _share(np.isfinite(values), weights) >= SURE
    verdict: Verdict = "reproduced" if enough and (inside or close) else "not reproduced"
    return Row(place, claim, unit, published, median, low, high, verdict, evidence, basis)


def change_row(place: str, claim: str, published: float, values: NDArray, weights: NDArray, evidence: str) -> Row:
    """A published change (%) beside the ensemble's: its size, or at least its sign; NaN as in `figure_row`."""
    found = figure_row(place, claim, "%", published, values, weights, evidence)
    same = _share(np.sign(values) == np.sign(published), weights)
    return replace(found, verdict="direction only") if found.verdict == "not reproduced" and same >= SURE else found


def share_row(place: str, claim: str, share: float, evidence: str, basis: Basis = "prediction") -> Row:
    """A claim that a run either shows or not: reproduced when at least 90 % of the weight shows it."""
    verdict: Verdict = "reproduced" if share >= SURE - ROUNDING else "not reproduced"
    return Row(place, claim, "% of weight", None, 100.0 * share, None, None, verdict, evidence, basis)


def recomputed_row(
    place: str, claim: str, unit: str, published: float, ours: float, agrees: bool, evidence: str
) -> Row:
    """A number that follows from other published ones."""
    verdict: Verdict = "reproduced" if agrees else "not reproduced"
    return Row(place, claim, unit, published, ours, None, None, verdict, evidence, "printed numbers")


def missing_row(place: str, claim: str, missing: str) -> Row:
    """A claim that cannot be computed, and what is missing."""
    return Row(place, claim, "", None, None, None, None, "not computable", missing, "")


def _share(shown: NDArray, weights: NDArray) -> float:
    return float(weights[shown].sum() / weights.sum()) + ROUNDING
