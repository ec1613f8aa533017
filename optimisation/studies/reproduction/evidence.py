"""The runs behind the report: every member as the thesis ran its car."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.calibration.calibration_plan import load_plan
from aerodima.optimisation.calibration.calibration_runs import RunStore, Wanted, flips_in_the_turn, survives
from aerodima.optimisation.calibration.published_data import Datum, plan_data
from aerodima.optimisation.studies.reproduction.reproduction_rows import Basis
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_parameter_entries
from aerodima.workbench.metrics.published_figures import flip_bracket, published_figures

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
    say: Callable[[str], None],
    settings: tuple[str, ...] = (),
    more: Sequence[tuple[str, float]] = (),
) -> Evidence:
    """Runs every member at every speed that the report needs; what the store has is not run again.

    Args:
        members: to be run.
        fitted: names of what they were calibrated to.
        store: of the runs.
        engine: that makes them.
        say: told how far it is.
        settings: overrides that all runs share.
        more: (tail mode, speed) of runs that are wanted beside those of the claims.
    """
    held_speed = throttle_speed(NO_FLICK_THROTTLE)
    pairs = list(dict.fromkeys([*wanted_pairs(held_speed), *more]))
    wanted = [Wanted(m.values, mode, speed, settings=settings) for mode, speed in pairs for m in members]
    rows = store.run(wanted, engine, say)
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
        row.configuration: row.metrics.speed_m_per_s for row in published_figures() if row.platform == "physical"
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
