"""A table for the terminal."""

from collections.abc import Sequence
from typing import Any

_NOTHING = 1e-12
"""Rounding of a sum that is zero; shown as such."""


def shown_value(value: Any) -> str:
    """A cell of a table: four digits, a dash for what is not known, `none` for an empty text."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{0.0 if abs(value) < _NOTHING else value:.4g}"
    if value == "":
        return "none"
    return str(value)


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table with columns as wide as they need to be; a row of one cell is a heading."""
    whole = [row for row in (header, *rows) if len(row) > 1]
    widths = [max(map(len, column)) for column in zip(*whole, strict=True)]
    return [
        row[0] if len(row) == 1 else "  ".join(map(str.ljust, row, widths)).rstrip()
        for row in (header, *rows)
    ]
