"""A Matplotlib figure as plain panels, from which a page draws the same figure so that one can zoom
in it.

Every figure is drawn once, with Matplotlib; `chart_panels` reads its lines, error bars, areas, bars
and ticks. A line whose x increases and that has a name becomes a series, whose values are read at
the mouse; all else is drawn below as it is.
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
from matplotlib.patches import Patch, Polygon, Rectangle
from matplotlib.ticker import FixedLocator

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json

_PIXELS_PER_INCH = 82
"""Pixels of a panel per inch of the figure."""
_MIN_HEIGHT = 120
"""Least height of a panel, pixels."""
_PIXELS_PER_POINT = 1.33
"""Pixels per point of line widths and marks."""
_MIN_SAMPLES = 3
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


def chart_panels(figure: Figure) -> Json:
    """Reads a figure for `charts.js`, ready for JSON.

    Returns:
        title, columns, keys (of the figure's legends), and cells: row, column and the panels one
        below the other.

    Raises:
        NoChartError: the figure has an image, a twin axis, or words in the coordinates of the data.
    """
    cells: dict[tuple[int, int], Json] = {}
    keys = [key for legend in figure.legends for key in _keys(legend)]
    shown = [axes for axes in figure.axes if axes.get_visible()]
    for axes in shown:
        legend = axes.get_legend()
        place = axes.get_subplotspec()
        entries = _keys(legend) if legend else []
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
    return {
        "title": figure.get_suptitle(),
        "columns": 1 + max((column for _, column in cells), default=0),
        "keys": keys,
        "cells": [cells[where] for where in sorted(cells)],
    }


def _panel(axes: Axes, shown: Sequence[Axes]) -> Json:
    """Reads the title, axes, series and shapes of a panel."""
    _refuse(axes)
    lines = [line for line in axes.lines if _is_series(line, axes)]
    named = [line for line in lines if not str(line.get_label()).startswith("_")]
    if len(lines) == 1:
        named = lines
    figure: Any = axes.figure
    siblings = axes.get_shared_x_axes().get_siblings(axes)
    linked = [other for other in shown if other in siblings]
    x_labels = [other.get_xlabel() for other in linked if other.get_xlabel()]
    x_name = x_labels[-1] if x_labels else ""
    title = axes.get_title(loc="left") or axes.get_title()
    words = [text.get_text() for text in axes.texts]
    height = axes.get_position(original=True).height * figure.get_figheight() * _PIXELS_PER_INCH
    return {
        "title": title,
        "x_label": axes.get_xlabel(),
        "x_name": x_name.partition("   ")[0],
        "y_label": axes.get_ylabel(),
        "x_range": _numbers(axes.get_xlim()),
        "y_range": _numbers(axes.get_ylim()),
        "x_log": _is_log(axes.get_xscale()),
        "y_log": _is_log(axes.get_yscale()),
        "x_ticks": _ticks(axes.xaxis),
        "y_ticks": _ticks(axes.yaxis),
        "note": " ".join(words),
        "linked": shown.index(linked[0]),
        "height": max(_MIN_HEIGHT, round(height)),
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
        raise NoChartError(f"a scale is {scale!r}; must be linear, log")
    return scale == "log"


def _ticks(axis: Any) -> list[tuple[float, str]] | None:
    """Reads place and words of ticks that were set by hand; None for numbers along the axis."""
    locator = axis.get_major_locator()
    if not isinstance(locator, FixedLocator):
        return None
    places = [float(place) for place in locator()]
    return list(zip(places, axis.get_major_formatter().format_ticks(places), strict=True))


def _is_series(line: Line2D, axes: Axes) -> bool:
    """Says whether a line has several samples in the coordinates of the data, whose x increases."""
    x = np.asarray(line.get_xdata(orig=False), float)
    in_data = line.get_transform().contains_branch_seperately(axes.transData)
    if x.size < _MIN_SAMPLES or not np.all(np.isfinite(x)):
        return False
    return all(in_data) and bool(np.all(np.diff(x) > 0.0))


def _data(line: Line2D) -> tuple[FloatArray, FloatArray]:
    x, y = line.get_data(orig=False)
    return np.asarray(x, float), np.asarray(y, float)


def _series(line: Line2D, axes: Axes) -> Json:
    x, y = _data(line)
    low, high = sorted(axes.get_xlim())
    first = max(np.searchsorted(x, low) - 1, 0)
    end = np.searchsorted(x, high, side="right") + 1
    x = x[first:end]
    y = y[first:end]
    label = str(line.get_label())
    if label.startswith("_"):
        label = axes.get_ylabel() or "value"
    return {"label": label, "x": _numbers(x), "y": _numbers(y, 5), **_look(line)}


def _look(line: Line2D) -> Json:
    """Reads colour, width, dashes and mark."""
    look: Json = {
        "colour": _colour(line.get_color(), line.get_alpha()),
        "width": line.get_linewidth(),
        "joined": line.get_linestyle() not in _NO_LINE,
    }
    # Matplotlib has no other way to read them.
    _, dashes = getattr(line, "_dash_pattern", (0, None))
    if dashes and look["joined"]:
        look["dash"] = [round(_PIXELS_PER_POINT * float(length), 2) for length in dashes]
    mark = line.get_marker()
    if mark not in _NO_MARK:
        smaller = 0.5 if mark == "." else 1.0
        look["mark"] = _MARKS.get(str(mark), "o")
        look["size"] = round(smaller * _PIXELS_PER_POINT * line.get_markersize(), 1)
        look["fill"] = _colour(line.get_markerfacecolor(), line.get_alpha())
        look["colour"] = _colour(line.get_markeredgecolor(), line.get_alpha())
    return look


def _shapes(axes: Axes, named: Sequence[Line2D]) -> Iterable[Json]:
    """Reads everything that is not a series, from the lowest to the topmost."""
    lines = [line for line in axes.lines if line not in named]
    artists: list[Artist] = [*axes.patches, *axes.collections, *lines]
    for artist in sorted(artists, key=lambda one: one.get_zorder()):
        if not artist.get_visible():
            continue
        if isinstance(artist, Line2D):
            yield from _line_shapes(artist, axes)
        elif isinstance(artist, Rectangle | Polygon):
            yield _area(artist, axes)
        elif isinstance(artist, LineCollection):
            yield _segments(artist)
        else:
            raise NoChartError(f"{type(artist).__name__} cannot be drawn as a chart")


def _line_shapes(line: Line2D, axes: Axes) -> Iterable[Json]:
    x, y = _data(line)
    if not x.size:
        return
    look = _look(line)
    in_x, in_y = line.get_transform().contains_branch_seperately(axes.transData)
    place: Json = {"x": ["low", "high"], "y": ["low", "high"]}
    if in_x:
        place["x"] = _numbers(x)
    if in_y:
        place["y"] = _numbers(y)
    if look["joined"]:
        place["stroke"] = _colour(line.get_color(), line.get_alpha())
        yield {**place, "width": look["width"], "dash": look.get("dash")}
    if "mark" in look:
        place["stroke"] = look["colour"]
        yield {**place, **{key: look[key] for key in ("mark", "size", "fill")}}


def _area(patch: Patch, axes: Axes) -> Json:
    """Reads a bar, a polygon, or a stripe from edge to edge."""
    outline = _outline(patch.get_path().transformed(patch.get_patch_transform()).vertices)
    in_data = patch.get_data_transform().contains_branch_seperately(axes.transData)
    for axis, inside in zip("xy", in_data, strict=True):
        if not inside:
            outline[axis] = ["low" if value < 0.5 else "high" for value in outline[axis]]
    outline["fill"] = _colour(patch.get_facecolor())
    outline["width"] = patch.get_linewidth()
    if outline["width"] > 0.0:
        outline["stroke"] = _colour(patch.get_edgecolor())
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
    return {**_outline(rows), "stroke": _colour(lines.get_color()[0]), "width": width}


def _keys(legend: Legend) -> list[Json]:
    """Reads name and look of each entry of a legend."""
    keys = []
    for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        key: Json = {"label": text.get_text()}
        if isinstance(handle, Line2D):
            key |= _look(handle)
        keys.append(key)
    return keys


def _colour(colour: Any, alpha: float | None = None) -> str | None:
    """Writes a colour as CSS text; None for none."""
    if isinstance(colour, str) and colour == "none":
        return None
    if alpha is not None:
        colour = (colour, alpha)
    return to_hex(colour, keep_alpha=True).removesuffix("ff")


def _numbers(values: Iterable[float], digits: int = 6) -> list[float | None]:
    """Rounds to as many digits as a chart can show; None for what is not finite."""
    numbers = (float(f"{value:.{digits}g}") for value in values)
    return [number if math.isfinite(number) else None for number in numbers]
