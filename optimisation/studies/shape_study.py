"""Goal tables of CFD runs on sail shapes: drag and lift coefficients, or forces from which they follow (eq. 5.1).

Sail shapes: their drag and lift from CFD goals, the tunnel's coefficients beside, and what each does for the car.

On the car a shape counts by its mean drag coefficient broadside, taken as the constant C_N of the normal-force law: the
sail swings broadside, and lift hardly acts there. Area, mass and length of the sail are the same for all.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.optimisation.studies.grip_study import Setup, friction_study, read_friction
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.study import Study
from aerodima.workbench.aero.coefficient_files import NormalLine, load_coefficients
from aerodima.workbench.aero.coefficient_functions import SpeedLine
from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError
from aerodima.workbench.figures.figure_style import BLACK, GREY, new_figure, styled
from aerodima.workbench.report.report_page import Plot
from aerodima.workbench.resources import published_table

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
    rows = published_table("shape_drag")
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


MOST_ON_THE_CAR = 8
"""Shapes, from the largest drag on, that are tried on the car."""


def shapes_study(
    goals: pd.DataFrame, settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None
) -> Study:
    """The car with each shape at every friction."""
    return friction_study("Shapes of the sail", _setups(goals), settings, ensemble, members)


def read_shapes(goals: pd.DataFrame, frame: pd.DataFrame) -> Findings:
    """Choice of the shape by drag, and the critical friction that it gives the car."""
    drag = mean_drag(goals)
    best, second = drag.index[0], (drag.index[1] if len(drag) > 1 else None)
    said = [
        f"The largest mean drag broadside has {best!r}: C_D {drag.iloc[0]:.3g}"
        + (f", then {second!r} with {drag.iloc[1]:.3g}." if second is not None else "."),
        f"Drag of the {min(len(drag), MOST_ON_THE_CAR)} best shapes is used as C_N on the car; the tunnel's robot tail "
        f"has {_tunnel_mean():.3g} on the average of its measured speeds.",
    ]
    if goals["c_l"].isna().all():
        said.append("The table has no lift coefficients, so none are compared.")
    if goals["speed"].isna().all():
        said.append("The table has one drag coefficient per shape without a speed (Table 2.1 of the thesis).")
    picture = Plot(
        _figure(goals, drag),
        "Drag (and lift where given) of each shape; grey: the robot tail in the tunnel, its line over the relative "
        "speed (tables of the thesis, ERRATA E26).",
        "Drag coefficient of each shape beside the tunnel's",
        "shapes",
    )
    return read_friction(frame, _setups(goals), said, (picture,))


def _setups(goals: pd.DataFrame) -> dict[str, Setup]:
    drag = mean_drag(goals)
    setups = {"tail held": Setup("turn_held", reference=True), "tunnel (C_N 2)": Setup("turn_swing", reference=True)}
    for shape, value in drag.head(MOST_ON_THE_CAR).items():
        setups[str(shape)[:40]] = Setup("turn_swing", (f"tail.normal_force_coefficient={float(value):.6g}",))
    return setups


def _tunnel_line() -> SpeedLine:
    coefficients = load_coefficients("robot_tail_line")
    assert isinstance(coefficients, NormalLine)
    return coefficients.line


def _tunnel_mean() -> float:
    line = _tunnel_line()
    return float(line(np.mean(line.speed_range)))


def _figure(goals: pd.DataFrame, drag: pd.Series) -> Figure:
    has_speed = goals["speed"].notna().all() and goals["speed"].nunique() > 1
    has_lift = bool(goals["c_l"].notna().any())
    with styled():
        if not has_speed:
            figure, axes = new_figure(7.2, 0.3 * len(drag) + 1.2)
            axes[0, 0].barh(range(len(drag)), drag.to_numpy(float), color=BLACK, alpha=0.6)
            axes[0, 0].set_yticks(range(len(drag)), list(drag.index))
            axes[0, 0].invert_yaxis()
            axes[0, 0].axvline(_tunnel_mean(), color=GREY, linestyle="--")
            axes[0, 0].set(xlabel="drag coefficient", title="Drag of the shapes")
            return figure
        figure, axes = new_figure(9.0, 3.8, 1, 2 if has_lift else 1)
        _curves(axes[0, 0], goals, drag, "c_d", "drag coefficient broadside")
        line = _tunnel_line()
        axes[0, 0].plot(
            line.speed_range,
            [line(speed) for speed in line.speed_range],
            color=GREY,
            linewidth=3,
            alpha=0.6,
            label="robot tail, tunnel",
        )
        if has_lift:
            _polar(axes[0, 1], goals, drag)
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right upper")
    return figure


def _curves(ax: Axes, goals: pd.DataFrame, drag: pd.Series, column: str, label: str) -> None:
    for place, shape in enumerate(drag.index):
        rows = goals[goals["shape"] == shape]
        rows = rows[rows["angle"].abs() == rows["angle"].abs().min()].sort_values("speed")
        ax.plot(rows["speed"], rows[column], marker="osv^<>dP"[place % 8], label=str(shape))
    ax.set(xlabel="speed, m/s", ylabel=label, title="Drag of the shapes")


def _polar(ax: Axes, goals: pd.DataFrame, drag: pd.Series) -> None:
    for place, shape in enumerate(drag.index):
        means = goals[goals["shape"] == shape].groupby("angle")[["c_l"]].mean()
        ax.plot(means.index, means["c_l"], marker="osv^<>dP"[place % 8])
    ax.set(xlabel="angle from broadside, degrees", ylabel="lift coefficient", title="Lift, mean over the speeds")
