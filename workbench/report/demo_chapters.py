"""The chapters of the demo: a short turn in step, how far each candidate turns, and the thesis' own turn."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from matplotlib.figure import Figure

from aerodima.workbench.figures.comparison_figures import plot_outcomes
from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREY, MODE_STYLES, new_figure, styled
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import TurnMetrics, flip_bracket
from aerodima.workbench.metrics.run_summary import RunSummary, published_for
from aerodima.workbench.metrics.turn_course import turn_course
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.report.replay_page import replays_in_step
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
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
from aerodima.workbench.report.short_turn import PULSE, Entry, ShortTurn


def short_turn_chapter(table: ShortTurn, run_logs: Mapping[str, RunLog]) -> tuple[Section, Section]:
    """The replays with a sentence each, and the courses as bars.

    Args:
        table: what was measured.
        run_logs: name of a candidate -> its run in the case that is shown, steered as the last one.
    """
    who = table.entries.candidates
    names = [f"{one.words}: {_ending(run_logs[one.name])}" for one in who]
    shown = Section(
        "Same car, same floor, same steering",
        [
            replays_in_step([run_logs[one.name] for one in who], names),
            Finding([Bullets([_sentence(table, one, run_logs[one.name]) for one in who])]),
            _which_case(table),
        ],
    )
    bars = Plot(
        plot_courses(table),
        "Each with the steering that is best for it. Bar: median; band: least and largest; a dot per case, that of the "
        "replay in black.",
        "Course turned by a pulse of steering by each candidate, with its spread over the cases",
    )
    return shown, Section("How far each turns with its own best steering", [bars, *_how_far(table)])


def lead_of(table: ShortTurn, run_logs: Mapping[str, RunLog]) -> str:
    """One sentence for the top of the page."""
    who = table.entries.candidates
    over = [one.words.lower() for one in who if outcome_of(run_logs[one.name]).result == "flipped"]
    return (
        f"Same car, floor, speed and steering. Rolls over: {_listed(over) or 'nobody'}. The best swing "
        f"known turns the car by {_course(table, who[-1]):.0f}°; without a tail no steering gets it beyond "
        f"{_course(table, who[0]):.0f}°. The tail is a larger one than was built."
    )


def _listed(words: list[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _course(table: ShortTurn, one: Entry) -> float:
    """With its own best steering in the case that is shown, degrees."""
    return float(np.degrees(table.row(one.name)["course_change_rad"]))


def _ending(run_log: RunLog) -> str:
    course = turn_course(run_log).course_change_rad
    if outcome_of(run_log).result == "flipped":
        return "rolls over"
    return "stays upright" if course is None else f"turns {np.degrees(course):.0f}°"


def _sentence(table: ShortTurn, one: Entry, run_log: RunLog) -> str:
    own, angle = float(table.row(one.name)["steering_deg"]), table.steering_deg
    best = f"its own best steering, {own:.1f}°, turns its course by {_course(table, one):.1f}°."
    if own == angle:
        return f"{one.words}: {best} The others are steered alike. {one.chosen}".strip()
    return f"{one.words}: {_ending(run_log)} at {angle:.1f}° of steering; {best} {one.chosen}".strip()


def _which_case(table: ShortTurn) -> str:
    car, speed, floor = table.shown
    gains = 100.0 * table.gains
    place = list(table.gains.index).index(table.shown) + 1
    friction = float(table.row(table.entries.candidates[0].name)["friction"])
    return (
        f"This is no best case. By what the last candidate gains over the first, {gains[table.shown]:+.0f} %, it is "
        f"number {place} from below among the {len(gains)} of the table: the one in the middle, or the lesser of two. "
        f"They range from {gains.iloc[0]:+.0f} to {gains.iloc[-1]:+.0f} %. It is {car} of the ensemble at {speed:g} "
        f"m/s, steered for {PULSE:g} s on a floor of friction {friction:.2f}, {floor:g} times what the published "
        "swing survives at full lock."
    )


def _how_far(table: ShortTurn) -> list[str]:
    course = table.cases.pivot_table(
        index=["car", "speed_m_per_s", "floor"], columns="candidate", values="course_change_rad"
    )
    first, *others = table.entries.candidates
    said = []
    for one in others:
        gain = 100.0 * (course[one.name] / course[first.name] - 1.0)
        worst = gain.groupby(level="car").median().min()
        said.append(f"{one.words}: {gain.median():+.0f} % in the median, {worst:+.0f} % for the worst car")
    cars, floors = course.index.unique("car"), course.index.unique("floor")
    return [
        f"Over the car without a tail: {'; '.join(said)}. {len(cars)} cars on {len(floors)} floors, {len(course)} "
        "cases; none of these cars was used to choose a swing. A run counts that stays clean, rolls by 20° at most "
        "and leaves the turn without sliding.",
        "With the tail as it was built the best swing that was tried gains what the tail's own mass, low in the car, "
        "gains without a tail: docs/short_turn.md. The numbers are in models/short_turn/cases.csv; "
        "python -m tests.short_turn_table makes them again.",
    ]


def plot_courses(table: ShortTurn) -> Figure:
    """Course of each candidate: median, band over the cases, a dot for each."""
    who = table.entries.candidates
    with styled():
        image, grid = new_figure(9.0, 1.0 + 0.55 * len(who))
        axes = grid[0, 0]
        for place, one in enumerate(reversed(who)):
            own = table.cases[table.cases["candidate"] == one.name]
            values = np.degrees(own["course_change_rad"].to_numpy(float))
            median = float(np.median(values))
            axes.barh(place, median, color=BLUE, height=0.5)
            axes.barh(place, np.ptp(values), left=values.min(), color=BLUE, alpha=0.25, height=0.8)
            axes.plot(values, np.full(values.size, place), ".", color=GREY)
            axes.plot(_course(table, one), place, ".", color=BLACK, markersize=10)
            axes.text(values.max() + 0.5, place, f"{median:.1f}°", va="center")
        axes.set_yticks(range(len(who)), [one.words for one in reversed(who)])
        axes.set_xlabel("course turned [deg]")
    return image


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
