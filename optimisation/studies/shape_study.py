"""Sail shapes: their drag and lift from CFD goals, the tunnel's coefficients beside, and what each does for the car.

On the car a shape counts by its mean drag coefficient broadside, taken as the constant C_N of the normal-force law: the
sail swings broadside, and lift hardly acts there. Area, mass and length of the sail are the same for all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.optimisation.studies.grip_study import Setup, friction_study, read_friction
from aerodima.optimisation.studies.shape_goals import mean_drag
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.study import Study
from aerodima.workbench.aero.coefficient_files import NormalLine, load_coefficients
from aerodima.workbench.aero.coefficient_functions import SpeedLine
from aerodima.workbench.figures.figure_style import BLACK, GREY, new_figure, styled
from aerodima.workbench.report.report_page import Plot

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
