"""The files of a fit: one CSV row per fit, the whole results as YAML, figures as PNG, one HTML
page.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aerodima.optimisation.identify.fit_figures import figures_of
from aerodima.optimisation.identify.fit_result import Estimate, FitResult, short_name
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Json
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
_MAX_DECIMALS = 9
"""Largest number of decimals of a number that is not written as a power of ten."""
_MIN_SHARE = 0.01
"""Smallest share of a variance that is shown."""
_BUDGET_TEXT = (
    "Percent of the variance, median over the fits; the rig's constants by its section "
    "uncertainty. Noise counts more than with exact constants, since the log helps to find them, "
    "too. Per fit in"
)


def write_report(
    folder: Path,
    title: str,
    results: Sequence[FitResult],
    *,
    failed: Mapping[str, str] | None = None,
    tables: Mapping[str, pd.DataFrame] | None = None,
    left_out: Sequence[str] = (),
) -> list[Path]:
    """Write `fits.csv`, `fits.yaml`, `*.png` and `report.html`; files of an earlier report are
    replaced.

    Args:
        failed: reason why a log could not be fitted, by log.
        tables: further tables by name, each also written as `<name>.csv` and into the YAML.
        left_out: lines about further tables that could not be made, one each.

    Returns:
        Paths of the files written.
    """
    failed = dict(failed or {})
    tables = dict(tables or {})
    budget = budget_table(results)
    whole = {
        "schema": SCHEMA,
        "title": title,
        "versions": software_versions(),
        "notes": list(left_out),
        "failed": failed,
        "tables": {name: table.to_dict("records") for name, table in tables.items()},
        "fits": [_plain(result) for result in results],
    }
    # NumPy's numbers and tuples become plain numbers and lists on their way through JSON.
    plain = json.loads(json.dumps(whole, default=np.generic.item))
    sections = [
        *_findings(results, failed, left_out),
        Section("Results", [_estimates(results)]),
        Section("Fits", [_frame(_facts(results))]),
        *_origins(results, budget),
    ]
    contents: dict[str, Content] = {
        "fits.csv": pd.DataFrame([result.row() for result in results]),
        "fits.yaml": yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=120),
    }
    if len(budget):
        contents["budget.csv"] = budget
    for name, table in tables.items():
        link = "The same in", Link(f"{name}.csv")
        sections.append(Section(_heading(name), [_frame(table), link]))
        contents[f"{name}.csv"] = table
    for name, figure in figures_of(results).items():
        plot = zoomable(figure, _heading(name))
        sections.append(Section(plot.alternative, [plot]))
        contents[f"{name}.png"] = plot.data
    contents["report.html"] = Page(title, "", sections)
    return write_files(folder, contents, error=FitError)


def _findings(
    results: Sequence[FitResult], failed: Mapping[str, str], left_out: Sequence[str]
) -> list[Section]:
    """Make sections of failed logs, tables that are left out, and warnings."""
    findings = {
        f"{len(failed)} could not be fitted": [f"{log}: {text}" for log, text in failed.items()],
        "Left out": left_out,
        "Warnings": [f"{r.name}: {'; '.join(r.warnings)}" for r in results if r.warnings],
    }
    return [Section(head, [Finding([Bullets(lines)])]) for head, lines in findings.items() if lines]


def _origins(results: Sequence[FitResult], budget: pd.DataFrame) -> list[Section]:
    """Make sections of shares of the variances, and of rig values that differ from `models/`."""
    sections = []
    if len(budget):
        shares = budget.drop(columns="fit").groupby("parameter", sort=False).median()
        shown = 100.0 * shares.loc[:, shares.max() >= _MIN_SHARE]
        percent = _frame(shown.round().astype(int).reset_index())
        link = _BUDGET_TEXT, Link("budget.csv")
        sections.append(Section("What the intervals are made of", [link, percent]))
    rig = [(key, value) for result in results for key, value in result.rig.items()]
    if rig:
        table = pd.DataFrame(rig, columns=["key", "value"]).drop_duplicates()
        sections.append(Section("What of the rig is not as in models/", [_frame(table)]))
    return sections


def budget_table(results: Sequence[FitResult]) -> pd.DataFrame:
    """Tabulate shares of the variance of every determined parameter: a row for each, with a column
    for noise and for each constant.
    """
    rows = []
    for result in results:
        for name, shares in result.budget.items():
            row = {"fit": short_name(result.name), "parameter": name}
            rows.append(row | {key: round(share, 4) for key, share in shares.items()})
    return pd.DataFrame(rows).fillna(0.0)


def _plain(result: FitResult) -> Json:
    """Make the content of the YAML file for one fit; the order of its keys is fixed."""
    content = asdict(result)
    del content["curves"]
    renamed = {"unidentifiable": "not_determined"}
    return {renamed.get(key, key): value for key, value in content.items()}


def _heading(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _estimates(results: Sequence[FitResult]) -> Table:
    """Tabulate a row per fit and parameter."""
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
    """Tabulate a row per fit: facts of the data, size of the residuals, and how the search
    ended.
    """
    rows = [
        {
            "fit": short_name(r.name),
            **r.facts,
            **{f"rms of {channel}": value for channel, value in r.residual_rms.items()},
            "end": r.status,
        }
        for r in results
    ]
    return pd.DataFrame(rows).fillna("")


def _frame(table: pd.DataFrame) -> Table:
    rows = [list(map(_short, row)) for row in table.to_numpy(object)]
    return Table(list(map(str, table.columns)), rows)


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def format_estimate(estimate: Estimate, unit: bool = False) -> str:
    """Format value and interval for one cell; with the unit on request."""
    if not estimate.identifiable:
        return "not determined"
    behind = f" {estimate.unit}" if unit and estimate.unit != "1" else ""
    if estimate.frozen:
        return f"{estimate.value:.5g}{behind} (frozen)"
    above = estimate.upper - estimate.value
    below = estimate.value - estimate.lower
    digits = _digits(above + below if above < math.inf else below)
    interval = f"{estimate.lower:{digits}} .. {estimate.upper:{digits}}"
    text = f"{estimate.value:{digits}} ({interval}){behind}"
    if estimate.bound:
        return f"{text}, one-sided: at its {estimate.bound} bound"
    return text


def _digits(width: float) -> str:
    """Return a number format for an interval of this width, which keeps two of its digits."""
    if 0.0 < width < math.inf:
        decimals = 1 - math.floor(math.log10(width))
        if decimals <= _MAX_DECIMALS:
            return f".{max(decimals, 0)}f"
    return ".6g"
