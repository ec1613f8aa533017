"""What a fit leaves in its folder: one CSV row per fit, the whole results as YAML, figures as PNG,
one HTML page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aerodima.optimisation.identify.fit_figures import figures_of
from aerodima.optimisation.identify.fit_pipeline import Estimate, FitResult, short_name
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.view.report_page import (
    Bullets,
    Content,
    Finding,
    Link,
    Page,
    Section,
    Table,
    write_files,
    zoomable,
)

SCHEMA = "aerodima/fit-report/1"
_MOST_DECIMALS = 9
"""Most decimals of a number that is not written as a power of ten."""
_LEAST_SHARE = 0.01
"""Least share of a variance that is shown."""


def write_report(
    folder: Path,
    title: str,
    results: Sequence[FitResult],
    *,
    failed: Mapping[str, str] | None = None,
    tables: Mapping[str, pd.DataFrame] | None = None,
    left_out: Sequence[str] = (),
) -> list[Path]:
    """Writes `fits.csv`, `fits.yaml`, `*.png` and `report.html`; files of an earlier report are
    replaced.

    Args:
        failed: logs that could not be fitted, with the reason.
        tables: further tables by name, each also written as `<name>.csv` and into the YAML.
        left_out: a line for each further table that could not be made.

    Returns:
        The files written.
    """
    failed = dict(failed or {})
    tables = dict(tables or {})
    budget = budget_table(results)
    plots = {
        name: zoomable(figure, "", _heading(name)) for name, figure in figures_of(results).items()
    }
    written = {
        "schema": SCHEMA,
        "title": title,
        "versions": software_versions(),
        "notes": list(left_out),
        "failed": failed,
        "tables": {name: table.to_dict("records") for name, table in tables.items()},
        "fits": [_plain(result) for result in results],
    }
    warned = [
        f"{result.name}: {'; '.join(result.warnings)}" for result in results if result.warnings
    ]
    findings = {
        f"{len(failed)} could not be fitted": [
            f"{name}: {reason}" for name, reason in failed.items()
        ],
        "Left out": left_out,
        "Warnings": warned,
    }
    sections = [
        Section(head, [Finding([Bullets(lines)])]) for head, lines in findings.items() if lines
    ]
    sections += [
        Section("Results", [_estimates(results)]),
        Section("Fits", [_frame(_facts(results))]),
    ]
    if len(budget):
        shares = budget.drop(columns="fit").groupby("parameter", sort=False).median()
        shown = (
            (100.0 * shares.loc[:, shares.max() >= _LEAST_SHARE]).round().astype(int).reset_index()
        )
        words = (
            "Percent of the variance, median over the fits; the rig's constants by its section "
            "uncertainty. Noise "
            "counts more than with exact constants, since the log helps to find them, too. Per "
            "fit in"
        )
        sections.append(
            Section("What the intervals are made of", [(words, Link("budget.csv")), _frame(shown)])
        )
    rig = pd.DataFrame(
        [(key, value) for r in results for key, value in r.rig.items()], columns=["key", "value"]
    )
    if len(rig):
        sections.append(
            Section("What of the rig is not as in models/", [_frame(rig.drop_duplicates())])
        )
    for name, table in tables.items():
        sections.append(
            Section(_heading(name), [_frame(table), ("The same in", Link(f"{name}.csv"))])
        )
    sections += [Section(plot.alternative, [plot]) for plot in plots.values()]
    contents: dict[str, Content] = {
        "fits.csv": pd.DataFrame([result.row() for result in results]),
        "fits.yaml": yaml.safe_dump(
            _numbers(written), sort_keys=False, allow_unicode=True, width=120
        ),
        **({"budget.csv": budget} if len(budget) else {}),
        **{f"{name}.csv": table for name, table in tables.items()},
        "report.html": Page(title, "", sections),
        **{f"{name}.png": plot.data for name, plot in plots.items()},
    }
    return write_files(folder, contents, error=FitError)


def budget_table(results: Sequence[FitResult]) -> pd.DataFrame:
    """Shares of the variance of every determined parameter: a row each, a column for noise and each
    constant.
    """
    rows = [
        {
            "fit": short_name(result.name),
            "parameter": name,
            **{key: round(share, 4) for key, share in shares.items()},
        }
        for result in results
        for name, shares in result.budget.items()
    ]
    return pd.DataFrame(rows).fillna(0.0)


def _plain(result: FitResult) -> dict[str, Any]:
    content = asdict(result)
    del content["curves"]
    return {
        {"unidentifiable": "not_determined"}.get(key, key): value for key, value in content.items()
    }


def _numbers(value: Any) -> Any:
    """Plain Python values all the way down."""
    if isinstance(value, Mapping):
        return {str(key): _numbers(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_numbers(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value


def _heading(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _estimates(results: Sequence[FitResult]) -> Table:
    """A row per fit and parameter."""
    rows = [
        [
            short_name(r.name),
            e.name,
            format_estimate(e),
            _short(e.standard_deviation),
            _short(e.noise_deviation),
            e.unit,
        ]
        for r in results
        for e in r.estimates
    ]
    heads = [
        "fit",
        "quantity",
        "value (95 % interval)",
        "standard deviation",
        "with exact constants",
        "unit",
    ]
    return Table(heads, rows)


def _facts(results: Sequence[FitResult]) -> pd.DataFrame:
    """A row per fit: what was fitted, how large the residuals are, how the search ended."""
    rows = [
        {
            "fit": short_name(r.name),
            **r.facts,
            **{f"rms of {k}": v for k, v in r.residual_rms.items()},
            "end": r.status,
        }
        for r in results
    ]
    return pd.DataFrame(rows).fillna("")


def _frame(table: pd.DataFrame) -> Table:
    return Table(
        list(map(str, table.columns)),
        [[_short(value) for value in row] for row in table.to_numpy(object)],
    )


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def format_estimate(estimate: Estimate, unit: bool = False) -> str:
    """Value and interval in one cell; with the unit on request."""
    if not estimate.identifiable:
        return "not determined"
    if unit and estimate.unit != "1":
        behind = f" {estimate.unit}"
    else:
        behind = ""
    if estimate.frozen:
        return f"{estimate.value:.5g}{behind} (frozen)"
    digits = _digits(estimate.upper - estimate.lower)
    value, low, high = (
        f"{number:{digits}}" for number in (estimate.value, estimate.lower, estimate.upper)
    )
    text = f"{value} ({low} .. {high}){behind}"
    if estimate.bound:
        return f"{text}, one-sided: at its {estimate.bound} bound"
    return text


def _digits(width: float) -> str:
    """Format of numbers whose interval is that wide: it keeps two digits."""
    if not (0.0 < width < math.inf):
        return ".6g"
    decimals = 1 - math.floor(math.log10(width))
    if decimals <= _MOST_DECIMALS:
        return f".{max(decimals, 0)}f"
    return ".6g"
