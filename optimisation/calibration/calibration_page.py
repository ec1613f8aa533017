"""The page of a calibration and its figures; every sentence with a number is made of the result."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from aerodima.optimisation.calibration.calibration import Calibration, member_frame
from aerodima.optimisation.calibration.calibration_plan import assumed_elsewhere, fitted_names
from aerodima.optimisation.calibration.identifiability import FLIP_SPEED, Direction
from aerodima.optimisation.calibration.validation import Shipped, Validated, ValidatedOutcome
from aerodima.workbench.config.ensemble import Ensemble
from aerodima.workbench.figures.figure_style import BLUE, GREY, ORANGE, VERMILION, new_figure, styled
from aerodima.workbench.metrics.published_values import SIGNALS
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Page,
    Part,
    Plot,
    Section,
    Table,
    metric_name,
    metric_unit,
    zoomable,
)

DETERMINED = 0.2
"""A combination counts as determined when its variance fell below this share of the prior's."""
CLOSE_Z = 2.0
"""A metric is counted as met when the published figure lies within this many standard deviations."""


def calibration_page(
    result: Calibration,
    ensemble: Ensemble,
    validated: Sequence[Validated],
    outcomes: Sequence[ValidatedOutcome],
    sensitivity: pd.DataFrame,
    parameters: pd.DataFrame,
    combinations: Sequence[Direction],
    shipped: Shipped,
) -> Page:
    """The whole page."""
    sections = (
        _outcome(result, ensemble),
        _validation(validated),
        _outcomes(outcomes),
        _parameters(result, parameters, shipped),
        _sensitivity(sensitivity),
        _directions(combinations),
    )
    lead = (
        f"{len(ensemble.members)} cars with tails that the fitted figures leave possible, effective sample size "
        f"{ensemble.effective_size:.0f}; {result.runs} runs, seed {result.plan.seed}."
    )
    return Page("Calibration of the car", lead, sections)


def _outcome(result: Calibration, ensemble: Ensemble) -> Section:
    draw, check = result.draw, result.check
    slow, fast = draw.target.speeds
    said = (
        f"Tailless: every member survives {slow:g} m/s and flips at {fast:g} m/s at the default step; at "
        f"{check.step:g} s that holds in {check.share:.0%} of the weight ({len(check.places)} members run).",
        f"{draw.drawn} cars were drawn; each of the {len(draw.weights)} that meet the bracket was run with "
        f"{draw.sampling.tails} tails, one of which, drawn by its likelihood, is its own.",
        f"Effective sample size {ensemble.effective_size:.0f}, needed {result.plan.size.enough:g}. "
        f"Best (most central) member: {ensemble.best.name}.",
        f"Fitted, so that agreement is no evidence: {', '.join(fitted_names(result.plan))}.",
    )
    return Section("What came out", [Finding(said)])


def _validation(validated: Sequence[Validated]) -> Section:
    header = ("place", "metric", "unit", "use", "published", "5 %", "median", "95 %", "z", "z, discrepancy", "survived")
    rows = [
        (
            v.source,
            metric_name(v.metric),
            metric_unit(v.metric),
            v.use,
            f"{v.published:.2f}",
            f"{v.low:.2f}",
            f"{v.median:.2f}",
            f"{v.high:.2f}",
            f"{v.z:+.1f}",
            f"{v.z_with_discrepancy:+.1f}",
            f"{v.survived:.0%}",
        )
        for v in validated
    ]
    tested = [v for v in validated if v.is_test]
    within = sum(abs(v.z) <= CLOSE_Z for v in tested)
    allowed = sum(abs(v.z_with_discrepancy) <= CLOSE_Z for v in tested)
    held_out = (
        f"Of the {len(tested)} figures that were held out, {within} lie within {CLOSE_Z:g} standard deviations "
        f"of the ensemble, {allowed} with the stated model discrepancy added."
    )
    parts: list[Part] = [
        Finding([held_out]),
        zoomable(plot_validation(validated), "Band of 90 % of the weight over the published figure.", "Validation"),
        Table(header, rows),
        "Fitted figures, and Kohut figures that follow from a fitted yaw rate, are no evidence. Tables 7.1 and "
        f"7.2 are compared with {SIGNALS['simulated']}; 7.3 and 7.4 with {SIGNALS['physical']}. Only runs that "
        "were survived have figures in this table; the weights take the figures of a tailed run whether it was "
        "survived or not.",
    ]
    return Section("Tables 7.1 to 7.4 and the lift of the inner wheels", parts)


def _outcomes(outcomes: Sequence[ValidatedOutcome]) -> Section:
    rows = [(o.claim, o.use, f"{o.share:.0%}", f"{o.tipped:.0%}") for o in outcomes]
    header = ("claim", "use", "of the weight", "tipped over before the turn")
    return Section("Published outcomes", [Table(header, rows)])


def _parameters(result: Calibration, parameters: pd.DataFrame, shipped: Shipped) -> Section:
    header = ("parameter", "prior", "5 %", "median", "95 %", "best", "learnt", "shipped", "z of shipped")
    rows = [
        (
            str(row["parameter"]),
            f"{float(row['prior_low']):g} to {float(row['prior_high']):g}",
            *(f"{float(row[name]):.4g}" for name in ("low", "median", "high", "best")),
            f"{float(row['learnt']):+.0%}",
            f"{float(row['shipped']):.4g}",
            f"{float(row['z_shipped']):+.1f}",
        )
        for row in parameters.to_dict("records")
    ]
    members, prior = member_frame(result), result.draw.prior
    half_track = prior.half_track(prior.values(result.draw.coordinates[result.kept]))
    density = (
        f"its posterior density is {shipped.relative_density:.2g} of that of the best member"
        if shipped.relative_density
        else "it misses the tailless bracket"
    )
    parts: list[Part] = [
        Plot(
            plot_posterior(parameters, members),
            "Weight of the members over the prior range; dotted: a flat prior; red: the best member.",
            "Histograms of all parameters",
        ),
        zoomable(
            plot_ratio(members, half_track),
            "What decides the flip: each dot a member, its size its weight.",
            "Friction",
        ),
        Table(header, rows),
        f"Shipped: the car of models/parameters, run as a member; {density}.",
        "Learnt: share of the variance of the plausible prior that the targets took away; negative values are "
        "scatter of the members, or a prior that the targets pull to one end.",
        f"Left at their value: {', '.join(assumed_elsewhere(result.plan))}.",
    ]
    return Section("Parameters", parts)


def _sensitivity(sensitivity: pd.DataFrame) -> Section:
    widest = float((sensitivity["total_high"] - sensitivity["total_low"]).max())
    drawn = Plot(
        plot_sensitivities(sensitivity),
        "Share of the variance of the target over the prior in which the parameter takes part (total Sobol index), "
        f"below it the share that it explains alone, %. Widest 95 % interval of a total index: {widest:.0%}.",
        "Sobol indices as a heat map",
    )
    return Section(
        "Which parameter decides each target",
        [
            drawn,
            "From the surrogates over the whole cube of the prior, implausible cars included; intervals are those of "
            "the sampling, without the errors of the surrogates. The height of the centre of mass varies as mu/SSF.",
        ],
    )


def _directions(combinations: Sequence[Direction]) -> Section:
    good = [d for d in combinations if d.ratio < DETERMINED]
    loose = [d for d in combinations if d.ratio >= DETERMINED]
    parts: list[Part] = [
        f"{len(good)} of {len(combinations)} combinations are determined (variance below {DETERMINED:.0%} of the "
        f"prior's); the other {len(loose)} are not identifiable from these targets.",
        zoomable(plot_directions(combinations), "Eigenvalues of the covariance against the prior's.", "Eigenvalues"),
        "Determined:",
        Bullets([f"{d.words} (variance × {d.ratio:.3f})" for d in good] or ["none"]),
        "Not identifiable, least first:",
        Bullets([f"{d.words} (variance × {d.ratio:.2f})" for d in reversed(loose)]),
    ]
    return Section("Which combinations the data determine", parts)


COLUMNS = 5
BINS = 12
"""Panels per row; bars per histogram."""


def plot_posterior(parameters: pd.DataFrame, members: pd.DataFrame) -> Figure:
    """One small histogram per parameter over its prior range: weight of the members, best value as a line.

    Args:
        parameters: rows with parameter, prior_low, prior_high, best.
        members: column `weight`, and one per parameter.
    """
    rows = int(np.ceil(len(parameters) / COLUMNS))
    with styled():
        figure, axes = new_figure(10.5, 1.75 * rows, rows, COLUMNS)
        for place, axis in enumerate(axes.flat):
            if place >= len(parameters):
                axis.set_visible(False)
                continue
            row = parameters.iloc[place]
            edges = np.linspace(row.prior_low, row.prior_high, BINS + 1)
            axis.hist(members[row.parameter], edges, weights=members["weight"], color=BLUE, alpha=0.75)
            axis.axhline(1.0 / BINS, color=GREY, linestyle=":", linewidth=1.2)
            axis.axvline(row.best, color=VERMILION, linewidth=1.8)
            axis.set_xlim(row.prior_low, row.prior_high)
            axis.set_title(row.parameter, fontsize=8.5)
            axis.set_yticks([])
            axis.set_xticks([row.prior_low, row.prior_high])
            axis.grid(False)
    return figure


def plot_ratio(members: pd.DataFrame, half_track: NDArray[np.float64]) -> Figure:
    """The two combinations that decide: friction against height of the centre of mass over half the track (m)."""
    with styled():
        figure, axes = new_figure(5.2, 3.6)
        axis = axes[0, 0]
        ratio = members["car.com_height"] / half_track
        size = 25 + 900 * members["weight"]
        axis.scatter(members["car.tyre_friction"], ratio, s=size, color=BLUE, alpha=0.55, linewidth=0)
        friction = np.linspace(members["car.tyre_friction"].min(), members["car.tyre_friction"].max(), 50)
        mean = float(np.average(members["car.tyre_friction"] * ratio, weights=members["weight"]))
        axis.plot(friction, mean / friction, color=VERMILION, label=f"friction × height / half track = {mean:.3f}")
        axis.set_xlabel("tyre friction")
        axis.set_ylabel("height of centre of mass / half track")
        axis.legend()
    return figure


def plot_sensitivities(table: pd.DataFrame) -> Figure:
    """Heat map of total Sobol indices, a column per target; in each cell total over first-order index, %."""
    names, parameters = table["target"].unique(), table["parameter"].unique()
    total, first = (
        100.0 * table.pivot(index="parameter", columns="target", values=name).loc[parameters, names].to_numpy(float)
        for name in ("total", "first")
    )
    with styled():
        figure, axes = new_figure(1.6 + 1.35 * len(names), 0.42 * len(parameters) + 1.4)
        axis = axes[0, 0]
        axis.imshow(total, cmap="Blues", vmin=0.0, vmax=130.0, aspect="auto")
        for (row, column), value in np.ndenumerate(total):
            text = f"{value:.0f}\n{first[row, column]:.0f}" if round(value) else "0"
            axis.text(column, row, text, ha="center", va="center", fontsize=7)
        axis.set_xticks(range(len(names)), [_wrapped(_target_name(name)) for name in names], fontsize=8)
        axis.set_yticks(range(len(parameters)), parameters, fontsize=8)
        axis.xaxis.tick_top()
        axis.grid(False)
    return figure


def plot_validation(validated: Sequence[Validated]) -> Figure:
    """Band of the ensemble over the published figure, per place and metric; orange where it is no evidence."""
    sources = list(dict.fromkeys(v.source for v in validated))
    with styled():
        figure, axes = new_figure(12.0, 3.4, 1, len(sources))
        for axis, source in zip(axes.flat, sources, strict=True):
            rows = [v for v in validated if v.source == source]
            for place, v in enumerate(rows):
                colour = BLUE if v.is_test else ORANGE
                low, median, high = (value / v.published for value in (v.low, v.median, v.high))
                axis.plot([low, high], [place, place], color=colour, linewidth=5, alpha=0.5, solid_capstyle="butt")
                axis.plot(median, place, "|", color=colour, markersize=12, markeredgewidth=2)
            axis.axvline(1.0, color=VERMILION)
            axis.set_title(source)
            axis.set_xlabel("ensemble / published")
            axis.set_yticks(range(len(rows)), [metric_name(v.metric) for v in rows], fontsize=8)
            axis.invert_yaxis()
    return figure


def plot_directions(found: Sequence[Direction]) -> Figure:
    """Variance after over before the calibration for every combination, best determined first."""
    with styled():
        figure, axes = new_figure(6.2, 3.0)
        axis = axes[0, 0]
        axis.bar(range(1, len(found) + 1), [d.ratio for d in found], color=BLUE)
        axis.axhline(1.0, color=VERMILION, label="nothing learnt")
        axis.set_yscale("log")
        axis.set_xlabel("combination of parameters")
        axis.set_ylabel("variance after / before")
        axis.legend()
    return figure


def _target_name(name: str) -> str:
    source, _, metric = name.rpartition(" ")
    return "flip speed [m/s]" if name == FLIP_SPEED else f"{source}: {metric_name(metric)}"


def _wrapped(text: str) -> str:
    words = text.split()
    half = (len(words) + 1) // 2
    return " ".join(words[:half]) + "\n" + " ".join(words[half:])
