"""A Matplotlib figure as plain panels, from which a page draws it so that a reader can zoom.

Every figure is drawn once, with Matplotlib; `chart_panels` reads its lines, error bars, stripes and
ticks. A line whose x increases and that has a name becomes a series, whose values are read at the
mouse; all else is drawn below the series as it is.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator
from matplotlib.transforms import Transform

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json

_PIXELS_PER_INCH = 82
"""Pixels of a panel per inch of the figure."""
_MIN_HEIGHT = 120
"""Smallest height of a panel, pixels."""
_PIXELS_PER_POINT = 1.33
"""Pixels per point of line widths and marks."""
_MIN_SAMPLES = 3
"""Smallest number of points of a line that is drawn as a series."""
_NOTHING = ("None", "none", "")
"""Matplotlib's names of the line style and the marker that draw nothing."""


def chart_panels(figure: Figure) -> Json:
    """Reads a figure for `charts.js`, ready for JSON.

    Axes are linear, marks become discs, words inside a panel become a note above it.

    Returns:
        The title, the number of columns, the keys of the figure's legends, and cells, each with
        row, column and its panels one below the other.

    Raises:
        TypeError: a panel has something other than lines, error bars and stripes.
    """
    cells: dict[tuple[int, int], Json] = {}
    keys = [key for legend in figure.legends for key in _keys(legend)]
    for axes in figure.axes:
        panel = _panel(axes)
        legend = axes.get_legend()
        known = {item["label"] for item in (*panel["series"], *keys)}
        if legend is not None:
            keys += [entry for entry in _keys(legend) if entry["label"] not in known]
        place: Any = axes.get_subplotspec()
        top = place.get_topmost_subplotspec()
        row = top.rowspan.start
        column = top.colspan.start
        cell = cells.setdefault((row, column), {"row": row, "column": column, "panels": []})
        cell["panels"].append(panel)
    return {
        "title": figure.get_suptitle(),
        "columns": 1 + max(column for _, column in cells),
        "keys": keys,
        "cells": [cells[where] for where in sorted(cells)],
    }


def _panel(axes: Axes) -> Json:
    """Reads the title, axes, series and shapes of a panel."""
    lines = [line for line in axes.lines if _is_series(line, axes)]
    named = [line for line in lines if not str(line.get_label()).startswith("_")]
    if len(lines) == 1:
        named = lines
    figure: Any = axes.figure
    siblings = axes.get_shared_x_axes().get_siblings(axes)
    linked = [other for other in figure.axes if other in siblings]
    x_labels = [other.get_xlabel() for other in linked if other.get_xlabel()]
    x_name = x_labels[-1] if x_labels else ""
    height = axes.get_position(original=True).height * figure.get_figheight() * _PIXELS_PER_INCH
    return {
        "title": axes.get_title(loc="left"),
        "x_label": axes.get_xlabel(),
        "x_name": x_name.partition("   ")[0],
        "y_label": axes.get_ylabel(),
        "x_range": _numbers(axes.get_xlim()),
        "y_range": _numbers(axes.get_ylim()),
        "x_ticks": _ticks(axes.xaxis),
        "y_ticks": _ticks(axes.yaxis),
        "note": " ".join(text.get_text() for text in axes.texts),
        "linked": figure.axes.index(linked[0]),
        "height": max(_MIN_HEIGHT, round(height)),
        "series": [_series(line, axes) for line in named],
        "shapes": list(_shapes(axes, named)),
    }


def _ticks(axis: Any) -> list[tuple[float, str]] | None:
    """Reads place and words of ticks that were set by hand; None for numbers along the axis."""
    locator = axis.get_major_locator()
    if not isinstance(locator, FixedLocator):
        return None
    places = [float(place) for place in locator()]
    return list(zip(places, axis.get_major_formatter().format_ticks(places), strict=True))


def _is_series(line: Line2D, axes: Axes) -> bool:
    """Says whether a line has several samples in the coordinates of the data, whose x increases."""
    x = _points(line)[:, 0]
    in_data = line.get_transform().contains_branch_seperately(axes.transData)
    if x.size < _MIN_SAMPLES or not np.all(np.isfinite(x)):
        return False
    return all(in_data) and bool(np.all(np.diff(x) > 0.0))


def _points(line: Line2D) -> FloatArray:
    """Reads the points of a line, (n, 2), in the order in which they are drawn."""
    return np.asarray(line.get_xydata(), float)


def _series(line: Line2D, axes: Axes) -> Json:
    x, y = _points(line).T
    label = str(line.get_label())
    if label.startswith("_"):
        label = axes.get_ylabel() or "value"
    return {"label": label, "x": _numbers(x), "y": _numbers(y, 5), **_look(line)}


def _look(line: Line2D) -> Json:
    """Reads colour, width, dashes and mark."""
    look: Json = {
        "colour": to_hex(line.get_color()),
        "width": line.get_linewidth(),
        "joined": line.get_linestyle() not in _NOTHING,
    }
    # Matplotlib has no other way to read them.
    _, dashes = getattr(line, "_dash_pattern", (0, None))
    if dashes and look["joined"]:
        look["dash"] = [round(_PIXELS_PER_POINT * float(length), 2) for length in dashes]
    mark = line.get_marker()
    if mark not in _NOTHING:
        smaller = 0.5 if mark == "." else 1.0
        look["mark"] = "o"
        look["size"] = round(smaller * _PIXELS_PER_POINT * line.get_markersize(), 1)
        look["fill"] = to_hex(line.get_markerfacecolor())
        look["colour"] = to_hex(line.get_markeredgecolor())
    return look


def _shapes(axes: Axes, named: Sequence[Line2D]) -> Iterable[Json]:
    """Reads everything that is not a series, from the lowest to the topmost."""
    artists: list[Artist] = [*axes.patches, *axes.collections, *axes.lines]
    for artist in sorted(artists, key=lambda one: one.get_zorder()):
        if artist in named:
            continue
        if isinstance(artist, Line2D):
            yield from _line_shapes(artist, axes)
        elif isinstance(artist, Patch):
            yield _area(artist, axes)
        elif isinstance(artist, LineCollection):
            yield _segments(artist)
        else:
            raise TypeError(f"{type(artist).__name__} cannot be drawn as a chart")


def _line_shapes(line: Line2D, axes: Axes) -> Iterable[Json]:
    look = _look(line)
    place = _placed(_points(line), line.get_transform(), axes)
    if look["joined"]:
        place["stroke"] = to_hex(line.get_color())
        yield {**place, "width": look["width"], "dash": look.get("dash")}
    if "mark" in look:
        place["stroke"] = look["colour"]
        yield {**place, **{key: look[key] for key in ("mark", "size", "fill")}}


def _area(patch: Patch, axes: Axes) -> Json:
    """Reads a bar, or a stripe from edge to edge."""
    vertices = patch.get_path().transformed(patch.get_patch_transform()).vertices
    place = _placed(vertices, patch.get_data_transform(), axes)
    return {**place, "fill": to_hex(patch.get_facecolor())}


def _placed(vertices: Any, transform: Transform, axes: Axes) -> Json:
    """Reads where vertices (n, 2) are; along an axis whose coordinates are not those of the data,
    reads at which edge of the panel they are.
    """
    outline = _outline(vertices)
    in_data = transform.contains_branch_seperately(axes.transData)
    for axis, inside in zip("xy", in_data, strict=True):
        if not inside:
            outline[axis] = ["low" if value < 0.5 else "high" for value in outline[axis]]
    return outline


def _outline(vertices: Any) -> Json:
    x, y = np.asarray(vertices, float).T
    return {"x": _numbers(x), "y": _numbers(y)}


def _segments(lines: LineCollection) -> Json:
    """Joins lines of one colour, such as error bars, with a gap after each."""
    rows: list[Any] = []
    for segment in lines.get_segments():
        rows += [*segment, (math.nan, math.nan)]
    width = float(np.ravel(lines.get_linewidth())[0])
    colour: Any = lines.get_color()[0]
    return {**_outline(rows), "stroke": to_hex(colour), "width": width}


def _keys(legend: Legend) -> list[Json]:
    """Reads name and look of each line of a legend."""
    handles: Any = legend.legend_handles
    entries = zip(handles, legend.get_texts(), strict=True)
    return [{"label": text.get_text(), **_look(handle)} for handle, text in entries]


def _numbers(values: Iterable[float], digits: int = 6) -> list[float | None]:
    """Rounds to as many digits as a chart can show; None for values that are not finite."""
    numbers = (float(f"{value:.{digits}g}") for value in values)
    return [number if math.isfinite(number) else None for number in numbers]
