"""The demo: the short turn of four cars and the thesis' own turn, with logs, table, replays and page in one folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.workbench.atomic_write import make_folder
from aerodima.workbench.batch import WORKER_RECORD, check_workers, run_batch
from aerodima.workbench.batch.row_store import ProgressBar, ProgressLine, RowStore, saying_how_to_go_on, silent
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import LogError, UserError
from aerodima.workbench.figures.figure_style import MODE_STYLES
from aerodima.workbench.logs.journal import journal_path
from aerodima.workbench.logs.schema import RunLog, read_run_log, software_versions
from aerodima.workbench.metrics.run_summary import KM_PER_H, RunSummary, summarise
from aerodima.workbench.report.report_page import Page, Section, write_files
from aerodima.workbench.report.short_turn import load_short_turn

DEMO_SCHEMA = "aerodima/demo/2"
PAGE, SUMMARY, MARK, FINISHED = "index.html", "summary.csv", "demo.json", "finished"
"""`MARK` says of which scenarios a folder's logs are, and whether the demo is finished."""


@dataclass(frozen=True)
class DemoPlan:
    """Which turns are run and which of them are shown in full.

    Args:
        speeds: commanded, m/s.
        tail_modes: of `none`, `held`, `swing`, `designed`; scenarios `turn_<mode>`.
        shown: (tail mode, speed) of the runs with replay and strip.
        seed: of every run.
        settings: overrides of every scenario, such as `manoeuvre.duration=3.0`.
        opening: whether the page begins with the short turn of the shipped table, four runs more.
    """

    speeds: tuple[float, ...] = tuple(whole / KM_PER_H for whole in (12, 13, 16, 17))
    tail_modes: tuple[str, ...] = ("none", "swing")
    shown: tuple[tuple[str, float], ...] = (("none", 13 / KM_PER_H), ("swing", 16 / KM_PER_H))
    seed: int = 1
    settings: tuple[str, ...] = ()
    opening: bool = True


@dataclass(frozen=True)
class DemoRun:
    """One run of a demo: its name, scenario and files.

    Attributes:
        name: tail mode and speed in m/s.
        scenario: resolved.
        log: Parquet file.
        replay: HTML file; None for a run that is not shown in full.
        strip: PNG file; None likewise.
        opening: whether it is of the short turn, not of the published one.
    """

    name: str
    scenario: dict[str, Any]
    log: Path
    replay: Path | None
    strip: Path | None
    opening: bool = False

    @property
    def files(self) -> list[Path]:
        """Everything that is made of the run."""
        return [path for path in (self.log, self.replay, self.strip) if path is not None]


def make_demo(
    out: Path,
    plan: DemoPlan | None = None,
    *,
    workers: int = 2,
    force: bool = False,
    progress: ProgressLine = silent,
) -> Path:
    """Runs the demo and writes its page; the path of the page.

    A demo that was interrupted goes on where it stopped when it is asked for again: finished logs of the same scenario
    and versions are kept.

    Args:
        out: folder; made when it is not there.
        plan: what to run; the short turn, and the thesis' turn on both sides of its two flips, by default.
        workers: processes.
        force: make a finished demo again, or write among other files.
        progress: told lines of progress.

    Raises:
        UserError: workers out of range; the folder holds a finished demo, another one's logs or foreign files, or
            cannot be written. Nothing is overwritten without `force`.
    """
    plan = plan or DemoPlan()
    check_workers(workers)
    runs = demo_runs(out, plan)
    bar = ProgressBar(progress, len(runs))

    def done(_count: int, summary: RunSummary) -> None:
        bar.one_more(f"{summary.name}: {summary.metrics.outcome.result}")

    kept = lambda: f"{sum(run.log.exists() for run in runs)} of {len(runs)} logs"  # noqa: E731
    with _claimed(out, runs, force) as store, saying_how_to_go_on(progress, kept):
        progress(f"{len(runs)} runs in {min(workers, len(runs))} process(es), results in {out}")
        summaries = run_batch(do_run, runs, workers, done, progress=progress, record=out / WORKER_RECORD)
        progress("writing table and page ...")
        _write_page(out, runs, summaries)
        store.add(FINISHED, {})
    return out / PAGE


def demo_runs(out: Path, plan: DemoPlan) -> list[DemoRun]:
    """The runs of a plan, with their files below `out`."""
    runs = []
    for mode in plan.tail_modes:
        for speed in plan.speeds:
            settings = [f"manoeuvre.speed={speed!r}", f"seed={plan.seed}", *plan.settings]
            name = f"{mode}_{speed:.2f}"
            shown = (mode, speed) in plan.shown
            runs.append(
                DemoRun(
                    name=name,
                    scenario=load_scenario(f"turn_{mode}", settings).resolved(),
                    log=out / "logs" / f"turn_{name}.parquet",
                    replay=out / f"replay_{name}.html" if shown else None,
                    strip=out / f"strip_{name}.png" if shown else None,
                )
            )
    runs.sort(key=lambda run: run.replay is None)  # the longest pieces of work first
    return [*_short_turn_runs(out, plan.seed), *runs] if plan.opening else runs


def _short_turn_runs(out: Path, seed: int) -> list[DemoRun]:
    """All candidates of the short turn in the case that is shown, steered alike."""
    table = load_short_turn()
    runs = []
    for one in table.entries.candidates:
        scenario = table.scenario(one.name, table.steering_deg).resolved() | {"seed": seed}
        log = out / "logs" / f"{one.name}.parquet"
        runs.append(DemoRun(f"short turn, {one.name}", scenario, log, None, None, opening=True))
    return runs


def do_run(run: DemoRun) -> RunSummary:
    """Makes log, replay and strip of a run as far as they are missing, and measures the run."""
    if run.log.exists():
        try:
            log = read_run_log(run.log)
        except LogError as error:
            raise UserError(f"{error}; --force makes it again") from None
        if (log.scenario, log.versions) != (run.scenario, software_versions()):
            raise UserError(f"{run.log}: is of another scenario, seed or version; choose another folder, or --force")
    else:
        from aerodima.workbench.config.scenario import scenario_from_dict
        from aerodima.workbench.simulate.simulation import simulate

        journal_path(run.log).unlink(missing_ok=True)  # of a demo that was killed
        log = simulate(scenario_from_dict(run.scenario), run.log)
    if run.replay is not None and not run.replay.exists():
        from aerodima.workbench.report.replay_page import write_replay_html

        write_replay_html(log, run.replay)
    if run.strip is not None and not run.strip.exists():
        from aerodima.workbench.replay.strip import write_strip

        write_strip(log, run.strip)
    return summarise(log, run.name)


def _claimed(out: Path, runs: Sequence[DemoRun], force: bool) -> RowStore:
    """Makes the folder this demo's, or says why it must not be."""
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: is a file, a folder is needed")
    scenarios = {run.name: run.scenario for run in runs}
    identity = {"schema": DEMO_SCHEMA, "versions": software_versions(), "scenarios": scenarios}
    store = RowStore(out / MARK, identity, force=force, alone=True)
    if FINISHED in store.rows:
        store.close()
        raise UserError(f"{out}: holds a finished demo already; choose another folder, or --force to make it again")
    make_folder(out / "logs", UserError)
    for path in [out / PAGE, out / SUMMARY, *(path for run in runs for path in run.files)] if force else ():
        path.unlink(missing_ok=True)
    return store


def _write_page(out: Path, runs: Sequence[DemoRun], summaries: Sequence[RunSummary]) -> None:
    from aerodima.workbench.report.demo_chapters import RunFiles, provenance, thesis_turn_chapter

    modes = list(MODE_STYLES)
    first = {run.log.stem: read_run_log(run.log) for run in runs if run.opening}
    runs = [run for run in runs if not run.opening]
    own = {run.name for run in runs}
    ordered = sorted(
        (s for s in summaries if s.name in own), key=lambda s: (modes.index(s.tail_mode), s.commanded_speed)
    )
    numbers = pd.DataFrame([{"run": s.name, **s.as_row(), **s.impulses_row()} for s in ordered])

    def beside(path: Path) -> str:
        return path.relative_to(out).as_posix()

    files = RunFiles(
        summary=SUMMARY,
        logs={run.name: beside(run.log) for run in runs},
        replays={run.name: beside(run.replay) for run in runs if run.replay is not None},
        strips={run.name: beside(run.strip) for run in runs if run.strip is not None},
    )
    last = (
        thesis_turn_chapter(ordered, files),
        provenance({run.name: read_run_log(run.log) for run in runs}, files),
    )
    write_files(out, {SUMMARY: numbers, PAGE: _page(first, last)})


def _page(first: Mapping[str, RunLog], last: tuple[Section, ...]) -> Page:
    """The page; `first` are the runs of the short turn, which come before the last chapters when there are any."""
    if not first:
        return Page("The car turns, with and without its tail", "", last)
    from aerodima.workbench.report.demo_chapters import lead_of, short_turn_chapter

    table = load_short_turn()
    return Page("One turn, four cars", lead_of(table, first), (*short_turn_chapter(table, first), *last))
