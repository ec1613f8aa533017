"""Figures of co-design: worth over mass, what the place of the joints does, and what the course depends on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.codesign import Design
from aerodima.workbench.figures.figure_style import BLUE, GREY, ORANGE, VERMILION, new_figure, styled
from aerodima.workbench.plants.tail_geometry import TailGeometry


def pareto(table: pd.DataFrame) -> pd.DataFrame:
    """Tails that are worth more than every lighter one, from the lightest on."""
    ordered = table.sort_values(["tail.mass", "worth"], ascending=[True, False])
    return ordered[ordered["worth"] > ordered["worth"].cummax().shift(fill_value=-np.inf)]


def plot_pareto(tried: pd.DataFrame, finalists: pd.DataFrame) -> Figure:
    """What tails are worth over their mass."""
    with styled():
        image, grid = new_figure(8.5, 4.6)
        axes = grid[0, 0]
        mass, worth = (pareto(tried)[name].to_numpy(float) for name in ("tail.mass", "worth"))
        for x, y, look in (
            (tried["tail.mass"], tried["worth"], {"marker": ".", "linestyle": "none", "color": GREY, "label": "tried"}),
            # Corners of the steps: up to the next mass the lighter tail is the best.
            (np.repeat(mass, 2)[1:], np.repeat(worth, 2)[:-1], {"color": BLUE, "label": "best of its mass"}),
            (
                *(finalists["tail.mass"], finalists["worth"]),
                {"marker": "s", "linestyle": "none", "color": VERMILION, "label": "finalists, full cars"},
            ),
        ):
            axes.plot(1000.0 * np.asarray(x), 100.0 * (np.asarray(y) - 1.0), **look)
        axes.set_xlabel("mass of rod and sail [g]")
        axes.set_ylabel("course over the published swing [%]")
        axes.legend()
    return image


def plot_mounts(table: pd.DataFrame) -> Figure:
    """Course, heading, critical friction and yaw impulses over the place of the joints, a colour per tail."""
    with styled():
        image, grid = new_figure(11.0, 4.2, 1, 3)
        for colour, (name, part) in zip(
            (GREY, BLUE, VERMILION, ORANGE), table.groupby("tail", sort=False), strict=False
        ):
            x = part["mount_x_m"].to_numpy(float)
            for axes, column, factor, line in (
                (grid[0, 0], "course_change_rad", np.degrees(1.0), "-"),
                (grid[0, 0], "exit_heading_change_rad", np.degrees(1.0), "--"),
                (grid[0, 1], "critical_friction", 1.0, "-"),
                (grid[0, 2], "aerodynamic_yaw_impulse_window_n_m_s", 1.0, "-"),
                (grid[0, 2], "inertial_yaw_impulse_window_n_m_s", 1.0, "--"),
            ):
                label = str(name) if axes is grid[0, 1] else None
                axes.plot(x, factor * part[column].to_numpy(float), line, marker=".", color=colour, label=label)
        for axes, words in zip(
            grid[0], ("course, heading [deg]", "critical friction [1]", "yaw impulse [N m s]"), strict=True
        ):
            axes.set_xlabel("joints ahead of the rear axle [m]")
            axes.set_ylabel(words)
        image.legend(loc="outside upper center", ncols=3)
    return image


def plot_sobol(table: pd.DataFrame) -> Figure:
    """Total and first-order Sobol indices with their intervals, a row per number, the largest on top."""
    ordered = table.sort_values("total")
    places = np.arange(len(ordered))
    with styled():
        image, grid = new_figure(8.0, 1.2 + 0.34 * len(ordered))
        axes = grid[0, 0]
        for shift, name, colour in ((0.18, "total", BLUE), (-0.18, "first", ORANGE)):
            axes.barh(places + shift, ordered[name], height=0.34, color=colour, label=name)
            for place, row in zip(places, ordered.to_dict("records"), strict=True):
                axes.plot([row[f"{name}_low"], row[f"{name}_high"]], [place + shift] * 2, color=GREY)
        axes.set_yticks(places, list(ordered["parameter"]))
        axes.set_xlabel("share of the variance of the course")
        axes.legend()
    return image


def plot_outlines(thesis: TailGeometry, designs: Sequence[Design]) -> Figure:
    """Rod and sail of the thesis' tail and of the designs, broadside, side by side to one scale."""
    shown = {"thesis": thesis} | {design.name: design.geometry for design in designs}
    with styled():
        image, grid = new_figure(2.2 * len(shown) + 0.6, 4.6, 1, len(shown), sharey=True)
        for axes, (name, geometry) in zip(grid[0], shown.items(), strict=True):
            for piece in (piece for plate in geometry.plates for piece in plate.pieces):
                axes.fill(piece.corners[:, 0], piece.corners[:, 2], color=ORANGE, alpha=0.4)
            axes.plot(geometry.arm.points[:, 0], geometry.arm.points[:, 2], color=GREY, linewidth=2.0)
            axes.set(title=f"{name}, {1000.0 * geometry.inertial.mass:.0f} g", aspect="equal", xlim=(-0.22, 0.22))
        grid[0, 0].set_ylabel("from the roll axis [m]")
    return image
