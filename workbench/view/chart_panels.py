"""A Matplotlib figure as plain panels, from which a page draws the same figure so that one can zoom
in it.

Every figure is drawn once, with Matplotlib; `chart_panels` reads its lines, points, areas, bars and
ticks. A line whose x increases and that has a name becomes a series, whose values are read at the
mouse; all else is drawn below as it is.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import FixedLocator

from aerodima.workbench.core.array_types import FloatArray

_PIXELS_PER_INCH = 82
"""Pixels of a panel per inch of the figure."""
_LEAST_HEIGHT = 120
"""Least height of a panel, pixels."""
_PIXELS_PER_POINT = 1.33
"""Pixels per point of line widths and marks."""
_LEAST_SAMPLES = 3
"""Fewest points of a line that is drawn as a series."""
_NO_LINE = ("None", "none", " ", "")
"""Matplotlib's names of the line style that draws nothing."""
_NO_MARK = (*_NO_LINE, None)
"""Matplotlib's names of the marker that draws nothing."""
_MARKS = {"s": "s", "D": "D", "d": "D", "^": "^", "v": "v", "x": "x", "X": "x", "+": "x"}
"""Matplotlib's marker -> that of the page; others are discs."""


class NoChartError(TypeError):
    """The figure has something that a page draws as a picture only, such as an image or words
    inside a panel.
    """


def chart_panels(figure: Figure) -> dict[str, Any]:
    """The figure for `charts.js`, ready for JSON.

    Returns:
        title, columns, keys (of the figure's legends), and cells: row, column and the panels one
        below the other.

    Raises:
        NoChartError: the figure has an image, a twin axis, or words in the coordinates of the data.
    """
    cells: dict[tuple[int, int], dict[str, Any]] = {}
    keys = [key for legend in figure.legends for key in _keys(legend)]
    shown = [axes for axes in figure.axes if axes.get_visible()]
    for axes in shown:
        legend = axes.get_legend()
        place = axes.get_subplotspec()
        entries = []
        if legend:
            entries = _keys(legend)
        if not axes.axison or place is None:
            keys += entries
            continue
        if any(other is not axes and other.get_subplotspec() is place for other in shown):
            raise NoChartError("an axis to the right of another one cannot be drawn as a chart")
        panel = _panel(axes, shown)
        known = {item["label"] for item in (*panel["series"], *keys)}
        keys += [entry for entry in entries if entry["label"] not in known]
        top = place.get_topmost_subplotspec()
        where = (top.rowspan.start, top.colspan.start)
        cell = cells.setdefault(where, {"row": where[0], "column": where[1], "panels": []})
        cell["panels"].append(panel)
    columns = 1 + max((column for _, column in cells), default=0)
    title = figure.get_suptitle()
    return {
        "title": title,
        "columns": columns,
        "keys": keys,
        "cells": [cells[where] for where in sorted(cells)],
    }


def _panel(axes: Axes, shown: Sequence[Axes]) -> dict[str, Any]:
    _refuse(axes)
    named = [
        line
        for line in axes.lines
        if not str(line.get_label()).startswith("_") and _is_series(line, axes)
    ]
    if not named:
        free = [line for line in axes.lines if _is_series(line, axes)]
        named = free if len(free) == 1 else []
    figure: Any = axes.figure
    siblings = axes.get_shared_x_axes().get_siblings(axes)
    x_labels = [other.get_xlabel() for other in shown if other in siblings]
    x_labels = [label for label in x_labels if label]
    height = (
        axes.get_position(original=True).height
        * float(figure.get_size_inches()[1])
        * _PIXELS_PER_INCH
    )
    return {
        "title": axes.get_title(loc="left") or axes.get_title(),
        "x_label": axes.get_xlabel(),
        "x_name": (x_labels or [""])[-1].partition("   ")[0],
        "y_label": axes.get_ylabel(),
        "x_range": _numbers(axes.get_xlim()),
        "y_range": _numbers(axes.get_ylim()),
        "x_log": _is_log(axes.get_xscale()),
        "y_log": _is_log(axes.get_yscale()),
        "x_ticks": _ticks(axes.xaxis),
        "y_ticks": _ticks(axes.yaxis),
        "note": " ".join(text.get_text() for text in axes.texts),
        "linked": min(shown.index(other) for other in siblings if other in shown),
        "height": max(_LEAST_HEIGHT, round(height)),
        "series": [_series(line, axes) for line in named],
        "shapes": list(_shapes(axes, named)),
    }


def _refuse(axes: Axes) -> None:
    if axes.images:
        raise NoChartError("an image cannot be drawn as a chart")
    for text in axes.texts:
        if text.get_text() and any(text.get_transform().contains_branch_seperately(axes.transData)):
            raise NoChartError(
                f"the words {text.get_text()!r} stand in the coordinates of the data"
            )


def _is_log(scale: str) -> bool:
    if scale not in ("linear", "log"):
        raise NoChartError(f"a scale is {scale!r}; allowed: linear, log")
    return scale == "log"


def _ticks(axis: Any) -> list[tuple[float, str]] | None:
    """Place and words of ticks that were set by hand; None for numbers along the axis."""
    locator = axis.get_major_locator()
    formatter = axis.get_major_formatter()
    if not isinstance(locator, FixedLocator):
        return None
    places = [float(place) for place in locator()]
    return list(zip(places, formatter.format_ticks(places), strict=True))


def _is_series(line: Line2D, axes: Axes) -> bool:
    """Whether it has several samples in the coordinates of the data, whose x increases."""
    x, y = _data(line)
    in_data = line.get_transform().contains_branch_seperately(axes.transData)
    enough = x.size == y.size >= _LEAST_SAMPLES
    return bool(all(in_data) and enough and np.all(np.isfinite(x)) and np.all(np.diff(x) > 0.0))


def _data(line: Line2D) -> tuple[FloatArray, FloatArray]:
    return np.asarray(line.get_xdata(orig=False), dtype=float), np.asarray(
        line.get_ydata(orig=False), dtype=float
    )


def _series(line: Line2D, axes: Axes) -> dict[str, Any]:
    x, y = _data(line)
    low, high = sorted(axes.get_xlim())
    first = max(np.searchsorted(x, low) - 1, 0)
    end = np.searchsorted(x, high, side="right") + 1
    x = x[first:end]
    y = y[first:end]
    label = str(line.get_label())
    if label.startswith("_"):
        label = axes.get_ylabel() or "value"
    return {
        "label": label,
        "x": _numbers(x),
        "y": _numbers(y, 5),
        **_look(line),
        "joined": _is_joined(line),
    }


def _is_joined(line: Line2D) -> bool:
    return line.get_linestyle() not in _NO_LINE


def _look(line: Line2D) -> dict[str, Any]:
    """Colour, width, dashes and mark."""
    look: dict[str, Any] = {
        "colour": _colour(line.get_color(), line.get_alpha()),
        "width": line.get_linewidth(),
    }
    # Matplotlib has no other way to read them.
    _, dashes = getattr(line, "_dash_pattern", (0, None))
    if dashes and _is_joined(line):
        look["dash"] = [round(_PIXELS_PER_POINT * float(length), 2) for length in dashes]
    mark = line.get_marker()
    if mark not in _NO_MARK:
        smaller = 0.5 if mark == "." else 1.0
        look["mark"] = _MARKS.get(str(mark), "o")
        look["size"] = round(smaller * _PIXELS_PER_POINT * line.get_markersize(), 1)
        look["fill"] = _colour(line.get_markerfacecolor(), line.get_alpha())
        look["colour"] = _colour(line.get_markeredgecolor(), line.get_alpha())
    return look


def _shapes(axes: Axes, named: Sequence[Line2D]) -> Iterable[dict[str, Any]]:
    """Everything that is not a series, from the lowest to the topmost."""
    artists: list[Artist] = [
        *axes.patches,
        *axes.collections,
        *(line for line in axes.lines if line not in named),
    ]
    for artist in sorted(artists, key=lambda one: one.get_zorder()):
        if not artist.get_visible():
            continue
        if isinstance(artist, Line2D):
            yield from _line_shapes(artist, axes)
        elif isinstance(artist, Rectangle | Polygon):
            yield _area(artist, axes)
        elif isinstance(artist, PathCollection):
            yield from _points(artist)
        elif isinstance(artist, LineCollection):
            yield _segments(artist)
        elif isinstance(artist, PolyCollection):
            fill = _colour(artist.get_facecolor()[0], artist.get_alpha())
            yield from ({**_outline(path.vertices), "fill": fill} for path in artist.get_paths())
        else:
            raise NoChartError(f"{type(artist).__name__} cannot be drawn as a chart")


def _line_shapes(line: Line2D, axes: Axes) -> Iterable[dict[str, Any]]:
    x, y = _data(line)
    if not x.size:
        return
    look = _look(line)
    in_x, in_y = line.get_transform().contains_branch_seperately(axes.transData)
    place: dict[str, Any] = {"x": ["low", "high"], "y": ["low", "high"]}
    if in_x:
        place["x"] = _numbers(x)
    if in_y:
        place["y"] = _numbers(y)
    if _is_joined(line):
        yield {
            **place,
            "stroke": _colour(line.get_color(), line.get_alpha()),
            "width": look["width"],
            "dash": look.get("dash"),
        }
    if "mark" in look:
        yield {
            **place,
            "stroke": look["colour"],
            **{key: look[key] for key in ("mark", "size", "fill")},
        }


def _area(patch: Patch, axes: Axes) -> dict[str, Any]:
    """A bar, a polygon, or a stripe from edge to edge."""
    outline = _outline(patch.get_path().transformed(patch.get_patch_transform()).vertices)
    in_data = patch.get_data_transform().contains_branch_seperately(axes.transData)
    for axis, inside in zip("xy", in_data, strict=True):
        if not inside:
            outline[axis] = [
                "low" if value is not None and value < 0.5 else "high" for value in outline[axis]
            ]
    if patch.get_linewidth() > 0.0:
        edge = _colour(patch.get_edgecolor())
    else:
        edge = None
    return {
        **outline,
        "fill": _colour(patch.get_facecolor()),
        "stroke": edge,
        "width": patch.get_linewidth(),
    }


def _outline(vertices: Any) -> dict[str, Any]:
    points = np.asarray(vertices, dtype=float)
    return {"x": _numbers(points[:, 0]), "y": _numbers(points[:, 1])}


def _points(points: PathCollection) -> Iterable[dict[str, Any]]:
    """Points of a scatter plot, by colour; the area of each is in square points."""
    offsets = np.asarray(np.ma.filled(points.get_offsets(), np.nan), dtype=float).reshape(-1, 2)
    colours = [_colour(colour) for colour in points.get_facecolor()] or ["#00000000"]
    sizes = _PIXELS_PER_POINT * np.sqrt(
        np.resize(np.asarray(points.get_sizes(), dtype=float), len(offsets))
    )
    of_point = np.resize(np.array(colours), len(offsets))
    for colour in dict.fromkeys(of_point.tolist()):
        chosen = of_point == colour
        yield {
            **_outline(offsets[chosen]),
            "mark": "o",
            "fill": colour,
            "size": _numbers(sizes[chosen]),
        }


def _segments(lines: LineCollection) -> dict[str, Any]:
    """Lines of one colour, such as error bars, with a gap after each."""
    rows = [row for segment in lines.get_segments() for row in (*segment, (math.nan, math.nan))]
    width = float(np.asarray(lines.get_linewidth()).ravel()[0])
    points = np.asarray(rows, dtype=float).reshape(-1, 2)
    return {**_outline(points), "stroke": _colour(lines.get_color()[0]), "width": width}


def _keys(legend: Legend) -> list[dict[str, Any]]:
    """Name and look of each entry of a legend."""
    keys = []
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        look: dict[str, Any] = {}
        if isinstance(handle, Line2D):
            look = {**_look(handle), "joined": _is_joined(handle)}
        elif isinstance(handle, Patch):
            look = {"colour": _colour(handle.get_facecolor()), "mark": "s", "size": 12}
            look["fill"] = look["colour"]
        keys.append({"label": text.get_text(), **look})
    return keys


def _colour(colour: Any, alpha: float | None = None) -> str | None:
    """Colour as CSS text; None for none."""
    if isinstance(colour, str) and colour == "none":
        return None
    if alpha is None:
        rgba = to_hex(colour, keep_alpha=True)
    else:
        rgba = to_hex((colour, alpha), keep_alpha=True)
    if rgba.endswith("ff"):
        return rgba[:7]
    return rgba


def _numbers(values: Iterable[float], digits: int = 6) -> list[float | None]:
    """With as many digits as a chart can show; None for what is not finite."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None
        for value in np.asarray(values, dtype=float)
    ]
