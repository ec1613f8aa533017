"""Draws the sign picture of `workbench/aero/README.md` with forces that the laws themselves return.

`python docs/sign_picture.py` writes it again.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.section_laws import NormalForceLaw
from aerodima.workbench.aero.sections import SectionLayout

PICTURE = Path(__file__).resolve().parent.parent / "workbench" / "aero" / "signs.png"
_TAIL: dict[str, Any] = {"color": "0.25", "linewidth": 6.0, "solid_capstyle": "round"}


def _arrow(
    axes: Axes, start: tuple[float, float], step: tuple[float, float], colour: str, label: str = ""
) -> None:
    end = (start[0] + step[0], start[1] + step[1])
    axes.annotate(
        "",
        end,
        start,
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": 2.0,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )
    if label:
        size = math.hypot(*step) or 1.0
        if abs(step[0]) < 0.8 * size:
            side = "center"
        elif step[0] > 0.0:
            side = "left"
        else:
            side = "right"
        x = end[0] + 0.05 * step[0] / size
        y = end[1] + 0.06 * step[1] / size
        axes.text(x, y, label, color=colour, ha=side, va="center")


def _prepare(axes: Axes, title: str, horizontal: str, vertical: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set(xlabel=horizontal, ylabel=vertical, aspect="equal", xticks=[], yticks=[])


def _polar(axes: Axes) -> None:
    """Rig seen along the motor axis: horizontal is -y (downstream), vertical z."""
    angle = math.radians(30.0)
    sine = math.sin(angle)
    cosine = math.cos(angle)
    a = (0.0, -sine, -cosine)
    _prepare(
        axes,
        "polar law: hanging tail, swung downstream\n(rig angle +30°, γ = +30°)",
        "−y, downstream →",
        "z, up →",
    )
    axes.plot([0, sine], [0, -cosine], **_TAIL)
    axes.plot([0], [0], "o", color="0.25", markersize=12)
    axes.text(-0.05, 0.06, "root", ha="right")
    axes.text(sine + 0.08, -cosine + 0.02, "tip")
    middle = (0.62 * sine, -0.62 * cosine)
    _arrow(axes, (-0.75, -0.15), (0.28, 0.0), "tab:blue", "v_rel")
    for height in (-0.4, -0.65, -0.9):
        _arrow(axes, (-0.75, height), (0.28, 0.0), "tab:blue", "")
    _arrow(
        axes,
        (0.85 * sine, -0.85 * cosine),
        (0.3 * -a[1], 0.24 * a[2]),
        "0.25",
        "a",
    )
    for law, colour, label in (
        (PolarLaw(1.0, 0.0), "tab:red", "drag d"),
        (PolarLaw(0.0, 1.0), "tab:green", "lift l"),
    ):
        force = law.section_force((0.0, -10.0, 0.0), a, (1.0, 0.0, 0.0), 0.0065, 1.225)
        _arrow(axes, middle, (-force[1], force[2]), colour, label)
    normal = (cosine, sine)
    axes.plot(
        [middle[0], middle[0] - 0.42 * normal[0]],
        [middle[1], middle[1] - 0.42 * normal[1]],
        "k:",
        linewidth=1,
    )
    axes.plot([middle[0], middle[0] - 0.42], [middle[1], middle[1]], "k:", linewidth=1)
    arc = np.radians(np.linspace(180.0, 210.0, 20))
    axes.plot(middle[0] + 0.32 * np.cos(arc), middle[1] + 0.32 * np.sin(arc), "k", linewidth=1)
    axes.text(middle[0] - 0.40, middle[1] - 0.12, "γ")
    axes.set(xlim=(-0.85, 1.1), ylim=(-1.25, 0.25))


def _robot_tail(axes: Axes) -> None:
    """Vehicle seen from behind: horizontal is -y (right), vertical z."""
    angle = math.radians(35.0)
    sine = math.sin(angle)
    cosine = math.cos(angle)
    rate = 8.0
    layout = SectionLayout.strip(start=0.3, length=0.65, width=0.2, normal_B=(0.0, 1.0, 0.0))
    _prepare(
        axes,
        "normal-force law: robot tail from behind\n(roll +35°, rolling to the right)",
        "−y, right →",
        "z, up →",
    )
    a = (0.0, -sine, cosine)
    n = (0.0, cosine, sine)
    axes.plot([0, sine], [0, cosine], **_TAIL)
    axes.add_patch(_rectangle((-0.3, -0.22), 0.6, 0.2))
    axes.text(0.0, -0.12, "car", ha="center", va="center")
    for s in layout.distances:
        start = (s * sine, s * cosine)
        outermost = s == layout.distances[-1]
        v = (0.0, -rate * s * cosine, -rate * s * sine)
        _arrow(
            axes,
            start,
            (-0.045 * v[1], 0.045 * v[2]),
            "tab:purple",
            "v_section" if outermost else "",
        )
        force = NormalForceLaw(2.0).section_force((0.0, -v[1], -v[2]), a, n, 0.026, 1.225)
        _arrow(
            axes,
            start,
            (-0.26 * force[1], 0.26 * force[2]),
            "tab:red",
            "F" if outermost else "",
        )
    _arrow(axes, (0.06, 0.1), (-0.22 * n[1], 0.22 * n[2]), "0.4", "n")
    _arrow(axes, (sine, cosine), (-0.2 * a[1], 0.2 * a[2]), "0.25", "a")
    axes.set(xlim=(-0.75, 1.2), ylim=(-0.3, 1.15))


def _vane(axes: Axes) -> None:
    """Sail seen from the tip down the tail axis: horizontal is -y, vertical x."""
    angle = math.radians(25.0)
    sine = math.sin(angle)
    cosine = math.cos(angle)
    e = 0.35
    _prepare(
        axes,
        "free sail from the tip: centre of pressure\nbehind the axis turns it into the wind",
        "−y →",
        "x →",
    )
    x_s = np.array([cosine, sine])
    n = np.array([-sine, cosine])

    def picture(point: np.ndarray) -> tuple[float, float]:
        return (-float(point[1]), float(point[0]))

    ends = [picture(0.35 * x_s), picture(-0.75 * x_s)]
    axes.plot([p[0] for p in ends], [p[1] for p in ends], **_TAIL)
    axes.plot([0], [0], "o", color="w", markeredgecolor="k", markersize=11)
    axes.text(-0.08, 0.08, "tail axis (a towards you)", ha="right", fontsize=8)
    for shift in (-0.75, -0.5, 0.55):
        _arrow(axes, (shift, 0.75), (0.0, -0.3), "tab:blue", "v_rel" if shift == -0.5 else "")
    cop = -e * x_s
    force = NormalForceLaw(2.0).section_force(
        (-6.0, 0.0, 0.0), (0.0, 0.0, 1.0), (n[0], n[1], 0.0), 0.022, 1.225
    )
    _arrow(axes, picture(cop), picture(np.array(force[:2])), "tab:red", "F")
    _arrow(axes, picture(-0.6 * x_s), picture(0.22 * n), "0.4", "n")
    axes.plot(*picture(cop), "o", color="tab:red")
    axes.text(
        picture(cop)[0] + 0.06,
        picture(cop)[1] + 0.03,
        "centre of\npressure",
        fontsize=8,
        color="tab:red",
    )
    axes.set(xlim=(-1.0, 1.0), ylim=(-0.85, 0.85))


def _rectangle(corner: tuple[float, float], width: float, height: float) -> Rectangle:
    return Rectangle(corner, width, height, facecolor="0.85", edgecolor="0.3")


def draw() -> Figure:
    """The three panels."""
    figure = Figure(figsize=(13.0, 4.9), layout="constrained")
    for axes, panel in zip(figure.subplots(1, 3), (_polar, _robot_tail, _vane), strict=True):
        panel(axes)
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=110, metadata={"Software": None})
    print(PICTURE)
