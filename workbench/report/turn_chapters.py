"""The chapters of the report that compare runs: outcomes, published figures, tail and no tail, what the tail does."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields

from aerodima.workbench.figures.comparison_figures import plot_comparison, plot_metrics, plot_outcomes, plot_triggers
from aerodima.workbench.figures.figure_style import MODE_STYLES, modes_of
from aerodima.workbench.figures.tail_figures import plot_impulses, plot_moments
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import (
    SIGNALS,
    Comparison,
    FlipBracket,
    PublishedValues,
    TurnMetrics,
    compare_values,
    flip_bracket,
    published_values,
)
from aerodima.workbench.metrics.run_summary import RunSummary, published_for
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.report import turn_findings as findings
from aerodima.workbench.report.report_page import (
    Finding,
    Folded,
    Heading,
    Part,
    Plot,
    Section,
    Table,
    degrees,
    metric_name,
    metric_unit,
    percent,
)

CLOSE = 0.1
"""Metrics within this share of the published figure are counted as met in the text."""

_WORDS = (
    "Kohut is the thesis' measure of a turn: the speed at its start times the yaw rate in degrees per second (E36). E "
    "with a number is an entry of models/published/ERRATA.md, which names what is wrong or unclear in the thesis."
)


def outcomes(summaries: Sequence[RunSummary]) -> Section:
    """Outcome map, and the speeds of the flip beside the published ones."""
    outcome_map = Plot(
        plot_outcomes(summaries),
        "Outcome of every run. Flipped: the body tilts beyond 75 degrees, or ends beyond 20 degrees with a wheel "
        "in the air. Clean: survived, and neither cage nor tail touched the ground, nor the anti-ramp board from "
        "the start of the turn on.",
        "Map of outcomes over commanded speed and tail mode",
    )
    said = [_bracket_sentences(summaries, mode) for mode in modes_of(summaries)]
    return Section("Who stays upright", [outcome_map, Finding(said), _outcome_table(summaries)])


def _bracket_sentences(summaries: Sequence[RunSummary], mode: str) -> str:
    bracket = findings.bracket_of([s for s in summaries if s.tail_mode == mode])
    published = _published_bracket(mode)
    beside = findings.bracket_verdict(bracket, published) if published else "The thesis simulated no such car."
    return f"{findings.mode_and_bracket(summaries, mode)}. {beside}"


def _published_bracket(mode: str) -> FlipBracket | None:
    """The thesis ran no simulation with the tail held."""
    if mode == "none":
        return flip_bracket("tailless")
    return flip_bracket("tailed") if mode == "swing" else None


def _outcome_table(summaries: Sequence[RunSummary]) -> Folded:
    header = ("speed [m/s]", "tail", "outcome", "peak roll [deg]", "mean yaw rate [rad/s]", "heading change [deg]",
              "two wheels or fewer [s]", "tail energy [J]")  # fmt: skip
    rows = [
        (
            f"{s.commanded_speed:.2f}",
            MODE_STYLES[s.tail_mode].words,
            _outcome_words(s),
            f"{math.degrees(s.metrics.peak_roll_rad):.1f}" if s.survived else "–",
            f"{s.metrics.raw.average_yaw_rate_rad_per_s:.2f}",
            f"{math.degrees(s.metrics.heading_change_rad):.1f}" if s.survived else "–",
            "–" if s.metrics.two_wheel_time_s is None else f"{s.metrics.two_wheel_time_s:.2f}",
            "–" if s.tail_mode == "none" or s.metrics.tail_energy_j is None else f"{s.metrics.tail_energy_j:.1f}",
        )
        for s in sorted(summaries, key=lambda s: (s.commanded_speed, list(MODE_STYLES).index(s.tail_mode)))
    ]
    marked = [place for place, row in enumerate(rows) if "flipped" in row[2]]
    return Folded("All runs as a table", [Table(header, rows, marked)])


def _outcome_words(summary: RunSummary) -> str:
    if not summary.survived:
        return "✖ flipped"
    touched = summary.metrics.outcome.touched
    return "● survived, clean" if not touched else f"○ survived, {' and '.join(touched)} touched the ground"


def beside_published(summaries: Sequence[RunSummary], scenario: dict) -> Section:
    """Metrics of the runs that the thesis made too, with the differences and what cannot be met at the same time."""
    pairs = [(run, row) for run in summaries for row in published_for(run).values()]
    parts: list[Part] = []
    if not pairs:
        parts.append("None of these runs was made by the thesis too.")
    for run, row in pairs:
        comparisons = compare_values(run.metrics.like(row.platform), row.configuration, row.platform)  # type: ignore[arg-type]
        parts += _beside(run, row, comparisons)
    if pairs:
        parts.append(_WORDS)
    parts += _together(pairs, scenario)
    missing = [row for row in published_values() if row not in [found for _, found in pairs]]
    if missing:
        named = "; ".join(
            f"{r.source} ({r.platform}, {r.configuration}, {r.metrics.speed_m_per_s:.2f} m/s)" for r in missing
        )
        parts.append(f"No run corresponds to {named}: the figures show these as stars only.")
    for platform, signals in SIGNALS.items():
        drawn = Plot(
            plot_metrics(summaries, platform),
            f"Metrics of the runs over the speed at the start of the turn, from the signals of the {platform} rows: "
            f"{signals}. Stars: the {platform} rows. The roll integral of flipped runs is off the scale.",
            f"Seven metrics over speed for every run, published figures of the {platform} car as stars",
        )
        parts.append(drawn if platform == "simulated" else Folded("The same with the signals of the real car", [drawn]))
    return Section("Beside the published figures", parts)


def _beside(run: RunSummary, row: PublishedValues, comparisons: Sequence[Comparison]) -> list[Part]:
    header = ("metric", "unit", "published", "run", "difference", "in %")
    rows = []
    for c in comparisons:
        digits = 0 if abs(c.published) >= 100 else 2
        rows.append(
            (
                metric_name(c.metric),
                metric_unit(c.metric),
                f"{c.published:.2f}" if c.metric != "roll_integral_rad" else f"{c.published:.3f}",
                f"{c.ours:.{digits}f}",
                f"{c.difference:+.{digits}f}",
                percent(c.relative),
            )
        )
    named = f"{row.source} ({row.platform}, {row.configuration}) beside the run: {MODE_STYLES[run.tail_mode].words}, "
    eight = comparisons[: len(fields(TurnMetrics))]
    close = findings.close_metrics(eight, CLOSE)
    return [
        Heading(named + f"{run.commanded_speed:.2f} m/s commanded"),
        Table(header, rows),
        f"{close} of the {len(eight)} metrics lie within {100 * CLOSE:.0f} % of the published figure. "
        f"Furthest off: {findings.misses_in_words(eight)}. Signals, as the thesis took them for {row.source}: "
        f"{SIGNALS[row.platform]}.",
    ]


def _together(pairs: Sequence[tuple[RunSummary, PublishedValues]], scenario: dict) -> list[Part]:
    """What cannot be met at the same time, by how much."""
    for run, row in pairs:
        if (row.platform, row.configuration) == ("simulated", "tailless"):
            gravity = float(scenario["environment"]["gravity"])
            sentences = findings.tipping_sentences(scenario["car"], gravity, row, run)
            said = [
                "The parameters were set for the speeds of the tailless flip; the metrics follow from them.",
                " ".join(sentences).strip(),
                "The printed roll sums carry no time step (E35); they are compared as radians with a "
                "step of 1 ms (simulated) or 10 ms (physical), which is inferred.",
            ]
            return [Finding(said)]
    return []


def tail_beside_none(summaries: Sequence[RunSummary]) -> Section:
    """Held and swinging tail beside no tail over the speed, and which claims hold."""
    parts: list[Part] = [
        Plot(
            plot_comparison(summaries),
            "Held and swinging tail beside no tail. Flipped runs are crosses at the top: they have no heading change "
            "or peak roll worth the name.",
            "Peak roll, mean yaw rate, heading change and time on two wheels over speed",
        )
    ]
    reference = findings.reference_run(summaries)
    if reference is None:
        parts.append(Finding(["No run without tail is clean, so there is no reference to be faster than."]))
    else:
        said = [
            "One car turns faster than another only if its run is clean and it changes its heading by at "
            f"least {100 * LEAST_HEADING:.0f} % of the other's. Reference: no tail at "
            f"{reference.commanded_speed:.2f} m/s, {degrees(reference.metrics.heading_change_rad)}.",
            *(findings.faster_claim(summaries, mode, reference) for mode in modes_of(summaries) if mode != "none"),
            findings.held_beside_swing(summaries),
        ]
        parts.append(Finding(list(filter(None, said))))
    jolts = findings.jolt_sentence(summaries)
    return Section("With and without tail", [*parts, jolts] if jolts else parts)


def what_the_tail_does(summaries: Sequence[RunSummary], explained: Mapping[str, RunLog]) -> Section:
    """Impulses by cause, moments over time, and when the swing begins.

    Args:
        summaries: all runs.
        explained: name -> log of the runs with a tail; those of the swinging tail show the triggers, all of a mode's
            fastest and slowest the moments.
    """
    tailed = [s for s in summaries if s.over_window is not None]
    if not tailed:
        return Section("What the tail does", ["No run has a tail."])
    said = [
        f"{MODE_STYLES[mode].words.capitalize()}, impulse over the turn against rolling outwards: "
        f"{findings.impulse_sentence([s for s in tailed if s.tail_mode == mode])}."
        for mode in modes_of(tailed)
        if mode != "none"
    ]
    parts: list[Part] = [
        "The tail acts on the car through three causes, found from the logged motion and forces of the tail "
        "alone: the air on the sail, the tail's weight beside the car, and the reaction to accelerating its mass. "
        "Positive works against rolling outwards; the moment is taken about the car's heading, at the ground "
        "below the rear axle.",
        Plot(
            plot_impulses(tailed),
            "Impulse of the tail over the turn by cause, and the sum.",
            "Stacked bars of aerodynamic, weight and inertial impulse over speed for held and swinging tail",
        ),
        Finding(said),
    ]
    return Section("What the tail does", [*parts, *_moment_figures(tailed, explained), *_triggers(tailed, explained)])


def _moment_figures(tailed: Sequence[RunSummary], explained: Mapping[str, RunLog]) -> list[Part]:
    shown = [s for s in tailed if s.name in explained]
    chosen = [s for s in shown if s.tail_mode == "held"][-1:]
    swings = [s for s in shown if s.tail_mode == "swing"]
    chosen += [swings[0], swings[-1]] if len(swings) > 1 else swings
    chosen += [s for s in shown if s.tail_mode == "designed"][-1:]
    if not chosen:
        return []
    titles = [f"{MODE_STYLES[s.tail_mode].words.capitalize()}, {s.commanded_speed:.2f} m/s" for s in chosen]
    return [
        Plot(
            plot_moments([explained[s.name] for s in chosen], titles),
            "Moment of the tail on the car by cause. The swing begins and ends with a blow of inertia; in between the "
            "air on the sail holds the car down, while the weight goes from helping to hindering.",
            "Aerodynamic, weight and inertial moment over time",
        )
    ]


def _triggers(tailed: Sequence[RunSummary], explained: Mapping[str, RunLog]) -> list[Part]:
    swings = [s for s in tailed if s.tail_mode == "swing" and s.name in explained]
    if not swings:
        return []
    scenario = explained[swings[0].name].scenario
    back = float(scenario["manoeuvre"]["turn_start"]) + float(scenario["manoeuvre"]["turn_hold"])
    sentences = findings.trigger_sentences(swings, float(scenario["controller"]["trigger_yaw_rate"]), back)
    return [
        Heading("When the swing begins"),
        Plot(
            plot_triggers([explained[s.name] for s in swings]),
            "Yaw rate of the IMU in the runs of the swinging tail, and when the controller begins to swing.",
            "Yaw rate around the turn for each speed with the time of the trigger",
        ),
        Finding([" ".join(sentences)]),
    ]
