"""The last chapters of the demo: the thesis' own turn at its speeds beside the published figures, and the files."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

from aerodima.workbench.figures.comparison_figures import plot_outcomes
from aerodima.workbench.figures.figure_style import MODE_STYLES
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import TurnMetrics, flip_bracket
from aerodima.workbench.metrics.run_summary import RunSummary, published_for
from aerodima.workbench.report.report_page import (
    Folded,
    Link,
    Part,
    Plot,
    Preformatted,
    Section,
    Table,
    metric_name,
    metric_unit,
    percent,
)


@dataclass(frozen=True)
class RunFiles:
    """Files beside the page, as relative addresses; what is not there is not linked.

    Attributes:
        summary: table of the runs.
        logs: name of a run -> its log.
        replays: name of a run -> its replay.
        strips: name of a run -> its strip of pictures.
    """

    summary: str = ""
    logs: Mapping[str, str] = field(default_factory=dict)
    replays: Mapping[str, str] = field(default_factory=dict)
    strips: Mapping[str, str] = field(default_factory=dict)


def thesis_turn_chapter(summaries: Sequence[RunSummary], files: RunFiles) -> Section:
    """Outcomes, brackets of the flip and metrics of the turn at full lock, beside those of the thesis.

    Args:
        summaries: of the runs, in the order of the tables.
        files: of these runs.
    """
    strips = [
        Plot(address, (name, *([Link(files.replays[name], "replay")] if name in files.replays else [])),
             f"Five pictures of the run {name}")
        for name, address in files.strips.items()
    ]  # fmt: skip
    outcome_map = Plot(
        plot_outcomes(summaries),
        "Flipped: the body tilts beyond 75 degrees, or ends beyond 20 degrees with a wheel in the air. "
        "Clean: survived, and neither cage nor tail touched the ground, nor the anti-ramp board from the "
        "start of the turn on.",
        "Map of outcomes over commanded speed and tail mode",
    )
    parts: list[Part] = [
        outcome_map,
        _bracket_table(summaries),
        _outcome_table(summaries),
        *strips,
        _metric_table(summaries),
    ]
    return Section("The thesis' own turn, at full steering lock", parts)


def _bracket_table(summaries: Sequence[RunSummary]) -> Table:
    rows = []
    for mode, configuration in (("none", "tailless"), ("swing", "tailed")):
        own = [s for s in summaries if s.tail_mode == mode]
        survived = max((f"{s.commanded_speed:.2f}" for s in own if s.survived), default="–")
        flipped = min((f"{s.commanded_speed:.2f}" for s in own if not s.survived), default="–")
        published = flip_bracket(configuration)  # type: ignore[arg-type]  # mypy reads str
        if own:
            rows.append(
                (MODE_STYLES[mode].words, survived, flipped, f"{published.survived:.2f}", f"{published.flipped:.2f}")
            )
    header = ("tail", "survived up to [m/s]", "flipped from [m/s]", "published: survived", "published: flipped")
    return Table(header, rows)


def _outcome_table(summaries: Sequence[RunSummary]) -> Table:
    header = ("speed [m/s]", "tail", "outcome", "peak roll [deg]", "mean yaw rate [rad/s]", "heading change [deg]",
              "tail energy [J]")  # fmt: skip
    rows = [
        (
            f"{s.commanded_speed:.2f}",
            MODE_STYLES[s.tail_mode].words,
            _outcome(s),
            f"{math.degrees(s.metrics.peak_roll_rad):.1f}" if s.survived else "–",
            f"{s.metrics.raw.average_yaw_rate_rad_per_s:.2f}",
            f"{math.degrees(s.metrics.heading_change_rad):.1f}" if s.survived else "–",
            "–" if s.tail_mode == "none" or s.metrics.tail_energy_j is None else f"{s.metrics.tail_energy_j:.1f}",
        )
        for s in summaries
    ]
    return Table(header, rows, [place for place, s in enumerate(summaries) if not s.survived])


def _outcome(summary: RunSummary) -> str:
    if not summary.survived:
        return "✖ flipped"
    touched = summary.metrics.outcome.touched
    return "● survived, clean" if not touched else f"○ survived, {' and '.join(touched)} touched the ground"


def _metric_table(summaries: Sequence[RunSummary]) -> Folded:
    """Metrics of the runs that the thesis made too; raw beside its simulation, filtered beside its car."""
    rows = [
        (run.name, row.source, platform, metric_name(one.name), metric_unit(one.name), f"{ours:.2f}",
         f"{published:.2f}", percent(ours / published - 1.0))
        for run in summaries
        for platform, row in published_for(run).items()
        for one in fields(TurnMetrics)
        for ours, published in [(getattr(run.metrics.like(platform), one.name), getattr(row.metrics, one.name))]
    ]  # fmt: skip
    header = ("run", "published in", "platform", "metric", "unit", "this run", "published", "difference")
    return Folded("Metrics beside the published ones", [Table(header, rows)])


def provenance(run_logs: Mapping[str, RunLog], files: RunFiles) -> Section:
    """Versions, seeds, files and the scenario of the first run: what the page was made of.

    Args:
        run_logs: name -> log, of at least one run.
        files: of these runs.
    """
    first = next(iter(run_logs))
    versions = sorted({(name, version) for log in run_logs.values() for name, version in log.versions.items()})
    seeds = sorted({log.seed for log in run_logs.values()})
    rows = [*versions, ("seed", ", ".join(map(str, seeds)))]
    rows += [("step of the plant", f"{run_logs[first].scenario['simulation']['step']:g} s")]
    linked = [
        (name, Link(address, "log"), Link(files.replays[name], "replay") if name in files.replays else "")
        for name, address in files.logs.items()
    ]
    return Section(
        "Provenance",
        [
            Table(("what", "value"), rows),
            *([("Numbers of every run:", Link(files.summary))] if files.summary else []),
            Folded("Runs and their files", [Table(("run", "log", "replay"), linked)]),
            Folded(
                f"Resolved scenario of {first}",
                [Preformatted(json.dumps(run_logs[first].scenario, indent=2, sort_keys=True))],
            ),
        ],
    )
