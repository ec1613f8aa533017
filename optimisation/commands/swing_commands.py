"""`aerodima swing search`, `judge`, `train`, `bound` and `verify`: find laws and motions of the
tail, compare what they gain.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima import optimisation, workbench
from aerodima.optimisation.commands.study_commands import runs_in
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import SweepError, SwingError

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.judge.entry_speed import Case
    from aerodima.optimisation.studies.runs import CachedRunner
TestCars = Annotated[int, typer.Option(help="So many of the test cars.", min=1)]
Generations = Annotated[int, typer.Option(help="Of a search, beside the first one.", min=0)]


def _suite(table: str) -> list[str]:
    from aerodima.optimisation.judge import suite

    return list(getattr(suite, table))


def _task_keys() -> list[str]:
    from aerodima.optimisation.swing.task import Task

    return [f"{name}=" for name in Task.model_fields if name != "schema_"]


@dataclass(frozen=True)
class CaseOptions:
    """Cars, surfaces and tail of a comparison."""

    ensemble: cli.Ensemble = "physical"
    floors: Annotated[
        list[float] | None,
        typer.Option(
            "--floor", help="Friction over that of the car; may be repeated; by default 1."
        ),
    ] = None
    tail: Annotated[
        str, cli.chosen("Tail: that of each car, or the larger one.", "built", "designed")
    ] = "designed"
    seed: Annotated[
        int, typer.Option(help="Of the split of the cars, and of all draws.", min=0)
    ] = 1

    def cases(self, part: str, number: int) -> list[Case]:
        """Returns the first cars of a part of the ensemble, `training` or `test`, on surfaces."""
        from aerodima.optimisation.judge.suite import make_surfaces

        split = workbench.load_ensemble(self.ensemble).split(self.seed)
        cars = getattr(split, part)
        most = len(cars)
        if number > most:
            raise SweepError(
                f"--cars {number}: the part of the ensemble has {most}: must be 1 to {most}"
            )
        return make_surfaces(cars[:number], self.floors or [1.0])


@dataclass(frozen=True)
class ClimbOptions:
    """Speeds of a climb."""

    start: Annotated[float, typer.Option(help="First speed of a climb, m/s.")] = 2.0
    step: Annotated[
        float, typer.Option(help="Between two speeds of a climb, m/s; its last step is refined.")
    ] = 0.1
    ceiling: Annotated[float, typer.Option(help="Highest speed that is tried, m/s.")] = 8.0


@dataclass(frozen=True)
class MotionOptions:
    """Search of a motion; fields as those of `MotionSearch`."""

    starts: Annotated[int, typer.Option(help="Random starts of a motion.", min=1, max=1000)] = 7
    seed: Annotated[int, typer.Option(help="Of all draws.", min=0)] = 1
    knots: Annotated[int, typer.Option(help="Of the motion's rate.")] = 11
    length: Annotated[float, typer.Option(help="Of the motion, s.")] = 0.8
    iterations: Annotated[int, typer.Option(help="Most iterations of the motion from a start.")] = (
        30
    )


def register(app: typer.Typer) -> None:
    """Adds the group `swing`."""
    group = cli.command_group(
        app, "swing", "Search laws and motions of the tail, and judge their gain.", cli.SWINGS
    )
    for command in (search, judge, train, bound, verify):
        group.command()(command)


@cli.grouped
def search(
    task: Annotated[str, cli.named("Task", "tasks")],
    out: Annotated[
        Path, cli.written("Folder for what is found and its runs; a stopped search goes on in it.")
    ],
    work: cli.WorkOptions,
    motion: MotionOptions,
    settings: Annotated[
        list[str] | None, cli.setting("training=2 or speeds=[3.6,4.5]", _task_keys)
    ] = None,
) -> None:
    """Search motion and steering as one nonlinear program.

    On the training cars of a task; the motion is written as swing.yaml.

    Example: aerodima swing search short_turn_designed --set training=0 --out out/motion
    """
    from aerodima.optimisation.swing.motion_search import search_motion
    from aerodima.optimisation.swing.task import load_task
    from aerodima.workbench.scenario.swing_file import write_swing

    loaded = load_task(task, settings or ())
    effort = optimisation.MotionSearch(**vars(motion))
    path = out / "swing.yaml"
    with _new_file(path, work) as runs:
        swing = search_motion(out.name, loaded, effort, runs, progress=runs.say)
        write_swing(swing, path, force=work.force)
    _suggest_judge(path, workbench.load_scenario(loaded.scenario).tail.name)


@cli.grouped
def judge(
    out: Annotated[
        Path, cli.written("Folder for table, summary and runs; stopped climbs go on in it.")
    ],
    manoeuvre: Annotated[
        list[str] | None,
        typer.Option(
            help="turn, held-turn, twice, twice-late, fishhook, lane-change, slalom, corner, "
            "rising-steer; may be "
            "repeated; by default the first, second, fifth and sixth.",
            autocompletion=lambda: _suite("MANOEUVRES"),
        ),
    ] = None,
    candidate: Annotated[
        list[str] | None,
        typer.Option(
            help="none, low-ballast, held, upright, lying, published, feedback, best_swing, a "
            "swing, or a file of "
            "candidates; may be repeated; by default the first seven. The car without tail always "
            "takes part.",
            autocompletion=lambda: _suite("NAMED_CANDIDATES"),
        ),
    ] = None,
    law: cli.Laws = None,
    cars: TestCars = 4,
    *,
    options: CaseOptions,
    climbs: ClimbOptions,
    work: cli.WorkOptions,
) -> None:
    """Compare candidates by the speed at which a car may enter.

    It is the highest one at which a manoeuvre is completed without tip-up. Exits with 1 when no
    candidate with a tail is faster than the car without one. Asked for again after Ctrl-C, or with
    more cars or manoeuvres, it keeps the runs that are there.

    Example: aerodima swing judge --manoeuvre fishhook --cars 1 --candidate published --out
    out/judge
    """
    from aerodima.optimisation.judge import suite
    from aerodima.optimisation.judge.entry_rule import ERROR
    from aerodima.optimisation.judge.entry_search import EntrySearch

    search = EntrySearch(**vars(climbs))
    manoeuvres = suite.select_manoeuvres(manoeuvre or suite.TRAINING_MANOEUVRES, options.tail)
    candidates = suite.select_candidates(candidate or list(suite.CANDIDATES), law or ())
    cases = options.cases("test", cars)
    with runs_in(out, work) as runs:
        table = optimisation.find_entry_speeds(manoeuvres, candidates, cases, runs, search)
    is_faster = _write_entries(out, table)
    if table["ended_by"].astype(str).str.startswith(ERROR).any():
        raise typer.Exit(cli.Status.LEFT_OUT)
    if not is_faster:
        typer.echo("no candidate enters faster than the car without a tail", err=True)
        raise typer.Exit(cli.Status.NO)


def _write_entries(out: Path, table: pd.DataFrame) -> bool:
    """Writes the entry speeds and their summary; returns whether a tail is faster than none."""
    from aerodima.optimisation.judge.entry_page import entry_lines, entry_page
    from aerodima.optimisation.judge.entry_table import has_gain, summarise_entries

    summary = summarise_entries(table)
    page = entry_page(table, summary)
    _write(out, {"entries.csv": table, "summary.csv": summary, "report.html": page})
    typer.echo("\n".join(entry_lines(summary)))
    typer.echo(f"written: entries.csv, summary.csv and report.html in {out}")
    return has_gain(summary)


@cli.grouped
def train(
    out: Annotated[
        Path,
        cli.written("Folder for candidates.yaml and the runs; a stopped search goes on in it."),
    ],
    work: cli.WorkOptions,
    options: CaseOptions,
    cars: Annotated[int, typer.Option(help="So many of the training cars.", min=1)] = 6,
    laws: Annotated[
        int, typer.Option(help="Of a generation, for each number that is free.", min=3)
    ] = 4,
    generations: Generations = 8,
    around: Annotated[
        float,
        typer.Option(
            help="Share of the ranges around the present law that the first generation covers."
        ),
    ] = 0.3,
) -> None:
    """Search the numbers of the feedback law.

    For the entry speeds of reduced training cars; they are written as candidates.yaml.

    Example: aerodima swing train --cars 2 --laws 3 --generations 1 --out out/train
    """
    from aerodima.optimisation.judge.candidate import write_candidates
    from aerodima.optimisation.swing.feedback_training import LawSearch, train_feedback

    path = out / "candidates.yaml"
    cases = options.cases("training", cars)
    search = LawSearch(laws=laws, generations=generations, seed=options.seed, around=around)
    with _new_file(path, work) as runs:
        trained = train_feedback(cases, options.tail, search, runs)
    chosen = f"aerodima swing train --ensemble {options.ensemble} --tail {options.tail}"
    chosen += f" --cars {cars} --laws {laws} --generations {generations} --around {around}"
    chosen += f" --seed {options.seed}"
    for scale in options.floors or ():
        chosen += f" --floor {scale}"
    write_candidates(path, [trained], chosen, force=work.force)
    _suggest_judge(path, options.tail)


@cli.grouped
def bound(
    out: Annotated[
        Path, cli.written("Folder for bound.csv and the runs; a stopped search goes on in it.")
    ],
    work: cli.WorkOptions,
    options: CaseOptions,
    manoeuvre: Annotated[
        list[str] | None, typer.Option(help="lane-change or corner; by default both.")
    ] = None,
    cars: TestCars = 6,
    starts: Annotated[int, typer.Option(help="Of the search of a motion.", min=1)] = 7,
    generations: Generations = 80,
) -> None:
    """Find what any motion of the tail can reach on a path.

    The entry speed of reduced cars, each with its own motion and driver; other candidates have
    their own best driver.

    Example: aerodima swing bound --manoeuvre corner --cars 1 --starts 1 --generations 3 --out
    out/bound
    """
    from aerodima.optimisation.swing.bound import paths, search_bound

    names = paths(manoeuvre or ())
    cases = options.cases("test", cars)
    with runs_in(out, work) as runs:
        table = search_bound(names, cases, options.tail, starts, generations, runs)
    _write(out, {"bound.csv": table})
    typer.echo("entry speeds of reduced cars, m/s")
    typer.echo(table.to_string(index=False))
    typer.echo(f"written: {out / 'bound.csv'}")


@contextmanager
def _new_file(path: Path, work: cli.WorkOptions) -> Iterator[CachedRunner]:
    """Opens the runs of a search whose result is a file that does not exist yet, unless forced."""
    refuse_existing(path, work.force, SwingError)
    with runs_in(path.parent, work) as runs:
        yield runs


def _suggest_judge(path: Path, tail: str) -> None:
    """Prints where a result is, and the command that compares it with others."""
    typer.echo(f"found: {path}")
    out = path.parent / "judge"
    typer.echo(f"judge it: aerodima swing judge --tail {tail} --candidate {path} --out {out}")


def _write(out: Path, files: dict[str, Any]) -> None:
    from aerodima.workbench.view.report_page import write_files

    write_files(out, files, error=SweepError)


def verify(
    swing: cli.SwingArgument,
    out: Annotated[Path, cli.written("Folder for verification.yaml and report.html.")],
    scenario: cli.OtherScenario = None,
    settings: cli.Settings = None,
    step: Annotated[
        float, typer.Option(help="Step of the plant, s.", min=1e-5, max=0.005)
    ] = 0.0005,
    other_car: Annotated[
        bool, typer.Option("--other-car", help="Verify on another car than it was made for.")
    ] = False,
    force: cli.Force = False,
) -> None:
    """Check what a swing file promises, on its own car.

    Verified is what survives clean at the fine step and keeps its limits and clearances. Exits with
    1 when it is not; the report is written all the same. Speed and friction are those that the file
    claims to survive, unless --set says otherwise.
    `swing judge --candidate FILE` judges it on other cars.

    Example: aerodima swing verify thesis_8_rad_per_s --out out/verify
    """
    from aerodima.optimisation.swing.verification import (
        PAGE,
        VERDICT,
        verify_swing,
        write_verification,
    )

    for name in (VERDICT, PAGE):
        refuse_existing(out / name, force, SwingError)
    result = verify_swing(swing, scenario, settings or (), step=step, other_car=other_car)
    for file in write_verification(out, result, force=force):
        typer.echo(f"written: {file}")
    subject = f"{result.swing.name} at {result.where}"
    if result.complaints:
        typer.echo(f"not verified: {subject}: {'; '.join(result.complaints)}", err=True)
        raise typer.Exit(cli.Status.NO)
    typer.echo(f"verified: {subject}")
