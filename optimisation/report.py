"""What a fit leaves in its folder: one CSV row per fit, the whole results as YAML, figures as PNG, one HTML page."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from optimisation.errors import FitError
from optimisation.pipeline import Estimate, FitResult
from workbench.atomic_write import make_folder
from workbench.logs.schema import software_versions
from workbench.plots.overlay import RUN_STYLES

SCHEMA = "aerodima/fit-report/1"
_MOST_CURVES = 12
"""Panels of the figure in which logs with one curve each are drawn together."""
_MOST_FIGURES = 8
"""Logs with several curves have a figure of their own; that many are drawn."""
_MOST_NAMED = 16
_EXACT = 1e-9
"""Residuals below this are rounding."""
_MODEL_STYLES = (RUN_STYLES[2], *RUN_STYLES[1:2], RUN_STYLES[0], *RUN_STYLES[3:])
"""Blue dots first, vermilion dashes over them: told apart without colour."""
_LONG = 40
"""Cells of more characters than this may wrap."""
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem;color:#1b1f24}"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:1rem 0}"
    "th,td{border-bottom:1px solid #d0d7de;padding:.25rem .7rem;text-align:right}"
    "td{white-space:nowrap}th:first-child,td:first-child,td.words{text-align:left}"
    "td.words{white-space:normal;min-width:20rem}"
    ".table{overflow-x:auto}table{border:0}img{max-width:100%}.warn{color:#9a3412}"
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
        tables: further tables by name, each also written as `<name>.csv` and into the YAML.
        notes: paragraphs above the results.

    Returns:
        The files written.
    """
    make_folder(folder, FitError)
    failed, tables = dict(failed or {}), dict(tables or {})
    paths = [folder / "fits.csv", folder / "fits.yaml"]
    pd.DataFrame([result.row() for result in results]).to_csv(paths[0], index=False)
    paths[1].write_text(_yaml(title, results, failed, notes, tables), encoding="utf-8")
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
        figures["estimates"] = plot_estimates(results)
        figures["residuals"] = _residuals_figure(results)
    single = [result for result in results if len(result.curves) == 1]
    if single:
        figures["curves"] = _curves_figure([(r, name, curve) for r in single for name, curve in r.curves.items()])
    several = [result for result in results if len(result.curves) > 1]
    for number, result in enumerate(several[:_MOST_FIGURES], start=1):
        figures[f"curves_{number}_{Path(result.name).stem}"] = plot_curves(result)
    return figures


def plot_curves(result: FitResult) -> Figure:
    """Measured and model of one fit: a panel per curve that the fit kept, such as the angle and each reaction."""
    return _curves_figure([(None, name, curve) for name, curve in result.curves.items()], Path(result.name).name)


def plot_estimates(results: Sequence[FitResult]) -> Figure:
    """Every free parameter over the fits, with its interval; what is not determined is left out."""
    names = list(dict.fromkeys(e.name for result in results for e in result.free if not e.name.startswith("start_")))
    units = {e.name: e.unit for result in results for e in result.free}
    figure = Figure(figsize=(10.0, 1.9 * len(names) + 1.2), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        found = [(i, e) for i, result in enumerate(results) for e in result.free if e.name == name and e.identifiable]
        if found:
            x = [i for i, _ in found]
            values = np.array([e.value for _, e in found])
            low = np.maximum(values - [e.lower for _, e in found], 0.0)
            high = np.maximum([e.upper for _, e in found] - values, 0.0)
            ax.errorbar(x, values, yerr=[low, high], fmt="o", ms=3.5, capsize=2, color="#0f5c8a", ecolor="#7fb3d3")
            ax.ticklabel_format(axis="y", useOffset=False)
        else:
            ax.text(0.5, 0.5, "not determined in any fit", transform=ax.transAxes, ha="center", color="#9a3412")
            ax.set_yticks([])
        ax.set_ylabel(name if units[name] == "1" else f"{name} [{units[name]}]", fontsize=8)
        ax.grid(alpha=0.3)
    _name_fits(axes[-1], results)
    figure.suptitle("estimates with their 95 % intervals", fontsize=10)
    return figure


def _name_fits(ax: Axes, results: Sequence[FitResult]) -> None:
    """The fits along the x axis: by name while there is room, else by their place in the table."""
    ax.set_xlim(-0.5, len(results) - 0.5)
    if len(results) > _MOST_NAMED:
        ax.set_xlabel("fit, in the order of the table (from 0)")
        return
    ax.set_xticks(range(len(results)), [Path(result.name).stem for result in results], rotation=20, ha="right")
    ax.tick_params(axis="x", labelsize=8)


def _residuals_figure(results: Sequence[FitResult]) -> Figure:
    """Root mean square per channel and fit; a channel that a fit meets exactly has no mark."""
    channels = list(dict.fromkeys(name for result in results for name in result.residual_rms))
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    ax = figure.subplots()
    for channel in channels:
        rms = [result.residual_rms.get(channel, math.nan) for result in results]
        y = [value if value > _EXACT else math.nan for value in rms]
        ax.plot(range(len(results)), y, "o" if len(results) < 100 else ".", ms=4, label=channel)
    ax.set_yscale("log")
    _name_fits(ax, results)
    ax.set_ylabel("rms residual, SI unit of the channel")
    ax.grid(alpha=0.3)
    if channels:
        ax.legend(ncols=len(channels), fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def _curves_figure(curves: Sequence[tuple[FitResult | None, str, Mapping[str, Any]]], title: str = "") -> Figure:
    """Measured and model, one panel per curve; `measured` may be missing. The panel is named after the log, if told."""
    more, curves = len(curves) - _MOST_CURVES, curves[:_MOST_CURVES]
    columns = min(3, len(curves))
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(5.0 * columns, 3.6 * rows), layout="constrained")
    places = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax in places[len(curves) :]:
        ax.set_axis_off()
    for ax, (result, name, curve) in zip(places, curves, strict=False):
        x = np.asarray(curve["x"])
        if "measured" in curve:
            ax.plot(x, curve["measured"], "." if len(x) <= 200 else "-", color="#9a9a9a", lw=2.4, label="measured")
        models = [label for label in curve if label not in ("x", "measured", "labels")]
        for label, (colour, line) in zip(models, cycle(_MODEL_STYLES)):
            ax.plot(x, curve[label], lw=1.3, color=colour, linestyle=line, label=label)
        ax.set_title(name if result is None else f"{Path(result.name).name}: {name}", fontsize=9)
        labels = curve.get("labels", ("x", name))
        ax.set_xlabel(labels[0])
        ax.set_ylabel(labels[1])
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    if title or more > 0:
        figure.suptitle(title or f"the first {_MOST_CURVES} of {_MOST_CURVES + more} logs")
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
            _table(list(map(str, table.columns)), [[_short(value) for value in row] for row in table.to_numpy(object)]),
        ]
    for name, data in pictures.items():
        code = base64.b64encode(data).decode()
        parts.append(f'<h2>{name}</h2><img alt="{name}" src="data:image/png;base64,{code}">')
    return "\n".join(parts) + "</html>\n"


def _results_table(results: Sequence[FitResult]) -> str:
    names = list(dict.fromkeys(e.name for result in results for e in result.estimates))
    units = {e.name: e.unit for result in results for e in result.estimates}
    facts = list(dict.fromkeys(key for result in results for key in result.facts))
    heads = ["fit", *(f"{name} [{units[name]}]" for name in names), *facts, "status"]
    rows = []
    for result in results:
        by_name = {e.name: e for e in result.estimates}
        cells = [Path(result.name).name, *(in_words(by_name[name]) if name in by_name else "" for name in names)]
        rows.append([*cells, *(_short(result.facts.get(fact, "")) for fact in facts), result.status])
    return _table(heads, rows)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """An HTML table that scrolls sideways when it is wide; long text may wrap."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(_cell(text) for text in row) + "</tr>" for row in rows)
    return f'<div class="table"><table><tr>{head}</tr>{body}</table></div>'


def _cell(text: str) -> str:
    words = ' class="words"' if len(text) > _LONG else ""
    return f"<td{words}>{html.escape(text)}</td>"


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def in_words(estimate: Estimate, unit: bool = False) -> str:
    """Value and interval in one cell; with the unit on request."""
    if not estimate.identifiable:
        return "not determined"
    behind = f" {estimate.unit}" if unit and estimate.unit != "1" else ""
    if estimate.frozen:
        return f"{estimate.value:.5g}{behind} (frozen)"
    text = f"{estimate.value:.5g} ({estimate.lower:.4g} .. {estimate.upper:.4g}){behind}"
    return f"{text}, one-sided: at its {estimate.bound} bound" if estimate.bound else text
