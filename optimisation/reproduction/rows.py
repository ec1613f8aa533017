"""A row of the reproduction report, and the rules by which it gets its verdict.

- reproduced: the published figure lies in the band of the ensemble, and the band is at most half as wide as the figure
  is large (a wider one excludes too little); or the median is within 10 % of it.
- direction only: a published change has the same sign in at least 90 % of the weight, but its size is not met.
- not reproduced: neither.
- not computable: something is missing, and the row says what.
"""

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workbench.ensemble import weighted_quantiles

Verdict = Literal["reproduced", "direction only", "not reproduced", "not computable"]

LEVELS = (0.05, 0.5, 0.95)
WIDEST = 0.5
CLOSE = 0.1
SURE = 0.9
"""Quantiles of a band; the widest band (share of the published figure) that may count as reproduced; how close its
median must be; the weight of the ensemble that a verdict needs."""


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

    def as_row(self) -> dict[str, Any]:
        """For the CSV."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def figure_row(
    place: str, claim: str, unit: str, published: float, values: NDArray, weights: NDArray, evidence: str
) -> Row:
    """A published number beside the ensemble's; members without the number (NaN) lose their weight."""
    low, median, high = (float(value) for value in weighted_quantiles(values, weights, LEVELS))
    if not np.isfinite(median):
        return Row(place, claim, unit, published, None, None, None, "not computable", "no member has this number")
    inside = low <= published <= high and high - low <= WIDEST * abs(published)
    close = abs(median - published) <= CLOSE * abs(published)
    verdict: Verdict = "reproduced" if inside or close else "not reproduced"
    return Row(place, claim, unit, published, median, low, high, verdict, evidence)


def change_row(place: str, claim: str, published: float, values: NDArray, weights: NDArray, evidence: str) -> Row:
    """A published change (%) beside the ensemble's: its size, or at least its sign."""
    found = figure_row(place, claim, "%", published, values, weights, evidence)
    if found.verdict != "not reproduced":
        return found
    finite = np.isfinite(values)
    same = float(weights[finite & (np.sign(values) == np.sign(published))].sum() / weights[finite].sum())
    if same >= SURE:
        return Row(place, claim, "%", published, found.ours, found.low, found.high, "direction only", evidence)
    return found


def share_row(place: str, claim: str, share: float, evidence: str) -> Row:
    """A claim that a run either shows or not: reproduced when at least 90 % of the weight shows it."""
    verdict: Verdict = "reproduced" if share >= SURE else "not reproduced"
    return Row(place, claim, "% of weight", None, 100.0 * share, None, None, verdict, evidence)


def recomputed_row(
    place: str, claim: str, unit: str, published: float, ours: float, agrees: bool, evidence: str
) -> Row:
    """A number that follows from other published ones."""
    return Row(place, claim, unit, published, ours, None, None, "reproduced" if agrees else "not reproduced", evidence)


def missing_row(place: str, claim: str, missing: str) -> Row:
    """A claim that cannot be computed, and what is missing."""
    return Row(place, claim, "", None, None, None, None, "not computable", missing)
