"""One row per controller out of the tables of all runs: medians over the cars, and on how many it does better."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.leaderboard.contestants import THESIS, Contestant
from aerodima.optimisation.studies.leaderboard.leaderboard_runs import OUTCOMES, Leaderboard
from aerodima.optimisation.sweep.study_store import make_frame
from aerodima.optimisation.swing.full_car import LEAST_HEADING
from aerodima.workbench.config.ensemble import weighted_quantiles

ROUNDING = 1e-9
"""Of a gain."""


def summarise_board(board: Leaderboard) -> pd.DataFrame:
    """Medians and shares over the ensemble, or of the own car where no member was driven; one row per controller."""
    frictions, runs, speeds = (_weighted(table) for table in (board.frictions, board.runs, board.speeds))
    reference, best = (_values(frictions, contestant) for contestant in (_thesis(board), board.contestants[3]))
    rows = []
    for contestant in board.contestants:
        name = contestant.name
        own = frictions[frictions["controller"] == name]
        row: dict[str, Any] = {"controller": name, "cars": int(own["member"].nunique())}
        for speed, part in own.groupby("speed_m_per_s"):
            row[f"critical_friction_at_{speed:g}_m_per_s"] = _median(part["critical_friction"], part["weight"])
            there = runs[(runs["controller"] == name) & (runs["speed_m_per_s"] == speed)]
            row[f"rollover_probability_at_{speed:g}_m_per_s"] = _share(there["outcome"] == "flipped", there["weight"])
        turns = list(zip(own["member"], own["speed_m_per_s"], strict=True))
        values = own["critical_friction"].to_numpy(float)
        gain, over_best = (values / np.array([other[turn] for turn in turns]) - 1.0 for other in (reference, best))
        heading = own["heading_ratio"].to_numpy(float) >= LEAST_HEADING
        row["gain_over_8_rad_per_s"] = _median(gain, own["weight"])
        row["gain_over_best_fixed_speed"] = _median(over_best, own["weight"])
        row["share_no_worse_than_8_rad_per_s"] = _share(gain >= -ROUNDING, own["weight"])
        row["heading_ratio_median"] = _median(own["heading_ratio"], own["weight"])
        row["share_heading_at_least_95_percent"] = _share(heading, own["weight"])
        row["share_that_spins_with_8_rad_per_s"] = _share(own["spins_with_8_rad_per_s"], own["weight"])
        row["share_faster_turn"] = _share(heading & (gain > ROUNDING), own["weight"])
        top = speeds[speeds["controller"] == name]
        row["highest_speed_m_per_s"] = _median(top["highest_speed_m_per_s"], top["weight"])
        mine = runs[(runs["controller"] == name) & runs["clean"].fillna(False).astype(bool)]
        for column in OUTCOMES:
            row[f"median_{column}"] = _median(mine[column], mine["weight"]) if len(mine) else math.nan
        rows.append(row)
    return make_frame(rows)


def _thesis(board: Leaderboard) -> Contestant:
    return next(contestant for contestant in board.contestants if contestant.name == THESIS.name)


def _weighted(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the ensemble; those of the own car, alike in weight, where there are no others."""
    members = table[table["weight"] > 0.0]
    return members if len(members) else table.assign(weight=1.0)


def _values(frictions: pd.DataFrame, contestant: Contestant) -> dict[tuple[Any, Any], float]:
    own = frictions[frictions["controller"] == contestant.name]
    turns = zip(own["member"], own["speed_m_per_s"], strict=True)
    return dict(zip(turns, own["critical_friction"].to_numpy(float), strict=True))


def _median(values: Any, weights: Any) -> float:
    return float(weighted_quantiles(np.asarray(values, float), np.asarray(weights, float), [0.5])[0])


def _share(condition: Any, weights: Any) -> float:
    chosen, weight = np.asarray(condition, bool), np.asarray(weights, float)
    return float(weight[chosen].sum() / weight.sum()) if weight.sum() else math.nan
