"""Text tables for the terminal."""

from collections.abc import Iterable, Sequence
from typing import Any

_ZERO_TOLERANCE = 1e-12
"""Magnitude below which a value is zero but for rounding and is shown as 0."""


def shown_value(value: Any) -> str:
    """Format a cell: four digits, a dash for an unknown value, `none` for an empty text."""
    if value is None or value != value:  # NaN
        return "–"
    if isinstance(value, float):
        return f"{0.0 if abs(value) < _ZERO_TOLERANCE else value:.4g}"
    if value == "":
        return "none"
    return str(value)


def value_rows(rows: Iterable[tuple[Any, Iterable[Any]]]) -> list[list[str]]:
    """Format rows that each consist of a name and its values."""
    return [[str(name), *map(shown_value, values)] for name, values in rows]


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Format a table with columns as wide as they need to be; a row of one cell is a heading."""
    whole = [row for row in (header, *rows) if len(row) > 1]
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    return [
        row[0] if len(row) == 1 else "  ".join(map(str.ljust, row, widths)).rstrip()
        for row in (header, *rows)
    ]
