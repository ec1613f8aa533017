"""Columns of numbers from a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.workbench.errors import FitError


def read_columns(path: Path | str, columns: Sequence[str]) -> pd.DataFrame:
    """The named columns of a CSV file, in SI units as their names say.

    Raises:
        FitError: no such file, a column is missing, or a cell is not a finite number.
    """
    path = Path(path)
    if not path.is_file():
        raise FitError(f"{path}: no such file")
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as cause:
        raise FitError(f"{path}: cannot be read as CSV ({' '.join(str(cause).split())})") from cause
    missing = [name for name in columns if name not in table.columns]
    if missing:
        raise FitError(f"{path}: no column {', '.join(missing)}; there are {', '.join(map(str, table.columns))}")
    numbers = {}
    for name in columns:
        values = pd.to_numeric(table[name], errors="coerce").to_numpy(float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise FitError(
                f"{path}: column {name!r}: {table[name].iloc[bad[0]]!r} in row {bad[0]} is not a finite number"
            )
        numbers[name] = values
    return pd.DataFrame(numbers)
