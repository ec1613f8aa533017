"""Figures of models: clearance of a tail; its outline, sections and normals; the block diagram."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aerodima.workbench.aero.tail_geometry import TailGeometry
from aerodima.workbench.aero.tail_pieces import unit_vector
from aerodima.workbench.car.clearance import PARTS, RangeOfMotion
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.view.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    new_figure,
    styled,
)

if TYPE_CHECKING:
    from pydrake.systems.framework import System


_PART_COLOURS = dict(zip(PARTS, (VERMILION, ORANGE, PURPLE, BLUE), strict=True))
_DASHED = (0, (3, 2))
"""Matplotlib's line style of a margin and of a round side."""
_FINE = 241
"""Number of angles of each joint at which the clearance is drawn."""
_ARROW = 0.12
"""Length of a normal over the size of the tail."""


def plot_range_of_motion(motion: RangeOfMotion, margin: float = 0.01) -> Figure:
    """Draws two maps over tail roll (right positive) and pitch (forwards positive): clearance, and
    the part next to the tail.

    Args:
        motion: range of motion that is drawn.
        margin: clearance whose contour is drawn beside that of touching, m.
    """
    pitch = np.linspace(motion.pitch[0], motion.pitch[-1], _FINE)
    roll = np.linspace(motion.roll[0], motion.roll[-1], _FINE)
    p, r = np.meshgrid(pitch, roll, indexing="ij")
    degrees = (np.degrees(r), np.degrees(p))
    least = motion.clearance(p, r)
    each = np.array([motion.clearance(p, r, (part,)) for part in PARTS])
    touched = np.where(least < margin, np.argmin(each, axis=0), -1)
    millimetres = f"{1000 * margin:.0f} mm"
    with styled():
        figure, grid = new_figure(11.0, 5.0, 1, 2, sharey=True)
        left, right = grid[0]
        filled = left.contourf(
            *degrees, 1000.0 * least, levels=np.arange(-40, 61, 5), cmap="PuOr", extend="both"
        )
        figure.colorbar(filled, ax=left, label="clearance to car and ground [mm]")
        for axes in (left, right):
            for level, line in ((0.0, "-"), (margin, _DASHED)):
                axes.contour(*degrees, least, levels=[level], colors=BLACK, linestyles=[line])
            axes.set_xlabel("tail roll [deg], to the right positive")
            axes.grid(False)
        left.set_ylabel("tail pitch [deg], forwards positive")
        handles: list[Artist] = []
        for number, part in enumerate(PARTS):
            colour = _PART_COLOURS[part]
            mask = np.where(touched == number, 1.0, np.nan)
            right.contourf(*degrees, mask, levels=[0.5, 1.5], colors=[colour])
            if np.any(touched == number):
                handles.append(Patch(color=colour, label=part))
        handles += [
            Patch(facecolor="white", edgecolor=BLACK, label="free"),
            Line2D([], [], color=BLACK, label="touches"),
            Line2D([], [], color=BLACK, linestyle=_DASHED, label=f"{millimetres} left"),
        ]
        right.set_title(f"what is nearer than {millimetres}")
        left.set_title("clearance of rod and sail")
        right.legend(handles=handles, loc="lower right", frameon=True, framealpha=0.9)
        right.plot([-90, 90], [0, 0], color=GREEN, linewidth=2.5)
        right.annotate("swing in roll alone", (0.0, 3.0), color=GREEN, ha="center")
    return figure


def plot_tail(geometry: TailGeometry) -> Figure:
    """Draws two views of a tail, onto the face of the first plate and along its width, with z of
    the frame T upwards; lengths in m.
    """
    normal = geometry.plates[0].pieces[0].normal
    up = np.array([0.0, 0.0, 1.0])
    if abs(normal[2]) > 0.9:
        up = geometry.plates[0].pieces[0].axis
    views = (("onto the face", unit_vector(np.cross(normal, up))), ("from the side", normal))
    with styled():
        figure, grid = new_figure(6.5, 7.0, 1, 2, sharey=True)
        for axes, (title, sideways) in zip(grid[0], views, strict=True):
            _view(axes, geometry, sideways, up)
            axes.set(xlabel=f"along {_direction(sideways)} [m]", title=title, aspect="equal")
        grid[0, 0].set_ylabel(f"along {_direction(up)} [m]")
        drawn = [axes.get_legend_handles_labels() for axes in grid[0]]
        handles = {label: handle for each in drawn for handle, label in zip(*each, strict=True)}
        figure.legend(handles.values(), handles, loc="outside lower center", ncols=3)
        mass = f"{1000 * geometry.inertial.mass:.3g} g"
        area = f"{1e4 * geometry.area:.3g} cm² of planform"
        figure.suptitle(f"{geometry.name}: {mass}, {area}")
    return figure


def _view(axes: Axes, geometry: TailGeometry, sideways: FloatArray, up: FloatArray) -> None:
    """Draws arm, plates, sections and centres on a plane."""
    plane = np.column_stack([sideways, up])
    size = float(np.ptp(geometry.points, axis=0).max())
    arm = geometry.arm.points @ plane
    axes.plot(*arm.T, color=BLACK, linewidth=3.0, solid_capstyle="round", label="arm")
    for plate in geometry.plates:
        for piece in plate.pieces:
            outline = piece.corners @ plane
            axes.fill(*outline.T, color=ORANGE, alpha=0.25, linewidth=0.0)
            axes.plot(*np.vstack([outline, outline[:1]]).T, color=ORANGE)
            low = piece.corners[[0, 1]]
            high = piece.corners[[3, 2]]
            for share in np.linspace(0.0, 1.0, plate.sections + 1)[1:-1]:
                border = (low + share * (high - low)) @ plane
                axes.plot(*border.T, color=ORANGE, linewidth=0.8)
            if plate.kind == "half_shell":
                axes.plot(*(piece.crown @ plane).T, color=ORANGE, linestyle=_DASHED)
        for layout in plate.section_layouts():
            centres = layout.p_BoSi_B @ plane
            normal = _ARROW * size * np.asarray(layout.normal_B) @ plane
            axes.plot(*centres.T, "o", color=ORANGE, markersize=4, label="centres of sections")
            if np.linalg.norm(normal) > 1e-6:
                arrows = np.broadcast_to(normal, centres.shape)
                axes.quiver(
                    *centres.T, *arrows.T, angles="xy", scale_units="xy", scale=1.0, color=BLUE,
                    width=0.006, label="normals",
                )  # fmt: skip
                axes.update_datalim(centres + normal)
    pressure = geometry.centre_of_pressure() @ plane
    mass = np.asarray(geometry.inertial.com) @ plane
    mark = partial(axes.plot, markersize=10, linestyle="none")
    mark(*pressure, color=VERMILION, marker="X", label="centre of pressure")
    mark(*mass, color=BLACK, marker="P", label="centre of mass")
    mark([0.0], [0.0], color=GREY, marker="o", fillstyle="none", label="origin of T")
    axes.margins(x=0.2, y=0.05)
    axes.autoscale_view()


def _direction(vector: FloatArray) -> str:
    """Names an axis of T, or writes its numbers."""
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.allclose(vector, unit):
            return name
        if np.allclose(vector, -unit):
            return f"-{name}"
    return "(" + ", ".join(f"{value:.2g}" for value in vector) + ")"


@dataclass(frozen=True)
class DiagramPicture:
    """Picture that Graphviz draws; a notebook shows it, or without Graphviz a line of text.

    Attributes:
        text: description of the diagram in Graphviz's language.
    """

    text: str

    def render(self, kind: str = "svg") -> bytes:
        """Renders the picture as a file's content: svg, png, pdf, or another kind of Graphviz.

        Raises:
            UserError: Graphviz is not installed, or refuses text or kind.
        """
        program = shutil.which("dot")
        if program is None:
            raise UserError(
                "Graphviz is not installed: `aerodima doctor` says how; the text is in `.text`"
            )
        done = subprocess.run(
            [program, f"-T{kind}"], input=self.text.encode(), capture_output=True, check=False
        )
        if done.returncode != 0:
            raise UserError(f"Graphviz failed: {done.stderr.decode(errors='replace').strip()}")
        return done.stdout

    def _repr_svg_(self) -> str | None:
        """Draws an SVG as wide as the page, not as wide as Graphviz makes it."""
        if shutil.which("dot") is None:
            return None
        return re.sub(
            r'<svg width="\S*" height="\S*"', '<svg width="100%"', self.render().decode(), count=1
        )

    def __repr__(self) -> str:
        """Returns the line that stands in place of the picture, with what is missing."""
        if shutil.which("dot"):
            return "block diagram"
        return "block diagram: not drawn, Graphviz is not installed"


def draw_diagram(diagram: System, depth: int = 1) -> DiagramPicture:
    """Draws a diagram: a box per system, an arrow per connection.

    Args:
        diagram: built diagram.
        depth: number of levels of nested diagrams that are opened.

    Raises:
        UserError: depth below 1.
    """
    check_range("draw_diagram: depth", depth, 1, math.inf, NO_UNIT)
    return DiagramPicture(diagram.GetGraphvizString(max_depth=depth))
