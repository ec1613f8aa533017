"""The demo, a swerve of several cars in step and the thesis' own turn: logs, replays and a page."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd

from aerodima.workbench.batch.dask_cluster import check_workers
from aerodima.workbench.batch.engine_factory import run_batch
from aerodima.workbench.batch.row_store import (
    WORKER_RECORD,
    ProgressBar,
    ProgressLine,
    RowStore,
    no_progress,
    print_resume_hint,
)
from aerodima.workbench.core.atomic_write import make_folder
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import read_run_log, software_versions
from aerodima.workbench.metrics.published_values import flip_bracket
from aerodima.workbench.metrics.run_summary import MODE_WORDS, RunSummary, published_for, summarise
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.captions import outcome_in_words
from aerodima.workbench.view.replay_page import write_replay_html
from aerodima.workbench.view.report_page import (
    Folded,
    Link,
    Page,
    Part,
    Preformatted,
    Section,
    Table,
    percent,
    write_files,
)
from aerodima.workbench.view.swerve_chapter import load_shown_swerve, swerve_chapter

DEMO_SCHEMA = "aerodima/demo/3"
PAGE = "index.html"
SUMMARY = "summary.csv"
MARK = "demo.json"
"""File that holds the scenarios of a folder's logs and says whether the demo is finished."""
FINISHED = "finished"
"""Key in that file of a finished demo."""
_METRICS = {
    "speed_m_per_s": ("speed at the start of the turn", "m/s"),
    "max_yaw_rate_rad_per_s": ("largest yaw rate", "rad/s"),
    "average_yaw_rate_rad_per_s": ("mean yaw rate", "rad/s"),
    "max_linear_acceleration_m_per_s2": ("largest lateral acceleration", "m/s²"),
    "average_linear_acceleration_m_per_s2": ("mean lateral acceleration", "m/s²"),
    "max_kohut_deg_m_per_s2": ("largest Kohut", "deg m/s²"),
    "average_kohut_deg_m_per_s2": ("mean Kohut", "deg m/s²"),
    "roll_integral_rad": ("roll integral", "rad"),
}
"""Words and unit on the page for each published metric."""

Turns = tuple[tuple[str, float], ...]
"""Tail mode and commanded speed, m/s, of several turns."""


@dataclass(frozen=True)
class DemoPlan:
    """Turns that are run, and those of them that are shown in full.

    Args:
        turns: tail mode `none`, `held`, `swing` or `designed` (scenarios `turn_<mode>`) and
            commanded speed (m/s) of each turn that is run.
        shown: turns that have a replay.
        seed: seed of every run.
        opening: whether the page begins with the swerve of `models/swerve/shown.yaml`, which adds a
            run for each candidate.
    """

    turns: Turns = (
        ("none", 12 / 3.6), ("none", 13 / 3.6), ("swing", 16 / 3.6), ("swing", 17 / 3.6),
    )  # fmt: skip
    shown: Turns = (("none", 13 / 3.6), ("swing", 16 / 3.6))
    seed: int = 1
    opening: bool = True


@dataclass(frozen=True)
class DemoRun:
    """One run of a demo: its name, scenario and files.

    Attributes:
        name: tail mode and speed in m/s.
        scenario: resolved scenario as plain data.
        log: path of the Parquet file.
        replay: path of the HTML file; None for a run without a replay of its own.
        opening: candidate that the run shows at the beginning of the page; empty for a run of the
            published turn.
    """

    name: str
    scenario: Json
    log: Path
    replay: Path | None = None
    opening: str = ""


def make_demo(
    out: Path,
    plan: DemoPlan,
    *,
    workers: int,
    force: bool = False,
    progress: ProgressLine = no_progress,
) -> Path:
    """Runs the demo and writes its page; returns the path of the page.

    A demo that was interrupted goes on where it stopped when it is made again: finished logs of the
    same scenario and versions are kept.

    Args:
        out: folder of the demo; made when it is not there.
        plan: turns to run.
        workers: number of worker processes.
        force: whether a finished demo is made again, or files are written among others.
        progress: function that receives lines of progress.

    Raises:
        UserError: workers out of range; the folder holds a finished demo, another one's logs or
            foreign files, or cannot be written. Nothing is overwritten without `force`.
    """
    check_workers(workers)
    runs = demo_runs(out, plan)
    bar = ProgressBar(progress, len(runs))

    def done(_place: int, summary: RunSummary) -> None:
        bar.advance(f"{summary.name}: {summary.metrics.outcome.result}")

    def kept() -> str:
        return f"{sum(run.log.exists() for run in runs)} of {len(runs)} logs"

    with _claimed(out, runs, force) as store, print_resume_hint(progress, kept):
        progress(f"{len(runs)} runs in {min(workers, len(runs))} process(es), results in {out}")
        summaries = run_batch(
            do_run, runs, workers, done, progress=progress, record=out / WORKER_RECORD
        )
        progress("writing table and page ...")
        _write_page(out, runs, summaries)
        store.add(FINISHED, {})
    return out / PAGE


def demo_runs(out: Path, plan: DemoPlan) -> list[DemoRun]:
    """Makes the runs of a plan, with their files below `out`."""
    runs = []
    for mode, speed in plan.turns:
        settings = [f"manoeuvre.speed={speed!r}", f"seed={plan.seed}"]
        name = f"{mode}_{speed:.2f}"
        scenario = load_scenario(f"turn_{mode}", settings).resolved()
        replay = None
        if (mode, speed) in plan.shown:
            replay = out / f"replay_{name}.html"
        runs.append(DemoRun(name, scenario, out / "logs" / f"turn_{name}.parquet", replay))
    runs.sort(key=lambda run: run.replay is None)  # the longest pieces of work first
    opening = load_shown_swerve().runs() if plan.opening else {}
    first = []
    for name, shown in opening.items():
        log = out / "logs" / f"{re.sub(r'[^a-z0-9]+', '_', name)}.parquet"
        content = shown.resolved() | {"seed": plan.seed}
        first.append(DemoRun(f"swerve, {name}", content, log, opening=name))
    return [*first, *runs]


def do_run(run: DemoRun) -> RunSummary:
    """Makes log and replay of a run if they are missing, and summarises the run."""
    if run.log.exists():
        try:
            log = read_run_log(run.log)
        except LogError as error:
            raise UserError(f"{error}; --force makes it again") from None
        if (log.scenario, log.versions) != (run.scenario, software_versions()):
            raise UserError(
                f"{run.log}: is of another scenario, seed or version; choose another folder, or "
                "--force"
            )
    else:
        from aerodima.workbench.batch.simulation import simulate
        from aerodima.workbench.scenario.scenario import scenario_from_dict

        journal_path(run.log).unlink(missing_ok=True)  # left by a killed demo
        log = simulate(scenario_from_dict(run.scenario), run.log)
    if run.replay is not None and not run.replay.exists():
        write_replay_html(log, run.replay)
    return summarise(log, run.name)


def _claimed(out: Path, runs: Sequence[DemoRun], force: bool) -> RowStore:
    """Claims the folder for this demo; UserError, with the reason, where that is not allowed."""
    scenarios = {run.name: run.scenario for run in runs}
    identity = {"schema": DEMO_SCHEMA, "versions": software_versions(), "scenarios": scenarios}
    store = RowStore(out / MARK, identity, force=force, alone=True)
    if FINISHED in store.rows:
        store.close()
        raise UserError(
            f"{out}: holds a finished demo already; choose another folder, or --force to make it "
            "again"
        )
    make_folder(out / "logs", UserError)
    if force:
        made = [out / PAGE, out / SUMMARY]
        for run in runs:
            made += [path for path in (run.log, run.replay) if path]
        for path in made:
            path.unlink(missing_ok=True)
    return store


def _write_page(out: Path, runs: Sequence[DemoRun], summaries: Sequence[RunSummary]) -> None:
    first = {run.opening: read_run_log(run.log) for run in runs if run.opening}
    thesis = {run.name: run for run in runs if not run.opening}
    modes = list(MODE_WORDS)
    ordered = sorted(
        (summary for summary in summaries if summary.name in thesis),
        key=lambda run: (modes.index(run.tail_mode), run.commanded_speed),
    )
    numbers = pd.DataFrame([{"run": s.name, **s.as_row(), **s.impulses_row()} for s in ordered])
    sections = [thesis_turn_chapter(ordered), provenance(thesis)]
    title = "The car turns, with and without its tail"
    lead = ""
    if first:
        title = f"One swerve, {len(first)} cars"
        lead = (
            "Same car, floor and speed; each candidate has its own best steering, but for a driver "
            "at full lock."
        )
        sections = [*swerve_chapter(load_shown_swerve(), first), *sections]
    write_files(out, {SUMMARY: numbers, PAGE: Page(title, lead, sections)})


def thesis_turn_chapter(summaries: Sequence[RunSummary]) -> Section:
    """Compares brackets of the flip, outcomes and metrics of the full-lock turn with the thesis."""
    definitions = (
        "Flipped: the body tilts beyond 75 degrees, or ends beyond 20 degrees with a wheel in the "
        "air. Clean: it survived, and neither cage nor tail touched the ground, nor the anti-ramp "
        "board from the start of the turn on."
    )
    parts: list[Part] = [
        _bracket_table(summaries),
        _outcome_table(summaries),
        definitions,
        _metric_table(summaries),
    ]
    return Section("The thesis' own turn, at full steering lock", parts)


def _bracket_table(summaries: Sequence[RunSummary]) -> Table:
    """Compares the speeds between which a car flips with the published ones."""
    rows = []
    for mode, published in (("none", flip_bracket("tailless")), ("swing", flip_bracket("tailed"))):
        runs = [run for run in summaries if run.tail_mode == mode]
        survived = [f"{run.commanded_speed:.2f}" for run in runs if run.survived]
        flipped = [f"{run.commanded_speed:.2f}" for run in runs if not run.survived]
        bracket = (max(survived, default="–"), min(flipped, default="–"))
        limits = (f"{published.survived:.2f}", f"{published.flipped:.2f}")
        if runs:
            rows.append((MODE_WORDS[mode], *bracket, *limits))
    header = (
        "tail",
        "survived up to [m/s]",
        "flipped from [m/s]",
        "published: survived",
        "published: flipped",
    )
    return Table(header, rows)


def _outcome_table(summaries: Sequence[RunSummary]) -> Table:
    """Lists how each run ended; those that flipped stand out."""
    header = (
        "speed [m/s]",
        "tail",
        "outcome",
        "peak roll [deg]",
        "mean yaw rate [rad/s]",
        "heading change [deg]",
        "tail energy [J]",
    )
    rows = []
    for summary in summaries:
        metrics = summary.metrics
        peak_roll = heading_change = tail_energy = "–"
        if summary.survived:
            peak_roll = f"{math.degrees(metrics.peak_roll_rad):.1f}"
            heading_change = f"{math.degrees(metrics.heading_change_rad):.1f}"
        if summary.tail_mode != "none" and metrics.tail_energy_j is not None:
            tail_energy = f"{metrics.tail_energy_j:.1f}"
        speed = f"{summary.commanded_speed:.2f}"
        outcome = outcome_in_words(metrics.outcome)
        yaw_rate = f"{metrics.raw.average_yaw_rate_rad_per_s:.2f}"
        tail = MODE_WORDS[summary.tail_mode]
        rows.append((speed, tail, outcome, peak_roll, yaw_rate, heading_change, tail_energy))
    return Table(header, rows, [index for index, s in enumerate(summaries) if not s.survived])


def _metric_table(summaries: Sequence[RunSummary]) -> Folded:
    """Compares metrics of runs that the thesis made too: raw beside its simulation, filtered beside
    its car.
    """
    rows = []
    for run in summaries:
        for platform, row in published_for(run).items():
            metrics = asdict(run.metrics.like(platform))
            for name, published in asdict(row.metrics).items():
                ours = metrics[name]
                numbers = (f"{ours:.2f}", f"{published:.2f}", percent(ours / published - 1.0))
                rows.append((run.name, row.source, platform, *_METRICS[name], *numbers))
    header = "run, published in, platform, metric, unit, this run, published, difference"
    return Folded("Metrics beside the published ones", [Table(header.split(", "), rows)])


def provenance(runs: Mapping[str, DemoRun]) -> Section:
    """Lists versions, seeds, files beside the page and the scenario of the first run: what the page
    was made of.

    Args:
        runs: runs by their names, at least one.
    """
    logs = [read_run_log(run.log) for run in runs.values()]
    versions = {item for log in logs for item in log.versions.items()}
    seeds = sorted({log.seed for log in logs})
    step = logs[0].number("simulation", "step")
    facts = [
        *sorted(versions),
        ("seed", ", ".join(map(str, seeds))),
        ("step of the plant", f"{step:g} s"),
    ]
    files = []
    for name, run in runs.items():
        replay = Link(run.replay.name, "replay") if run.replay else ""
        files.append((name, Link(f"logs/{run.log.name}", "log"), replay))
    scenario = Preformatted(json.dumps(logs[0].scenario, indent=2, sort_keys=True))
    parts: list[Part] = [
        ("Numbers of every run:", Link(SUMMARY)),
        Table(("run", "log", "replay"), files),
        Table(("what", "value"), facts),
        Folded(f"Resolved scenario of {next(iter(runs))}", [scenario]),
    ]
    return Section("Replays, logs and provenance", parts)
