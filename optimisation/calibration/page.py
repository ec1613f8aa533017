"""The page of a calibration; every sentence with a number is made of the result."""

from collections.abc import Sequence

import pandas as pd

from optimisation.calibration.calibrate import ENOUGH, Calibration, member_frame
from optimisation.calibration.identifiability import Direction
from optimisation.calibration.plan import assumed_elsewhere
from optimisation.calibration.plots import (
    plot_directions,
    plot_group,
    plot_posterior,
    plot_sensitivities,
    plot_validation,
)
from optimisation.calibration.shipped import Shipped
from optimisation.calibration.validation import Validated
from workbench.ensemble import Ensemble
from workbench.report.page import Markup, Section, bullets, figure, finding, page, paragraph, table
from workbench.report.words import metric_name, metric_unit

DETERMINED = 0.2
"""A combination counts as determined when its variance fell below this share of the prior's."""
CLOSE_Z = 2.0
"""A metric is counted as met when the published figure lies within this many standard deviations."""


def calibration_page(
    result: Calibration,
    ensemble: Ensemble,
    validated: Sequence[Validated],
    sensitivity: pd.DataFrame,
    parameters: pd.DataFrame,
    combinations: Sequence[Direction],
    shipped: Shipped,
) -> str:
    """The whole page as HTML text."""
    sections = (
        _outcome(result, ensemble),
        _validation(validated),
        _parameters(result, parameters, shipped),
        _sensitivity(sensitivity),
        _directions(combinations),
    )
    lead = (
        f"{len(ensemble.members)} cars, worth {ensemble.effective_size:.0f} equally likely ones, that the published "
        f"flip speeds and Table 7.1 leave possible; {result.runs} runs, seed {result.plan.seed}."
    )
    return page("Calibration of the car", lead, sections)


def _outcome(result: Calibration, ensemble: Ensemble) -> Section:
    tail, check = result.tail, result.check
    none, swing = result.car.target.bracket, tail.target.bracket
    said = [
        f"Tailless: every member survives {none.survived:g} m/s and flips at {none.flipped:g} m/s at the default "
        f"step; at {check.step:g} s that holds in {check.tailless_share:.0%} of the weight ({len(check.places)} "
        "members run).",
    ]
    if tail.is_met:
        said.append(
            f"Tailed: every member survives {swing.survived:g} m/s and flips at {swing.flipped:g} m/s; at "
            f"{check.step:g} s {check.tailed_share:.0%} of the weight."
        )
    else:
        said.append(
            f"Tailed: not met. With tails drawn from the prior {tail.survive:.0%} of the weight survives "
            f"{swing.survived:g} m/s, {tail.flip:.0%} flips in the turn at {swing.flipped:g} m/s, {tail.meet:.0%} does "
            "both, too little to hold the tails to it: they keep the width of their prior."
        )
    said.append(
        f"Effective sample size {ensemble.effective_size:.0f}, needed {ENOUGH}. "
        f"Best (most central) member: {ensemble.best.name}."
    )
    return Section("outcome", "What came out", (finding(*(paragraph(line) for line in said)),))


def _validation(validated: Sequence[Validated]) -> Section:
    header = ("table", "metric", "unit", "published", "5 %", "median", "95 %", "z", "z with discrepancy", "survived")
    rows = [
        (
            v.source + (" *" if v.used else ""),
            metric_name(v.metric),
            metric_unit(v.metric),
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
    tested = [v for v in validated if not v.used]
    within = sum(abs(v.z) <= CLOSE_Z for v in tested)
    allowed = sum(abs(v.z_with_discrepancy) <= CLOSE_Z for v in tested)
    parts = (
        finding(
            paragraph(
                f"Of the {len(tested)} figures that were not calibrated to, {within} lie within {CLOSE_Z:g} standard "
                f"deviations of the ensemble, {allowed} with the stated model discrepancy added."
            )
        ),
        figure(plot_validation(validated), "Band of 90 % of the weight over the published figure.", "Validation"),
        table(header, rows, numbers=range(3, 10)),
        paragraph(
            "* used in the calibration, with a discrepancy that was chosen with this table in sight: agreement with it "
            "is no evidence. Physical tables are compared after the car's zero-phase filters. Only runs that were "
            "survived have figures. The speed is commanded: members hardly differ in it, so its z says little."
        ),
    )
    return Section("validation", "Tables 7.1 to 7.4", parts)


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
    members = member_frame(result)
    parts: tuple[Markup, ...] = (
        figure(
            plot_posterior(parameters, members),
            "Weight of the members over the prior range; dotted: a flat prior; red: the best member.",
            "Histograms of all parameters",
        ),
        figure(plot_group(members), "What decides the flip: each dot a member, its size its weight.", "Friction"),
        table(header, rows, numbers=range(1, 9)),
        paragraph(
            "Shipped: the car of models/parameters, run as a member; its posterior density without tail is "
            f"{shipped.relative_density:.2g} of that of the best member."
            if shipped.relative_density
            else "Shipped: the car of models/parameters, run as a member; it misses the tailless bracket."
        ),
        paragraph(
            "Learnt: share of the variance of the plausible prior that the targets took away; negative values are "
            "scatter of the members, or a prior that the targets pull to one end."
        ),
        paragraph(f"Left at their value: {', '.join(assumed_elsewhere(result.plan))}."),
    )
    return Section("parameters", "Parameters", parts)


def _sensitivity(sensitivity: pd.DataFrame) -> Section:
    return Section(
        "sensitivities",
        "Sensitivity of each target to each parameter",
        (
            figure(
                plot_sensitivities(sensitivity),
                "Change of the target, in its unit, for a step of the parameter by a tenth of its prior range, the "
                "others held; mean over the members. Colour: over the largest change of that target.",
                "Sensitivities as a heat map",
            ),
        ),
    )


def _directions(combinations: Sequence[Direction]) -> Section:
    good = [d for d in combinations if d.ratio < DETERMINED]
    loose = [d for d in combinations if d.ratio >= DETERMINED]
    parts = (
        paragraph(
            f"{len(good)} of {len(combinations)} combinations are determined (variance below {DETERMINED:.0%} of the "
            f"prior's); the other {len(loose)} are not identifiable from these targets."
        ),
        figure(plot_directions(combinations), "Eigenvalues of the covariance against the prior's.", "Eigenvalues"),
        paragraph("Determined:"),
        bullets([f"{d.words} (variance × {d.ratio:.3f})" for d in good] or ["none"]),
        paragraph("Not identifiable, least first:"),
        bullets([f"{d.words} (variance × {d.ratio:.2f})" for d in reversed(loose)]),
    )
    return Section("identifiability", "Which combinations the data determine", parts)
