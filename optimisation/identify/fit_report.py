"""What a fit leaves in its folder: one CSV row per fit, the whole results as YAML, figures as PNG, one HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure

from aerodima.optimisation.identify.fit_figures import figures_of
from aerodima.optimisation.identify.fit_pipeline import Estimate, FitResult, parameter_names, short_name
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.report.report_page import (
    Bullets,
    Content,
    Finding,
    Link,
    Page,
    Part,
    Plot,
    Section,
    Table,
    write_files,
    zoomable,
)

SCHEMA = "aerodima/fit-report/1"
_FEW = 2
_MOST_DECIMALS = 9
_LEAST_SHARE = 0.01
"""Of a variance, that is shown."""
_HEADINGS = {
    "estimates": "Estimates over the fits",
    "residuals": "Residuals over the fits",
    "curves": "Measured and model",
    "averages": "Averages over the logs",
    "areas": "Likelihood of an area, all else free",
    "variants": "One choice made otherwise: 95 % upper bounds",
    "nuisances": "One parameter held in a fifth of its prior: 95 % upper bounds",
    "swings": "Published and simulated tail speed of every swing",
    "tail_speeds": "Published and simulated tail speeds over wind",
}
"""Table or figure -> heading; the others are headed by their name."""


def write_report(
    folder: Path,
    title: str,
    results: Sequence[FitResult],
    *,
    failed: Mapping[str, str] | None = None,
    tables: Mapping[str, pd.DataFrame] | None = None,
    notes: Sequence[str] = (),
    figures: Mapping[str, Figure] | None = None,
) -> list[Path]:
    """Writes `fits.csv`, `fits.yaml`, `*.png` and `report.html`; files of an earlier report are replaced.

    Args:
        failed: logs that could not be fitted, with the reason.
        tables: further tables by name, each also written as `<name>.csv` and into the YAML.
        notes: paragraphs above the results.
        figures: further figures by name.

    Returns:
        The files written.
    """
    failed, tables = dict(failed or {}), dict(tables or {})
    budget = budget_table(results)
    plots = {
        name: zoomable(figure, "", _heading(name))
        for name, figure in {**figures_of(results), **(figures or {})}.items()
    }
    contents: dict[str, Content] = {
        "fits.csv": pd.DataFrame([result.row() for result in results]),
        "fits.yaml": _yaml(title, results, failed, notes, tables),
        **({"budget.csv": budget} if len(budget) else {}),
        **{f"{name}.csv": table for name, table in tables.items()},
        "report.html": _page(title, results, failed, tables, notes, plots),
        **{f"{name}.png": plot.data for name, plot in plots.items()},
    }
    return write_files(folder, contents, error=FitError)


def _yaml(
    title: str,
    results: Sequence[FitResult],
    failed: Mapping[str, str],
    notes: Sequence[str],
    tables: Mapping[str, pd.DataFrame],
) -> str:
    content = {
        "schema": SCHEMA,
        "title": title,
        "versions": software_versions(),
        "notes": list(notes),
        "failed": dict(failed),
        "tables": {name: table.to_dict("records") for name, table in tables.items()},
        "fits": [_plain(result) for result in results],
    }
    return yaml.safe_dump(_numbers(content), sort_keys=False, allow_unicode=True, width=120)


def _plain(result: FitResult) -> dict[str, Any]:
    content = {
        key: getattr(result, key)
        for key in ("name", "facts", "success", "status", "cost", "effective_samples", "residual_rms")
    }
    content["estimates"] = [asdict(estimate) for estimate in result.estimates]
    content |= {"covariance": result.covariance, "not_determined": result.unidentifiable, "warnings": result.warnings}
    content |= {"rig": dict(result.rig), "budget": result.budget, "constants": result.constants}
    return content | {"attempts": result.attempts}


def _numbers(value: Any) -> Any:
    """Plain Python values all the way down."""
    if isinstance(value, Mapping):
        return {str(key): _numbers(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_numbers(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value


def _page(
    title: str,
    results: Sequence[FitResult],
    failed: Mapping[str, str],
    tables: Mapping[str, pd.DataFrame],
    notes: Sequence[str],
    plots: Mapping[str, Plot],
) -> Page:
    sections = [Section("Notes", notes)] if notes else []
    if failed:
        reasons = [f"{name}: {reason}" for name, reason in failed.items()]
        sections.append(Section(f"{len(failed)} could not be fitted", [Finding([Bullets(reasons)])]))
    if results:
        sections.append(Section("Results", [_results_table(results)]))
    warned = [f"{result.name}: {'; '.join(result.warnings)}" for result in results if result.warnings]
    if warned:
        sections.append(Section("Warnings", [Finding([Bullets(warned)])]))
    sections += [*_budget(results), *_rig(results)]
    for name, table in tables.items():
        sections.append(Section(_heading(name), [_frame(table), ("The same in", Link(f"{name}.csv"))]))
    sections += [Section(plot.alternative, [plot]) for plot in plots.values()]
    return Page(title, "", sections)


def budget_table(results: Sequence[FitResult]) -> pd.DataFrame:
    """Shares of the variance of every determined parameter: a row each, a column for noise and each constant."""
    rows = [
        {"fit": short_name(result.name), "parameter": name, **{key: round(share, 4) for key, share in shares.items()}}
        for result in results
        for name, shares in result.budget.items()
    ]
    return pd.DataFrame(rows).fillna(0.0)


def _budget(results: Sequence[FitResult]) -> list[Section]:
    """What the intervals are made of: per parameter the median of the shares over the fits, in percent."""
    table = budget_table(results)
    if not len(table):
        return []
    shares = table.drop(columns="fit").groupby("parameter", sort=False).median()
    seen = shares.loc[:, shares.max() >= _LEAST_SHARE]
    rows = [[str(name), *(f"{100.0 * value:.0f} %" for value in row)] for name, row in seen.iterrows()]
    words = (
        "Share of the variance that noise and each uncertain constant of the rig have, median over the fits. The "
        "uncertainties are those of the scenario's section uncertainty; per fit in"
    )
    parts: list[Part] = [(words, Link("budget.csv")), Table(["parameter", *map(str, seen.columns)], rows)]
    return [Section("What the intervals are made of", parts)]


def _rig(results: Sequence[FitResult]) -> list[Section]:
    """What of the rig was not that of `models/`, over all fits."""
    known: dict[str, dict[str, None]] = {}
    for result in results:
        for key, value in result.rig.items():
            known.setdefault(key, {})[_short(value)] = None
    rows = [[key, ", ".join(values)] for key, values in known.items()]
    return [Section("What of the rig is not as in models/", [Table(["key", "value"], rows)])] if rows else []


def _heading(name: str) -> str:
    if name.startswith("curves_"):
        return f"Measured and model: {name.split('_', 2)[2]}"
    return _HEADINGS.get(name, name.replace("_", " "))


def _frame(table: pd.DataFrame) -> Table:
    """A further table; of a few wide rows each becomes a column, which needs no scrolling."""
    heads = list(map(str, table.columns))
    rows = [[_short(value) for value in row] for row in table.to_numpy(object)]
    if len(rows) > _FEW or len(heads) <= _FEW + 1:
        return Table(heads, rows)
    first, *turned = zip(heads, *rows, strict=True)
    return Table(first, turned)


def _results_table(results: Sequence[FitResult]) -> Table:
    """A row per fit; of a few fits a row per parameter, which needs no scrolling."""
    if len(results) <= _FEW:
        rows = [
            [short_name(result.name), e.name, format_estimate(e), "" if e.unit == "1" else e.unit]
            for result in results
            for e in result.estimates
        ]
        rows += [[short_name(r.name), key, _short(value), ""] for r in results for key, value in r.facts.items()]
        rows += [[short_name(r.name), "search ended", r.status, ""] for r in results]
        return Table(["fit", "quantity", "value (95 % interval)", "unit"], rows)
    names = parameter_names(results)
    units = {e.name: e.unit for result in results for e in result.estimates}
    facts = list(dict.fromkeys(key for result in results for key in result.facts))
    told = [name if units[name] == "1" else f"{name} [{units[name]}]" for name in names]
    heads = ["fit", *told, *facts, "search ended"]
    rows = []
    for result in results:
        by_name = {e.name: e for e in result.estimates}
        cells = [
            short_name(result.name),
            *(format_estimate(by_name[name]) if name in by_name else "" for name in names),
        ]
        rows.append([*cells, *(_short(result.facts.get(fact, "")) for fact in facts), result.status])
    return Table(heads, rows)


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def format_estimate(estimate: Estimate, unit: bool = False) -> str:
    """Value and interval in one cell; with the unit on request."""
    if not estimate.identifiable:
        return "not determined"
    behind = f" {estimate.unit}" if unit and estimate.unit != "1" else ""
    if estimate.frozen:
        return f"{estimate.value:.5g}{behind} (frozen)"
    digits = _digits(estimate.upper - estimate.lower)
    value, low, high = (f"{number:{digits}}" for number in (estimate.value, estimate.lower, estimate.upper))
    text = f"{value} ({low} .. {high}){behind}"
    return f"{text}, one-sided: at its {estimate.bound} bound" if estimate.bound else text


def _digits(width: float) -> str:
    """Format of numbers whose interval is that wide: it keeps two digits."""
    if not (0.0 < width < math.inf):
        return ".6g"
    decimals = 1 - math.floor(math.log10(width))
    return f".{max(decimals, 0)}f" if decimals <= _MOST_DECIMALS else ".6g"
