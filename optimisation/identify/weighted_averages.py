"""From several fits of the same thing to one number: the thesis' weighted average, and robust ones beside it.

eps_i = sum(res) / res_i, w_i = eps_i / sum(eps), value = sum(w_i value_i) (thesis eqs. 4.29-4.31).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.fit.least_squares import LIMIT, spread
from aerodima.optimisation.identify.published_tables import Flag, published
from aerodima.workbench.errors import FitError
from aerodima.workbench.resources import model_path

PERCENTILES = (10.0, 90.0)
"""Shown beside every average, percent."""


@dataclass(frozen=True)
class Aggregate:
    """One quantity over several fits.

    Attributes:
        weighted: resnorm-weighted average (eqs. 4.29-4.31).
        mean, median: of the values.
        huber: the value with the least Huber loss, scale from the median deviation.
        low, high: 10th and 90th percentile.
        samples: number of values.
    """

    weighted: float
    mean: float
    median: float
    huber: float
    low: float
    high: float
    samples: int

    def columns(self) -> dict[str, float | int]:
        """All of them by name, the percentiles as `p10` and `p90`."""
        found = asdict(self)
        low, high = (f"p{p:g}" for p in PERCENTILES)
        return {low if key == "low" else high if key == "high" else key: value for key, value in found.items()}


def weights(resnorms: np.ndarray) -> np.ndarray:
    """w_i of eqs. 4.29 and 4.30.

    Raises:
        FitError: a resnorm that is not above zero; its weight would be infinite.
    """
    res = np.asarray(resnorms, float)
    bad = np.flatnonzero(~(np.isfinite(res) & (res > 0.0)))
    if bad.size:
        raise FitError(f"weighted average: resnorm {res[bad[0]]} in row {bad[0]}, but it must be above 0")
    eps = np.sum(res) / res
    return eps / np.sum(eps)


def aggregate(values: np.ndarray, resnorms: np.ndarray) -> Aggregate:
    """All averages of some values (n) with their resnorms (n)."""
    x = np.asarray(values, float)
    if not (len(x) and np.all(np.isfinite(x))):
        raise FitError("weighted average: there are no values, or one is not finite")
    low, high = np.percentile(x, PERCENTILES)
    return Aggregate(
        weighted=float(weights(resnorms) @ x),
        mean=float(np.mean(x)),
        median=float(np.median(x)),
        huber=huber_location(x),
        low=float(low),
        high=float(high),
        samples=len(x),
    )


def averages_table(results: Sequence[FitResult], keys: Sequence[str] = ()) -> pd.DataFrame:
    """All averages of every determined parameter over several fits; the start of a swing is none.

    Args:
        keys: facts that tell the groups apart, such as tail and wind speed.

    Returns:
        A row per group and parameter: the keys, parameter, unit, and the columns of its `Aggregate`.
    """
    groups: dict[tuple[Any, ...], list[FitResult]] = {}
    for result in results:
        groups.setdefault(tuple(result.facts[key] for key in keys), []).append(result)
    rows = []
    for place, group in sorted(groups.items()):
        units = {e.name: e.unit for result in group for e in result.free if not e.name.startswith("start_")}
        for name, unit in units.items():
            found = [result for result in group for e in result.free if e.name == name and e.identifiable]
            if found:
                values = np.array([result[name].value for result in found])
                averages = aggregate(values, np.array([result.resnorm for result in found])).columns()
                rows.append({**dict(zip(keys, place, strict=True)), "parameter": name, "unit": unit, **averages})
    return pd.DataFrame(rows)


def huber_location(values: np.ndarray) -> float:
    """The value with the least Huber loss; its scale is 1.4826 times the median deviation from the median.

    The zero of a sum that falls with the location, so it is found however near to each other the values lie.
    """
    scale = spread(values)
    if scale == 0.0:
        return float(np.median(values))
    from scipy.optimize import brentq

    low, high = float(np.min(values)), float(np.max(values))
    return float(
        brentq(lambda x: float(np.sum(np.clip((values - x) / scale, -LIMIT, LIMIT))), low, high, xtol=1e-9 * scale)
    )


def recompute_averages() -> tuple[pd.DataFrame, list[Flag]]:
    """Every weighted average of Tables 4.7, 6.2, 11.1 and 11.2 recomputed beside the printed one.

    Returns:
        A row per average (table, quantity, published, the `columns` of its `Aggregate`, agrees), and a flag
        for each that differs by more than half a unit of its last printed digit.
    """
    rows = [_compare(*entry) for entry in [*_friction_entries(), *_added_mass_entries()]]
    flags = [
        Flag(
            row["table"],
            row["quantity"],
            f"published {row['published']:g}, recomputed {row['weighted']:.4g}" + _copied_from(row, rows),
            "E23",
        )
        for row in rows
        if not row["agrees"]
    ]
    return pd.DataFrame(rows), flags


def _copied_from(row: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """Names the cell of the same table whose right average is printed here, when the difference is not a rounding."""
    if abs(row["published"] - row["weighted"]) < 0.05 * abs(row["weighted"]):
        return " (last digit)"
    for other in rows:
        if other is not row and other["table"] == row["table"] and other["published"] == row["published"]:
            return f"; it is the value of {other['quantity'].removeprefix('added_mass_kg ')}"
    return ""


def _friction_entries() -> list[tuple[str, str, str, np.ndarray, np.ndarray]]:
    entries = []
    for name in ("bar_friction", "robot_tail_friction"):
        table = published(name)
        printed = pd.read_csv(model_path(f"published/{name}.csv"), dtype=str)
        swings = table[table.record == "swing"]
        final = printed[printed.record.str.startswith("published_")].iloc[0]
        for column in ("coulomb_friction_n_m", "viscous_friction_n_m_s_per_rad"):
            source = str(swings.source_table.iloc[0])
            entries.append((source, column, final[column], swings[column].to_numpy(), swings.resnorm.to_numpy()))
    return entries


def _added_mass_entries() -> list[tuple[str, str, str, np.ndarray, np.ndarray]]:
    table = published("added_mass")
    printed = pd.read_csv(model_path("published/added_mass.csv"), dtype=str).published_weighted_average_kg
    entries = []
    for (source, tail, axis, speed), group in table.groupby(
        ["source_table", "tail", "axis", "wind_speed_m_per_s"], sort=False
    ):
        label = f"added_mass_kg tail {tail} {axis} {speed:g} m/s"
        text = printed[group.index[0]]
        entries.append((str(source), label, text, group.added_mass_kg.to_numpy(), group.resnorm.to_numpy()))
    return entries


def _compare(table: str, quantity: str, printed: str, values: np.ndarray, resnorms: np.ndarray) -> dict[str, Any]:
    found = aggregate(values, resnorms)
    digits = len(printed.partition(".")[2])
    half = 0.5 * 10.0**-digits
    return {
        "table": table,
        "quantity": quantity,
        "published": float(printed),
        **found.columns(),
        "agrees": math.isclose(float(printed), found.weighted, abs_tol=half * (1.0 + 1e-9), rel_tol=0.0),
    }
