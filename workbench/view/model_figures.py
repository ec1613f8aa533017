"""Figures of models: where a tail touches nothing, its outline, sections and normals; the block
diagram.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from aerodima.workbench.aero.tail_geometry import TailGeometry
from aerodima.workbench.aero.tail_pieces import Piece, unit_vector
from aerodima.workbench.car.clearance import PARTS, RangeOfMotion
from aerodima.workbench.core.errors import UserError
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
_FINE = 241
"""Angles of each joint at which the clearance is drawn."""
_ARROW = 0.12
"""Length of a normal over the size of the tail."""


def plot_range_of_motion(motion: RangeOfMotion, margin: float = 0.01) -> Figure:
    """Two maps over tail roll (right positive) and pitch (forwards positive): clearance, and the
    part next to the tail.

    Args:
        motion: the map.
        margin: m; its contour is drawn beside that of touching.
    """
    pitch = np.linspace(motion.pitch[0], motion.pitch[-1], _FINE)
    roll = np.linspace(motion.roll[0], motion.roll[-1], _FINE)
    p, r = np.meshgrid(pitch, roll, indexing="ij")
    degrees = (np.degrees(r), np.degrees(p))
    least = motion.clearance(p, r)
    each = np.array([motion.clearance(p, r, (part,)) for part in PARTS])
    with styled():
        figure, grid = new_figure(11.0, 5.0, 1, 2, sharey=True)
        left, right = grid[0]
        filled = left.contourf(
            *degrees, 1000.0 * least, levels=np.arange(-40, 61, 5), cmap="PuOr", extend="both"
        )
        figure.colorbar(filled, ax=left, label="clearance to car and ground [mm]")
        for axes in (left, right):
            for level, line in ((0.0, "-"), (margin, (0, (3, 2)))):
                axes.contour(*degrees, least, levels=[level], colors=BLACK, linestyles=[line])
            axes.set_xlabel("tail roll [deg], to the right positive")
            axes.grid(False)
        left.set_ylabel("tail pitch [deg], forwards positive")
        touched = np.where(least < margin, np.argmin(each, axis=0), -1)
        for number, part in enumerate(PARTS):
            mask = np.where(touched == number, 1.0, np.nan)
            right.contourf(*degrees, mask, levels=[0.5, 1.5], colors=[_PART_COLOURS[part]])
        handles: list[Artist] = [
            Patch(color=_PART_COLOURS[part], label=part)
            for n, part in enumerate(PARTS)
            if np.any(touched == n)
        ]
        handles.append(Patch(facecolor="white", edgecolor=BLACK, label="free"))
        handles.append(Line2D([], [], color=BLACK, label="touches"))
        handles.append(
            Line2D([], [], color=BLACK, linestyle=(0, (3, 2)), label=f"{1000 * margin:.0f} mm left")
        )
        right.set_title(f"what is nearer than {1000 * margin:.0f} mm")
        left.set_title("clearance of rod and sail")
        right.legend(handles=handles, loc="lower right", frameon=True, framealpha=0.9)
        right.plot([-90, 90], [0, 0], color=GREEN, linewidth=2.5)
        right.annotate("swing in roll alone", (0.0, 3.0), color=GREEN, ha="center")
    return figure


def plot_tail(geometry: TailGeometry) -> Figure:
    """Two views: onto the face of the first plate, and along its width, z of the frame T upwards;
    m.
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
        figure.suptitle(
            f"{geometry.name}: {1000 * geometry.inertial.mass:.3g} g, {1e4 * geometry.area:.3g} "
            "cm² of planform"
        )
    return figure


def _view(axes: Axes, geometry: TailGeometry, sideways: np.ndarray, up: np.ndarray) -> None:
    plane = np.column_stack([sideways, up])
    size = float(np.ptp(geometry.points, axis=0).max())
    axes.plot(
        *(geometry.arm.points @ plane).T,
        color=BLACK,
        linewidth=3.0,
        solid_capstyle="round",
        label="arm",
    )
    for plate in geometry.plates:
        for piece in plate.pieces:
            outline = piece.corners @ plane
            axes.fill(*outline.T, color=ORANGE, alpha=0.25, linewidth=0.0)
            axes.plot(*np.vstack([outline, outline[:1]]).T, color=ORANGE)
            low = piece.corners[[0, 1]]
            high = piece.corners[[3, 2]]
            for share in np.linspace(0.0, 1.0, plate.sections + 1)[1:-1]:
                axes.plot(*((low + share * (high - low)) @ plane).T, color=ORANGE, linewidth=0.8)
            if plate.kind == "half_shell":
                _crown(axes, piece, plane)
        for layout in plate.section_layouts():
            centres = layout.p_BoSi_B @ plane
            normal = _ARROW * size * np.asarray(layout.normal_B) @ plane
            axes.plot(
                *centres.T,
                color=ORANGE,
                marker="o",
                markersize=4,
                linestyle="none",
                label="centres of sections",
            )
            if np.linalg.norm(normal) > 1e-6:
                across, along = np.broadcast_to(normal, centres.shape).T
                exact: Any = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
                axes.quiver(
                    *centres.T, across, along, color=BLUE, width=0.006, label="normals", **exact
                )
                axes.update_datalim(centres + normal)
    places: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("centre of pressure", geometry.centre_of_pressure(), {"color": VERMILION, "marker": "X"}),
        ("centre of mass", np.asarray(geometry.inertial.com), {"color": BLACK, "marker": "P"}),
        ("origin of T", np.zeros(3), {"color": GREY, "marker": "o", "fillstyle": "none"}),
    )
    for label, place, look in places:
        axes.plot(*(place @ plane), markersize=10, linestyle="none", label=label, **look)
    axes.margins(x=0.2, y=0.05)
    axes.autoscale_view()


def _crown(axes: Axes, piece: Piece, plane: np.ndarray) -> None:
    """Draws the round side of a half shell."""
    ends = np.array([piece.start, piece.start + piece.length * piece.axis])
    axes.plot(
        *((ends + np.outer(piece.chords, piece.normal) / 2) @ plane).T,
        color=ORANGE,
        linestyle=(0, (3, 2)),
    )


def _direction(vector: np.ndarray) -> str:
    """Name of an axis of T, or its numbers."""
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if np.allclose(vector, unit):
            return name
        if np.allclose(vector, -unit):
            return f"-{name}"
    return "(" + ", ".join(f"{value:.2g}" for value in vector) + ")"


@dataclass(frozen=True)
class DiagramPicture:
    """What Graphviz draws; a notebook shows it as a picture, or without Graphviz a line.

    Attributes:
        text: in Graphviz's language.
    """

    text: str

    def render(self, kind: str = "svg") -> bytes:
        """The picture as a file's content: svg, png, pdf, or what else Graphviz knows.

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
        """SVG as wide as the page, not as wide as Graphviz makes it."""
        if shutil.which("dot") is None:
            return None
        return re.sub(
            r'<svg width="\S*" height="\S*"', '<svg width="100%"', self.render().decode(), count=1
        )

    def __repr__(self) -> str:
        """Says what is missing where it stands in the place of the picture."""
        return (
            "block diagram"
            if shutil.which("dot")
            else "block diagram: not drawn, Graphviz is not installed"
        )


def draw_diagram(diagram: System, depth: int = 1) -> DiagramPicture:
    """Draws a diagram: a box per system, an arrow per connection.

    Args:
        diagram: built.
        depth: how many levels of nested diagrams are opened.

    Raises:
        UserError: depth below 1.
    """
    if depth < 1:
        raise UserError(f"draw_diagram: depth is {depth}; allowed: 1 and more")
    return DiagramPicture(diagram.GetGraphvizString(max_depth=depth))
