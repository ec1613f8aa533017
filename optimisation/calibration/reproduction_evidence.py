"""The runs behind the reproduction report, and the rules by which a row of it gets its verdict.

Every member of the ensemble is run as the thesis ran its car.

- reproduced: the published figure lies in the band of the ensemble, and the band is at most half as wide as the figure
  is large (a wider one excludes too little); or the median is within 10 % of it.
- direction only: a published change has the same sign in at least 90 % of the weight, but its size is not met.
- not reproduced: neither, or less than 90 % of the weight survives the run that the published car survived.
- not computable: something is missing, and the row says what; also an input of the run, which no run can predict.

Beside the verdict stands what agreement is worth: a prediction is evidence, what the ensemble was calibrated to (or
what follows from it) is none, and arithmetic on printed numbers says nothing about the car.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.calibration.calibration_plan import load_plan
from aerodima.optimisation.calibration.calibration_runs import (
    Datum,
    RunStore,
    Wanted,
    flips_in_the_turn,
    plan_data,
    survives,
)
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine
from aerodima.workbench.config.ensemble import Member, weighted_quantiles
from aerodima.workbench.config.scenario import load_parameter_entries
from aerodima.workbench.metrics.published_values import flip_bracket, published_values
from aerodima.workbench.metrics.run_summary import MODE_WORDS
from aerodima.workbench.report.report_page import Finding, Part, Section, Table

Verdict = Literal["reproduced", "direction only", "not reproduced", "not computable"]

Basis = Literal["prediction", "calibrated to", "printed numbers", ""]

WIDEST = 0.5
CLOSE = 0.1
SURE = 0.9
"""The widest band (share of the published figure) that may count as reproduced; how close its
median must be; the weight of the ensemble that a verdict needs."""
ROUNDING = 1e-9
"""Of a sum of weights."""


@dataclass(frozen=True)
class ClaimRow:
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
) -> ClaimRow:
    """A published number of a run that survived, beside the ensemble's; NaN for members that did not survive it."""
    low, median, high = (float(value) for value in weighted_quantiles(values, weights))
    if not np.isfinite(median):
        return ClaimRow(
            place, claim, unit, published, None, None, None, "not reproduced", f"{evidence}; no number", basis
        )
    inside = low <= published <= high and high - low <= WIDEST * abs(published)
    close = abs(median - published) <= CLOSE * abs(published)
    enough = _share(np.isfinite(values), weights) >= SURE
    verdict: Verdict = "reproduced" if enough and (inside or close) else "not reproduced"
    return ClaimRow(place, claim, unit, published, median, low, high, verdict, evidence, basis)


def change_row(place: str, claim: str, published: float, values: NDArray, weights: NDArray, evidence: str) -> ClaimRow:
    """A published change (%) beside the ensemble's: its size, or at least its sign; NaN as in `figure_row`."""
    found = figure_row(place, claim, "%", published, values, weights, evidence)
    same = _share(np.sign(values) == np.sign(published), weights)
    return replace(found, verdict="direction only") if found.verdict == "not reproduced" and same >= SURE else found


def share_row(place: str, claim: str, share: float, evidence: str, basis: Basis = "prediction") -> ClaimRow:
    """A claim that a run either shows or not: reproduced when at least 90 % of the weight shows it."""
    verdict: Verdict = "reproduced" if share >= SURE - ROUNDING else "not reproduced"
    return ClaimRow(place, claim, "% of weight", None, 100.0 * share, None, None, verdict, evidence, basis)


def recomputed_row(
    place: str, claim: str, unit: str, published: float, ours: float, agrees: bool, evidence: str
) -> ClaimRow:
    """A number that follows from other published ones."""
    verdict: Verdict = "reproduced" if agrees else "not reproduced"
    return ClaimRow(place, claim, unit, published, ours, None, None, verdict, evidence, "printed numbers")


def missing_row(place: str, claim: str, missing: str) -> ClaimRow:
    """A claim that cannot be computed, and what is missing."""
    return ClaimRow(place, claim, "", None, None, None, None, "not computable", missing, "")


def _share(shown: NDArray, weights: NDArray) -> float:
    return float(weights[shown].sum() / weights.sum()) + ROUNDING


NO_FLICK_THROTTLE = 0.55
"""Throttle of the run of thesis section 7.2.2 in which the tail did not swing (models/published/constants.csv)."""


@dataclass(frozen=True)
class Evidence:
    """Rows of runs by (tail mode, commanded speed), one per member.

    Attributes:
        members: of the ensemble that were run.
        rows: tables of runs.
        held_speed: speed (m/s) of 55 % throttle by the assumed throttle line.
        settings: overrides that all runs share.
        fitted: names of what the members were calibrated to, as their file has them.
        data: published figures, with what agreement with each is worth.
    """

    members: tuple[Member, ...]
    rows: dict[tuple[str, float], pd.DataFrame]
    held_speed: float
    settings: tuple[str, ...]
    fitted: frozenset[str]
    data: tuple[Datum, ...]

    def datum(self, source: str, metric: str) -> Datum:
        """One published figure."""
        return next(datum for datum in self.data if (datum.source, datum.metric) == (source, metric))

    def basis_of_outcome(self, name: str) -> Basis:
        """What agreement with an outcome is worth."""
        return "calibrated to" if name in self.fitted else "prediction"

    @property
    def weights(self) -> NDArray[np.float64]:
        """Of the members (m)."""
        return np.array([member.weight for member in self.members])

    def column(self, mode: str, speed: float, name: str) -> NDArray[np.float64]:
        """One number of the runs of all members (m); NaN where a run has none, or the car did not survive it."""
        rows = self.rows[mode, speed]
        values = rows[name].to_numpy(float) if name in rows else np.full(len(rows), np.nan)
        return np.where(survives(rows), values, np.nan)

    def survived(self, mode: str, speed: float) -> float:
        """Share of the weight that survived these runs."""
        return float(self.weights @ survives(self.rows[mode, speed]))

    def tipped(self, mode: str, speed: float) -> float:
        """Share of the weight that tipped over before its turn: these runs say nothing about the turn."""
        rows = self.rows[mode, speed]
        return float(self.weights @ (~survives(rows) & ~flips_in_the_turn(rows)))

    def flipped(self, mode: str, speed: float) -> float:
        """Share of the weight that flipped in the turn."""
        return float(self.weights @ flips_in_the_turn(self.rows[mode, speed]))


def basis_of(datum: Datum) -> Basis:
    """What agreement with a figure is worth: what is fitted, or follows from it, is no evidence."""
    return "calibrated to" if datum.use in ("fitted", "follows") else "prediction"


def gather(
    members: Sequence[Member],
    fitted: Collection[str],
    store: RunStore,
    engine: Engine,
    progress: ProgressLine,
    settings: tuple[str, ...] = (),
    more: Sequence[tuple[str, float]] = (),
) -> Evidence:
    """Runs every member at every speed that the report needs; what the store has is not run again.

    Args:
        members: to be run.
        fitted: names of what they were calibrated to.
        store: of the runs.
        engine: that makes them.
        progress: takes lines of text.
        settings: overrides that all runs share.
        more: (tail mode, speed) of runs that are wanted beside those of the claims.
    """
    held_speed = throttle_speed(NO_FLICK_THROTTLE)
    pairs = list(dict.fromkeys([*wanted_pairs(held_speed), *more]))
    wanted = [Wanted(m.values, mode, speed, settings=settings) for mode, speed in pairs for m in members]
    rows = store.run(wanted, engine, progress)
    count = len(members)
    tables = {
        pair: rows[place * count : (place + 1) * count].reset_index(drop=True) for place, pair in enumerate(pairs)
    }
    data = plan_data(load_plan(), fitted)
    return Evidence(tuple(members), tables, held_speed, settings, frozenset(fitted), data)


def wanted_pairs(held_speed: float) -> list[tuple[str, float]]:
    """(tail mode, speed) of the runs: both brackets, the physical rows, and the held tail beside the swung one."""
    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    physical = {
        row.configuration: row.metrics.speed_m_per_s for row in published_values() if row.platform == "physical"
    }
    return [
        *(("none", speed) for speed in (none.survived, none.flipped, physical["tailless"])),
        *(("swing", speed) for speed in (swing.survived, swing.flipped, physical["tailed"])),
        *(("held", speed) for speed in (swing.survived, physical["tailed"], held_speed)),
    ]


def throttle_speed(throttle: float) -> float:
    """Steady speed (m/s) of a throttle (0 to 1) by the assumed line of the parameters: Fig. 6.8 is not in the text."""
    entries: dict[str, Any] = {key: entry.value for key, entry in load_parameter_entries("drive").items()}
    return float(entries["throttle_gain"]) * throttle + float(entries["throttle_offset"])


MODES = ("none", "held", "swing")
SPEEDS = (3.33, 3.61, 4.0, 4.44, 4.72, 5.28, 6.1)
"""m/s: both published brackets, steps between and beyond, and the fastest run of the real car."""
PAIRS = tuple(product(MODES, SPEEDS))


def survival_table(evidence: Evidence) -> pd.DataFrame:
    """One row per tail mode and speed: shares of the weight, and how many members tipped over before their turn."""
    weights = evidence.weights
    found = []
    for mode, speed in PAIRS:
        rows = evidence.rows[mode, speed]
        tipped = ~survives(rows) & ~flips_in_the_turn(rows)
        found.append(
            {
                "tail": mode,
                "speed_m_per_s": speed,
                "members": len(rows),
                "survived": evidence.survived(mode, speed),
                "clean": float(weights @ np.asarray(rows["clean"] == True, bool)),  # noqa: E712  # None where it failed
                "flipped_in_turn": evidence.flipped(mode, speed),
                "tipped_before_turn": evidence.tipped(mode, speed),
                "members_tipped_before_turn": int(np.count_nonzero(tipped)),
            }
        )
    return pd.DataFrame(found)


def survival_section(found: pd.DataFrame) -> Section:
    """The table as a part of the page: survived share, clean share in brackets."""
    said = [f"{row['survived']:.0%} ({row['clean']:.0%})" for row in found.to_dict("records")]
    cells = [
        (MODE_WORDS[mode], *said[place * len(SPEEDS) : (place + 1) * len(SPEEDS)]) for place, mode in enumerate(MODES)
    ]
    worst = int(found["members_tipped_before_turn"].max())
    parts: list[Part] = [
        Finding([f"At most {worst} of {found['members'].max()} members tip over before their turn."]),
        Table(("", *(f"{speed:g} m/s" for speed in SPEEDS)), cells),
        "Share of the weight that survives; in brackets, with nothing but wheels on the ground.",
    ]
    return Section("Survival over speed", parts)
