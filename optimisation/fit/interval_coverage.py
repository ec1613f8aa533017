"""How often the intervals of fits hold the truth, over logs that know it (simulated ones, see `rig campaign`)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from aerodima.optimisation.fit.fit_batch import fitted_logs
from aerodima.optimisation.fit.fit_errors import FitError
from aerodima.workbench.logs.schema import decode_metadata

POOLED = "all"


def truth_in(log: Path) -> dict[str, float]:
    """Parameter -> truth of a log; empty when the log does not know it. Reads the metadata alone.

    Raises:
        FitError: the log is not there any more, or is no log.
    """
    try:
        metadata = decode_metadata(pq.read_schema(log).metadata, str(log))
    except (OSError, pa.ArrowException) as error:
        raise FitError(f"{log}: cannot be read: {error}") from None
    truth = metadata.get("extra", {}).get("truth", {})
    return {str(name): float(value) for name, value in truth.items()}


def coverage(folder: Path) -> pd.DataFrame:
    """Of the fits in a folder: one row per parameter, and one of all together.

    Returns:
        parameter; fits whose log knows its truth; identifiable, how many of them determine it; held, how many of those
        intervals hold the truth; coverage = held / identifiable; score_deviation, the standard deviation of
        (value - truth) / standard deviation, about 1 when the intervals are neither too wide nor too narrow.

    Raises:
        FitError: no fits there, or none of a log that knows its truth.
    """
    rows = []
    for log, result in fitted_logs(folder):
        truth = truth_in(Path(log))
        for estimate in result.free:
            if estimate.name in truth:
                value = truth[estimate.name]
                known = estimate.identifiable and estimate.standard_deviation > 0.0
                score = (estimate.value - value) / estimate.standard_deviation if known else float("nan")
                rows.append((estimate.name, estimate.identifiable, estimate.holds(value), score))
    if not rows:
        raise FitError(f"{folder}: none of its logs knows the truth of what was fitted; simulated ones do")
    table = pd.DataFrame(rows, columns=["parameter", "identifiable", "held", "score"])
    names = [*dict.fromkeys(table.parameter), POOLED]
    return pd.DataFrame([_row(name, table if name == POOLED else table[table.parameter == name]) for name in names])


def _row(name: str, part: pd.DataFrame) -> dict[str, object]:
    seen = part[part.identifiable]
    return {
        "parameter": name,
        "fits": len(part),
        "identifiable": len(seen),
        "held": int(seen.held.sum()),
        "coverage": float(seen.held.mean()) if len(seen) else float("nan"),
        "score_deviation": float(seen.score.std()) if len(seen) > 1 else float("nan"),
    }
