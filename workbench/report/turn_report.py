"""The whole report of a set of turns: from what was simulated to the numbers that made it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from aerodima.workbench.config.car_parameters import CarParameters
from aerodima.workbench.config.scenario import SECTIONS, load_parameter_entries
from aerodima.workbench.figures.figure_style import MODE_STYLES, modes_of
from aerodima.workbench.figures.run_figures import plot_turn
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import tyre_damping
from aerodima.workbench.metrics.run_summary import RunSummary, tail_mode_of
from aerodima.workbench.report import turn_chapters as chapters
from aerodima.workbench.report import turn_findings as findings
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Folded,
    Heading,
    Link,
    Page,
    Part,
    Plot,
    Preformatted,
    Section,
    Table,
    Text,
    degrees,
    zoomable,
)


@dataclass(frozen=True)
class ReportFiles:
    """Files beside the report, as relative addresses; what is not there is not linked.

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


def turn_report(
    summaries: Sequence[RunSummary],
    run_logs: Mapping[str, RunLog],
    standard: Sequence[str],
    files: ReportFiles,
    opening: Page | None = None,
) -> Page:
    """The report; equal runs give equal text.

    Args:
        summaries: all runs.
        run_logs: name -> log of the runs that are drawn over time: the standard ones and those with a swinging tail.
        standard: names of the runs whose signals are shown in full, in order; the first gives scenario and versions.
        files: what lies beside the report.
        opening: chapters that come first, with title and lead of the whole; the turns are then the second chapter.
    """
    first = run_logs[standard[0]]
    sections = (
        _what_was_simulated(summaries, run_logs, standard, files),
        chapters.outcomes(summaries),
        chapters.beside_published(summaries, first.scenario),
        chapters.tail_beside_none(summaries),
        chapters.what_the_tail_does(summaries, run_logs),
        _signals(run_logs, standard, files),
        _limits(summaries, first.scenario),
        _parameters(first.scenario),
        _provenance(summaries, run_logs, standard, files),
    )
    lead = (
        f"{len(summaries)} simulated turns of a 1:10 car with a light aerodynamic tail: without tail, with the tail "
        "as it was built held on the inside of the turn and swung over the top to the outside, and with a larger one, "
        "openly designed, that swings alike."
    )
    if opening is None:
        return Page("The car turns, with and without its tail", lead, sections)
    second = Section("The thesis' own turn, at full steering lock", [lead])
    return Page(opening.title, opening.lead, (*opening.sections, second, *sections))


def _what_was_simulated(
    summaries: Sequence[RunSummary], run_logs: Mapping[str, RunLog], standard: Sequence[str], files: ReportFiles
) -> Section:
    scenario = run_logs[standard[0]].scenario
    manoeuvre, controller = scenario["manoeuvre"], scenario["controller"]
    speeds = sorted({s.commanded_speed for s in summaries})
    strips = [
        Plot(files.strips[name], _strip_caption(name, files), f"Five pictures of the run {name}")
        for name in standard
        if name in files.strips
    ]
    parts: list[Part] = [
        _in_short(summaries),
        f"Each run takes {manoeuvre['duration']:g} s. The car reaches its speed within "
        f"{manoeuvre['speed_ramp']:g} s; at {manoeuvre['turn_start']:g} s it is steered "
        f"{degrees(manoeuvre['steer_angle'])} to the {manoeuvre['direction']}, {manoeuvre['turn_hold']:g} s later "
        f"straight ahead again, while the drive holds the speed of the wheels. There are {len(speeds)} speeds "
        f"from {speeds[0]:.2f} to {speeds[-1]:.2f} m/s.",
        Bullets(_mode_words(summaries, controller)),
        *strips,
    ]
    return Section("What was simulated", parts)


def _in_short(summaries: Sequence[RunSummary]) -> Finding:
    """What came out, before how."""
    said = [f"{findings.mode_and_bracket(summaries, mode)}." for mode in modes_of(summaries)]
    reference = findings.reference_run(summaries)
    if reference is not None:
        said += [
            findings.faster_claim(summaries, mode, reference)
            for mode in modes_of(summaries)
            if mode not in ("none", "optimised")
        ]
    return Finding(["In short:", Bullets(said)])


def _mode_words(summaries: Sequence[RunSummary], controller: Mapping[str, Any]) -> list[str]:
    said = {
        "none": "No tail: the arm is taken off; its gearbox stays on the car.",
        "held": f"Tail held: it lies {degrees(controller['hold_angle'])} to the inside all the time.",
        "swing": (
            f"Tail swings: held on the inside until the yaw rate passes {controller['trigger_yaw_rate']:g} rad/s, "
            f"then driven over the top at {controller['swing_speed']:g} rad/s, and held on the outside after "
            f"{degrees(controller['travel'])} of travel."
        ),
        "designed": (
            "Designed tail: not the one that was built. Its sail is as large as motors, ground and 300 g allow, where "
            "the tunnel tests bound the built one to a tenth of that; it swings by the same controller."
        ),
    }
    return [said[mode] for mode in modes_of(summaries) if mode in said]


def _strip_caption(name: str, files: ReportFiles) -> Text:
    text = (
        "Before, during and after the turn; arrows are forces of the ground on the wheels and of the air on the tail."
    )
    if name not in files.replays:
        return text
    return text, Link(files.replays[name], "Watch this run in 3D.")


def _signals(run_logs: Mapping[str, RunLog], standard: Sequence[str], files: ReportFiles) -> Section:
    parts: list[Part] = []
    for name in standard:
        log = run_logs[name]
        mode, speed = MODE_STYLES[tail_mode_of(log.scenario)].words, log.scenario["manoeuvre"]["speed"]
        title = f"{mode.capitalize()}, {speed:.2f} m/s"
        caption: list[str | Link] = ["IMU and GPS as the car would log them, and after its filters."]
        caption += [
            Link(at[name], words) for at, words in ((files.logs, "log"), (files.replays, "replay")) if name in at
        ]
        parts += [Heading(title), zoomable(plot_turn(log), tuple(caption), f"Signals over time: {title}")]
    return Section("Runs over time", parts)


def _limits(summaries: Sequence[RunSummary], scenario: dict[str, Any]) -> Section:
    """What the model cannot represent."""
    car, gravity = scenario["car"], float(scenario["environment"]["gravity"])
    front, rear = tyre_damping()
    share = float(car["com_x"]) / float(car["wheelbase"])
    loads = (0.5 * car["mass"] * gravity * share, 0.5 * car["mass"] * gravity * (1.0 - share))
    prior = load_parameter_entries("car")["mass"].prior or (car["mass"], car["mass"])
    lowest, highest = front / (0.25 * prior[1] * gravity), rear / (0.25 * prior[0] * gravity)
    used, most = float(car["tyre_dissipation"]), _largest_allowed(CarParameters, "tyre_dissipation")
    parts = [
        f"Tyre damping. Published are {front:g} N s/m (front) and {rear:g} N s/m (rear). Contact is damped by the "
        "law of Hunt and Crossley, force = k x (1 + d v); at the static wheel load a damping c equals d = c / "
        f"load, here {front / loads[0]:.0f} s/m in front ({loads[0]:.1f} N) and {rear / loads[1]:.0f} s/m behind "
        f"({loads[1]:.1f} N), and {lowest:.0f} to {highest:.0f} s/m over the masses that the car may have "
        f"({prior[0]:g} to {prior[1]:g} kg). Above {most:g} s/m the outcome depends on the step of the "
        f"simulation, so {used:g} s/m is used: {used * loads[0]:.0f} and {used * loads[1]:.0f} N s/m at these "
        f"loads, {100 * used * loads[0] / front:.0f} % and {100 * used * loads[1] / rear:.0f} % of the published "
        "damping. The published damping is not representable.",
        "Tyres follow Coulomb's law with one coefficient: beyond it the side force no longer grows, so that "
        "survival depends more on grip and height of the centre of mass than on the speed.",
        "A flipped car lands on a roll cage with an assumed stiffness: what happens after the first contact of "
        "the cage decides nothing here and should not be trusted.",
    ]
    return Section("What the model cannot show", parts)


def _largest_allowed(model: type[BaseModel], key: str) -> float:
    """Upper limit of a parameter, in its unit."""
    limits = [getattr(limit, "le", None) for limit in model.model_fields[key].metadata]
    return next(float(limit) for limit in limits if limit is not None)


def _parameters(scenario: dict[str, Any]) -> Section:
    """Every number with unit and source; those that are published nowhere stand out."""
    tables = []
    unknown = calibrated = total = 0
    for section in SECTIONS:
        rows: list[tuple[str, ...]] = []
        marked: list[int] = []
        for key, entry in load_parameter_entries(section).items():
            if key not in scenario[section]:  # a log of an earlier version
                continue
            value = scenario[section][key]
            by_run = value != entry.value
            unpublished = entry.source == "assumed" or entry.source.startswith("calibrated")
            if unpublished and not by_run:
                marked.append(len(rows))
                calibrated += entry.source != "assumed"
            prior = "" if entry.prior is None else f"{entry.prior[0]:g}\u00a0to\u00a0{entry.prior[1]:g}"
            source = f"◆ {entry.source}" if unpublished else entry.source
            rows.append(
                (
                    key,
                    f"{value:.6g}" if isinstance(value, float) else str(value).lower(),
                    "" if entry.unit == "1" else entry.unit.replace(" ", "\u00a0"),
                    f"set by the scenario (default {entry.value})" if by_run else source,
                    prior,
                    entry.reason or "",
                )
            )
        unknown, total = unknown + len(marked), total + len(rows)
        header = ("parameter", "value", "unit", "source", "prior range", "reason")
        words = f"{section} ({len(marked)} of {len(rows)} published nowhere)"
        tables.append(Folded(words, [Table(header, rows, marked)]))
    counts = (
        f"{unknown} of {total} parameters are published nowhere and marked with ◆: {calibrated} of them are "
        f"calibrated to the published flips, {unknown - calibrated} assumed within a prior range. Tail mode and "
        "speed differ from run to run."
    )
    return Section("Parameters and their sources", [counts, *tables])


def _provenance(
    summaries: Sequence[RunSummary], run_logs: Mapping[str, RunLog], standard: Sequence[str], files: ReportFiles
) -> Section:
    first = run_logs[standard[0]]
    versions = sorted({(name, version) for log in run_logs.values() for name, version in log.versions.items()})
    seeds = sorted({log.seed for log in run_logs.values()})
    rows = [*versions, ("seed", ", ".join(str(seed) for seed in seeds))]
    rows += [("step of the plant", f"{first.scenario['simulation']['step']:g} s")]
    runs = []
    for s in summaries:
        log = Link(files.logs[s.name], "log") if s.name in files.logs else ""
        replay = Link(files.replays[s.name], "replay") if s.name in files.replays else ""
        runs.append((s.name, MODE_STYLES[s.tail_mode].words, f"{s.commanded_speed:.4f}", log, replay))
    parts: list[Part] = [
        Table(("what", "value"), rows),
        "The same scenario and seed give the same bits in every signal. Each log holds its resolved scenario, its "
        "seed and these versions.",
        *([("Numbers of every run:", Link(files.summary))] if files.summary else []),
        Folded("Runs and their files", [Table(("run", "tail", "speed [m/s]", "log", "replay"), runs)]),
        Folded(
            f"Resolved scenario of {standard[0]}",
            [Preformatted(json.dumps(first.scenario, indent=2, sort_keys=True))],
        ),
    ]
    return Section("Provenance", parts)
