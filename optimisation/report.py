"""What a fit leaves in its folder: one CSV row per fit, the whole results as YAML, figures as PNG, one HTML page."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import yaml

matplotlib.use("Agg")
from matplotlib.figure import Figure

from optimisation.errors import FitError
from optimisation.pipeline import Estimate, FitResult
from workbench.atomic_write import make_folder
from workbench.logs.schema import software_versions

SCHEMA = "aerodima/fit-report/1"
_MOST_CURVES = 12
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem;color:#1b1f24}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:1rem 0}"
    "th,td{border-bottom:1px solid #d0d7de;padding:.25rem .7rem;text-align:right}"
    "th:first-child,td:first-child{text-align:left}img{max-width:100%}.warn{color:#9a3412}"
)


def write_report(
    folder: Path,
    title: str,
    results: Sequence[FitResult],
    *,
    failed: Mapping[str, str] | None = None,
    tables: Mapping[str, pd.DataFrame] | None = None,
    notes: Sequence[str] = (),
) -> list[Path]:
    """Writes `fits.csv`, `fits.yaml`, `*.png` and `report.html`; files of an earlier report are replaced.

    Args:
        failed: logs that could not be fitted, with the reason.
        tables: further tables by name, each also written as `<name>.csv`.
        notes: paragraphs above the results.

    Returns:
        The files written.
    """
    make_folder(folder, FitError)
    failed, tables = dict(failed or {}), dict(tables or {})
    paths = [folder / "fits.csv", folder / "fits.yaml"]
    pd.DataFrame([result.row() for result in results]).to_csv(paths[0], index=False)
    paths[1].write_text(_yaml(title, results, failed, notes), encoding="utf-8")
    for name, table in tables.items():
        paths.append(folder / f"{name}.csv")
        table.to_csv(paths[-1], index=False)
    figures = _figures(results)
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        figure.savefig(paths[-1], dpi=110)
    paths.append(folder / "report.html")
    pictures = {name: (folder / f"{name}.png").read_bytes() for name in figures}
    paths[-1].write_text(_page(title, results, failed, tables, notes, pictures), encoding="utf-8")
    return paths


def _yaml(title: str, results: Sequence[FitResult], failed: Mapping[str, str], notes: Sequence[str]) -> str:
    content = {
        "schema": SCHEMA,
        "title": title,
        "versions": software_versions(),
        "notes": list(notes),
        "failed": dict(failed),
        "fits": [_plain(result) for result in results],
    }
    return yaml.safe_dump(_numbers(content), sort_keys=False, allow_unicode=True, width=120)


def _plain(result: FitResult) -> dict[str, Any]:
    content = {
        key: getattr(result, key)
        for key in ("name", "facts", "success", "status", "cost", "effective_samples", "residual_rms")
    }
    content["estimates"] = [asdict(estimate) for estimate in result.estimates]
    content |= {"covariance": result.covariance, "not_determined": result.unseen, "warnings": result.warnings}
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


def _figures(results: Sequence[FitResult]) -> dict[str, Figure]:
    figures = {}
    if results:
        figures["estimates"] = _estimates_figure(results)
        figures["residuals"] = _residuals_figure(results)
    curves = [(result, name, curve) for result in results for name, curve in result.curves.items()]
    if curves:
        figures["curves"] = _curves_figure(curves[:_MOST_CURVES])
    return figures


def _estimates_figure(results: Sequence[FitResult]) -> Figure:
    """Every free parameter over the fits, with its interval; what is not determined is left out."""
    names = list(dict.fromkeys(e.name for result in results for e in result.free))
    units = {e.name: e.unit for result in results for e in result.free}
    figure = Figure(figsize=(10.0, 2.2 * len(names) + 0.6), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=len(results) > 1, squeeze=False)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        found = [(i, e) for i, result in enumerate(results) for e in result.free if e.name == name and e.identifiable]
        if found:
            x = [i for i, _ in found]
            values = np.array([e.value for _, e in found])
            low = np.maximum(values - [e.lower for _, e in found], 0.0)
            high = np.maximum([e.upper for _, e in found] - values, 0.0)
            ax.errorbar(x, values, yerr=[low, high], fmt="o", ms=3.5, capsize=2, color="#0f5c8a", ecolor="#7fb3d3")
        ax.set_ylabel(f"{name} [{units[name]}]")
        ax.grid(alpha=0.3)
    axes[-1].set_xlabel("fit, in the order of the table (bars: 95 % interval)")
    return figure


def _residuals_figure(results: Sequence[FitResult]) -> Figure:
    channels = list(dict.fromkeys(name for result in results for name in result.residual_rms))
    figure = Figure(figsize=(10.0, 3.2), layout="constrained")
    ax = figure.subplots()
    for channel in channels:
        x = [i for i, result in enumerate(results) if channel in result.residual_rms]
        y = [max(results[i].residual_rms[channel], 1e-12) for i in x]
        ax.plot(x, y, "o-" if len(x) < 30 else ".", ms=4, lw=0.8, label=channel)
    ax.set_yscale("log")
    ax.set_xlabel("fit")
    ax.set_ylabel("rms residual, unit of the channel")
    ax.grid(alpha=0.3)
    if channels:
        ax.legend(ncols=len(channels), fontsize=8)
    return figure


def _curves_figure(curves: Sequence[tuple[FitResult, str, Mapping[str, Any]]]) -> Figure:
    """Measured and model, and their difference below."""
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(5.0 * columns, 3.6 * rows), layout="constrained")
    for ax, (result, name, curve) in zip(figure.subplots(rows, columns, squeeze=False).flat, curves, strict=False):
        x, measured = np.asarray(curve["x"]), np.asarray(curve["measured"])
        ax.plot(x, measured, "." if len(x) < 200 else "-", color="#7a7a7a", label="measured")
        for label, values in curve.items():
            if label not in ("x", "measured", "labels"):
                ax.plot(x, values, lw=1.2, label=label)
        ax.set_title(f"{Path(result.name).name}: {name}", fontsize=9)
        labels = curve.get("labels", ("x", name))
        ax.set_xlabel(labels[0])
        ax.set_ylabel(labels[1])
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    return figure


def _page(
    title: str,
    results: Sequence[FitResult],
    failed: Mapping[str, str],
    tables: Mapping[str, pd.DataFrame],
    notes: Sequence[str],
    pictures: Mapping[str, bytes],
) -> str:
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>',
        f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>",
        *(f"<p>{html.escape(note)}</p>" for note in notes),
    ]
    if failed:
        parts.append(f"<h2>{len(failed)} could not be fitted</h2><ul class=warn>")
        parts += [f"<li>{html.escape(name)}: {html.escape(reason)}</li>" for name, reason in failed.items()]
        parts.append("</ul>")
    if results:
        parts += ["<h2>Results</h2>", _results_table(results)]
        warned = [(result.name, result.warnings) for result in results if result.warnings]
        if warned:
            parts.append("<h2>Warnings</h2><ul class=warn>")
            parts += [f"<li>{html.escape(name)}: {html.escape('; '.join(words))}</li>" for name, words in warned]
            parts.append("</ul>")
    for name, table in tables.items():
        parts += [
            f"<h2>{html.escape(name.replace('_', ' '))}</h2>",
            table.to_html(index=False, float_format="{:.5g}".format),
        ]
    for name, data in pictures.items():
        code = base64.b64encode(data).decode()
        parts.append(f'<h2>{name}</h2><img alt="{name}" src="data:image/png;base64,{code}">')
    return "\n".join(parts) + "</html>\n"


def _results_table(results: Sequence[FitResult]) -> str:
    names = list(dict.fromkeys(e.name for result in results for e in result.estimates))
    units = {e.name: e.unit for result in results for e in result.estimates}
    facts = list(dict.fromkeys(key for result in results for key in result.facts))
    heads = ["fit", *facts, *(f"{name} [{units[name]}]" for name in names), "status"]
    rows = []
    for result in results:
        cells = [Path(result.name).name, *(_short(result.facts.get(fact, "")) for fact in facts)]
        by_name = {e.name: e for e in result.estimates}
        cells += [in_words(by_name[name]) if name in by_name else "" for name in names]
        rows.append([*cells, result.status])
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def in_words(estimate: Estimate) -> str:
    """Value and interval in one cell."""
    if estimate.frozen:
        return f"{estimate.value:.5g} (frozen)"
    if not estimate.identifiable:
        return "not determined"
    text = f"{estimate.value:.5g} ({estimate.lower:.4g} .. {estimate.upper:.4g})"
    return f"{text}, at its {estimate.bound} bound" if estimate.bound else text
