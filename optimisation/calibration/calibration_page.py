"""The page of a calibration; every sentence with a number is made of the result."""

from collections.abc import Sequence

import pandas as pd

from aerodima.optimisation.calibration.calibration import Calibration, member_frame
from aerodima.optimisation.calibration.calibration_figures import (
    plot_directions,
    plot_group,
    plot_posterior,
    plot_sensitivities,
    plot_validation,
)
from aerodima.optimisation.calibration.calibration_plan import assumed_elsewhere, fitted_names
from aerodima.optimisation.calibration.identifiability import Direction
from aerodima.optimisation.calibration.nominal_car import Shipped
from aerodima.optimisation.calibration.validation import Outcome, Validated
from aerodima.workbench.config.ensemble import Ensemble
from aerodima.workbench.metrics.published_figures import SIGNALS
from aerodima.workbench.report.number_words import metric_name, metric_unit
from aerodima.workbench.report.report_page import Bullets, Finding, Page, Part, Plot, Section, Table

DETERMINED = 0.2
"""A combination counts as determined when its variance fell below this share of the prior's."""
CLOSE_Z = 2.0
"""A metric is counted as met when the published figure lies within this many standard deviations."""


def calibration_page(
    result: Calibration,
    ensemble: Ensemble,
    validated: Sequence[Validated],
    outcomes: Sequence[Outcome],
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
        f"{len(ensemble.members)} cars with tails, worth {ensemble.effective_size:.0f} equally likely ones, that the "
        f"fitted figures leave possible; {result.runs} runs, seed {result.plan.seed}."
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
        Plot(plot_validation(validated), "Band of 90 % of the weight over the published figure.", "Validation"),
        Table(header, rows),
        "Fitted figures, and Kohut figures that follow from a fitted yaw rate, are no evidence. Tables 7.1 and "
        f"7.2 are compared with {SIGNALS['simulated']}; 7.3 and 7.4 with {SIGNALS['physical']}. Only runs that "
        "were survived have figures in this table; the weights take the figures of a tailed run whether it was "
        "survived or not.",
    ]
    return Section("Tables 7.1 to 7.4 and the lift of the inner wheels", parts)


def _outcomes(outcomes: Sequence[Outcome]) -> Section:
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
        Plot(
            plot_group(members, half_track),
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
    drawn = Plot(
        plot_sensitivities(sensitivity),
        "Change of the target, in its unit, for a step of the parameter by a tenth of its prior range, the "
        "others held; mean over the members. Colour: over the largest change of that target.",
        "Sensitivities as a heat map",
    )
    return Section("Sensitivity of each target to each parameter", [drawn])


def _directions(combinations: Sequence[Direction]) -> Section:
    good = [d for d in combinations if d.ratio < DETERMINED]
    loose = [d for d in combinations if d.ratio >= DETERMINED]
    parts: list[Part] = [
        f"{len(good)} of {len(combinations)} combinations are determined (variance below {DETERMINED:.0%} of the "
        f"prior's); the other {len(loose)} are not identifiable from these targets.",
        Plot(plot_directions(combinations), "Eigenvalues of the covariance against the prior's.", "Eigenvalues"),
        "Determined:",
        Bullets([f"{d.words} (variance × {d.ratio:.3f})" for d in good] or ["none"]),
        "Not identifiable, least first:",
        Bullets([f"{d.words} (variance × {d.ratio:.2f})" for d in reversed(loose)]),
    ]
    return Section("Which combinations the data determine", parts)
