"""Goal tables of CFD runs on sail shapes: drag and lift coefficients, or forces from which they follow (eq. 5.1)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.sweep.study_engine import SweepError
from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.resources import model_path

GOAL_AREA = 5e-3
"""m2; area of the CFD goals, eq. 5.1."""
COLUMNS = {
    "shape": "name",
    "speed": "m/s",
    "angle": "degrees from broadside",
    "c_d": "drag coefficient",
    "c_l": "lift coefficient",
    "drag_force": "N",
    "lift_force": "N",
}
PAIRS = (("c_d", "drag_force"), ("c_l", "lift_force"))


def load_goals(path: Path) -> pd.DataFrame:
    """Reads a goal table: shape, speed (m/s), angle (degrees), and per row C_D and C_L, or drag and lift force (N).

    A force becomes a coefficient by C = 2 F / (rho A v^2) with A = 5e-3 m2 (eq. 5.1) and the air of
    `models/parameters`.
    Column names may be written in capitals and with units in brackets; `C_D` is `c_d`. Lift may be missing.

    Returns:
        Columns shape, speed, angle, c_d, c_l (NaN where there is none), sorted.

    Raises:
        SweepError: no such file, unknown or missing column, not a number, speed not above 0, a point named twice; names
            file, row and what is allowed.
    """
    try:
        raw = pd.read_csv(path, comment="#", dtype={0: str})
    except FileNotFoundError:
        raise SweepError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise SweepError(f"{path}: not a CSV table: {' '.join(str(error).split())}") from None
    raw.columns = pd.Index([str(name).split("[")[0].split("(")[0].strip().lower() for name in raw.columns])
    for name in raw.columns:
        if name not in COLUMNS:
            raise SweepError(f"{path}: column {name!r} is not known; {nearest(name, list(COLUMNS))}")
    for needed in ("shape", "speed", "angle"):
        if needed not in raw.columns:
            raise SweepError(f"{path}: column {needed!r} ({COLUMNS[needed]}) is missing")
    if not {"c_d", "drag_force"} & set(raw.columns):
        raise SweepError(f"{path}: neither c_d nor drag_force is there; one of them is needed")
    if raw.empty:
        raise SweepError(f"{path}: holds no rows")
    for name in raw.columns.drop("shape"):
        raw[name] = _numbers(path, name, raw[name])
    return _coefficients(path, raw)


def published_goals() -> pd.DataFrame:
    """Drag coefficients of the thesis' Table 2.1: one per shape, without speed, angle or lift.

    The text gives no names of the shapes: `2D 1` is the first of those with two dimensions.
    """
    rows = pd.read_csv(model_path("published/shape_drag.csv"))
    names = [f"{kind} {place}" for kind, place in zip(rows["dimensionality"], rows["row_in_table"], strict=True)]
    return pd.DataFrame({"shape": names, "speed": np.nan, "angle": 0.0, "c_d": rows["cd"], "c_l": np.nan})


def mean_drag(goals: pd.DataFrame) -> pd.Series:
    """Shape -> mean drag coefficient broadside (at the angle nearest to 0 of each shape), largest first."""
    means = {}
    for shape, rows in goals.groupby("shape", sort=False):
        least = rows["angle"].abs().min()
        means[str(shape)] = float(rows.loc[rows["angle"].abs() == least, "c_d"].mean())
    return pd.Series(means, name="c_d").sort_values(ascending=False, kind="stable")


def _numbers(path: Path, name: str, column: pd.Series) -> pd.Series:
    numbers = pd.to_numeric(column, errors="coerce").astype(float)
    bad = np.flatnonzero(~np.isfinite(numbers) & (column.notna() | (name in ("speed", "angle"))))
    if bad.size:
        raise SweepError(
            f"{path}: row {bad[0] + 1}: {name} {column.iloc[bad[0]]!r}; allowed: a number, {COLUMNS[name]}"
        )
    return numbers


def _coefficients(path: Path, raw: pd.DataFrame) -> pd.DataFrame:
    slow = np.flatnonzero(raw["speed"] <= 0.0)
    if slow.size:
        raise SweepError(f"{path}: row {slow[0] + 1}: speed {raw['speed'].iloc[slow[0]]:g} m/s; allowed: above 0")
    unnamed = np.flatnonzero(raw["shape"].isna())
    if unnamed.size:
        raise SweepError(f"{path}: row {unnamed[0] + 1}: shape is empty; allowed: a name")
    density = load_scenario("turn_swing").environment.air_density
    pressure_area = 0.5 * density * GOAL_AREA * raw["speed"] ** 2
    goals = raw[["shape", "speed", "angle"]].copy()
    for coefficient, force in PAIRS:
        given = raw.get(coefficient, pd.Series(np.nan, raw.index))
        goals[coefficient] = given.fillna(raw.get(force, pd.Series(np.nan, raw.index)) / pressure_area)
    empty = np.flatnonzero(goals["c_d"].isna())
    if empty.size:
        raise SweepError(f"{path}: row {empty[0] + 1}: has neither c_d nor drag_force")
    twice = goals.duplicated(["shape", "speed", "angle"])
    if twice.any():
        first = int(np.flatnonzero(twice)[0])
        row = goals.iloc[first]
        point = f"{row['shape']} at {row['speed']:g} m/s and {row['angle']:g} degrees"
        raise SweepError(f"{path}: row {first + 1}: {point} is there twice")
    return goals.sort_values(["shape", "angle", "speed"], kind="stable").reset_index(drop=True)
