"""One look for all figures: colours, markers, lines, the shaded turn, files."""

import io
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from aerodima.workbench.core.array_types import Pair

# Okabe and Ito's palette, made to be distinguished with any colour vision.
BLACK = "#000000"
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
SKY = "#56B4E9"
PURPLE = "#CC79A7"
GREY = "#6b6b6b"
TURN_SHADE = "#e9e4d4"

_DPI = 130
"""Pixels per inch of a PNG."""
STYLE = Path(__file__).with_name("figures.mplstyle")


styled = partial(matplotlib.rc_context, fname=STYLE)
"""Applies the settings of all figures in a block, or as a decorator; a notebook's settings outside
stay as they are."""


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """Makes a figure of width x height inches and its axes, shape (rows, columns)."""
    figure = Figure(figsize=(width, height))
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def shade_turn(axes: Axes, window: Pair) -> None:
    """Marks the turn: from the steering command until the wheels are straight again."""
    axes.axvspan(*window, color=TURN_SHADE, zorder=0, linewidth=0)


def png(figure: Figure) -> bytes:
    """Draws the figure as PNG, the same bytes for the same figure (no time stamp, no version in
    it).

    It uses the canvas directly: `Figure.savefig` draws every figure twice, once only to lay it out.
    """
    buffer = io.BytesIO()
    previous_dpi = figure.get_dpi()
    canvas: Any = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    try:
        with styled():
            canvas.print_png(buffer, metadata={"Software": None})
    finally:
        figure.set_dpi(previous_dpi)
    return buffer.getvalue()
