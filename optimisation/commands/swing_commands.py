"""`aerodima swing search`, `judge`, `train` and `verify`: find laws and motions of the
tail, compare what they gain.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from aerodima import optimisation
from aerodima.optimisation.commands.study_commands import runs_in
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import SweepError, SwingError
from aerodima.workbench.core.extras import require

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.studies.runs import CachedRunner
Step = Annotated[
    float,
    typer.Option(help="Step of the plant, s; a claim needs that of 0.0005.", min=1e-5, max=0.005),
]
TestCars = Annotated[int, typer.Option(help="So many of the test cars.", min=1)]


def _candidate_names() -> list[str]:
    from aerodima.optimisation.swerve.suite import NAMED_CANDIDATES

    return list(NAMED_CANDIDATES)


Reduced = Annotated[
    bool, typer.Option("--reduced", help="Reduced cars alone: minutes instead of hours.")
]
Further = Annotated[
    int, typer.Option(help="Full runs with which each candidate is searched on.", min=0)
]
Standard = Annotated[
    bool, typer.Option("--standard", help="Also drive NHTSA's fishhook and J-turn.")
]
MotionLimits = Annotated[
    list[str] | None,
    typer.Option(
        help="roll=0.3 (rad), energy=5 (J), torque=20 (N m) at most, speed=5 (m/s) at least; "
        "may be repeated."
    ),
]
Candidates = Annotated[
    list[str] | None,
    typer.Option(
        help="none, low-ballast, folded, held, published, feedback, bound, rollover-control, "
        "feedback-rollover-control, careful-control, feedback-careful-control, bound-announced, a "
        "swing, or a file of candidates; may be repeated; by default the first nine. The car "
        "without tail always takes part.",
        autocompletion=_candidate_names,
    ),
]
Aims = Annotated[
    list[str] | None,
    typer.Option(
        help="aside-0.5, aside-1.0, course, sustained, or mine.py:my_aim; may be repeated; by "
        "default aside-0.5, of a training also aside-1.0."
    ),
]


@dataclass(frozen=True)
class CaseOptions:
    """Cars, floors, tail and speeds of a comparison."""

    ensemble: cli.Ensemble = "physical"
    floors: Annotated[
        list[float] | None,
        typer.Option(
            "--floor", help="Friction over that of the car; may be repeated; by default 1."
        ),
    ] = None
    tail: Annotated[
        str, cli.chosen("Tail: that of each car, or the larger one.", "built", "designed")
    ] = "built"
    speeds: Annotated[
        list[float] | None,
        typer.Option("--speed", help="m/s; may be repeated; by default 4, 6 and 8."),
    ] = None
    seed: Annotated[
        int, typer.Option(help="Of the split of the cars, and of all draws.", min=0)
    ] = 1

    def arguments(self) -> dict[str, Any]:
        """Returns arguments of `judge` and `train_law`."""
        arguments: dict[str, Any] = {
            "ensemble": self.ensemble,
            "tail": self.tail,
            "floors": self.floors or [1.0],
        }
        if self.speeds:
            arguments["speeds"] = self.speeds
        return arguments


@dataclass(frozen=True)
class MotionOptions:
    """Options of the search of a motion; their fields are those of `BoundEffort`."""

    members: Annotated[int, typer.Option(help="Of a generation of the first search.", min=8)] = 150
    generations: Annotated[int, typer.Option(help="Of the first search.", min=0)] = 40
    starts: Annotated[int, typer.Option(help="Of the nonlinear program.", min=1, max=1000)] = 4
    iterations: Annotated[int, typer.Option(help="Most iterations from a start.", min=1)] = 20
    solver: Annotated[str, cli.chosen("Of the program.", "snopt", "ipopt")] = "snopt"


def register(app: typer.Typer) -> None:
    """Adds the group `swing`."""
    group = cli.command_group(
        app, "swing", "Search laws and motions of the tail, and judge their gain.", cli.SWINGS
    )
    for command in (search, judge, train, verify):
        group.command()(command)


@cli.grouped
def search(
    out: Annotated[
        Path, cli.written("Folder for what is found and its runs; a stopped search goes on in it.")
    ],
    aim: Annotated[
        str,
        typer.Option(
            help="aside-0.5, aside-1.0, course, sustained, or a function of yours, mine.py:my_aim."
        ),
    ] = "aside-0.5",
    limit: MotionLimits = None,
    cars: Annotated[
        int, typer.Option(help="So many training cars, one motion for all.", min=1)
    ] = 1,
    step: Step = 0.0005,
    *,
    options: CaseOptions,
    motion: MotionOptions,
    work: cli.WorkOptions,
) -> None:
    """Search motion of the tail and steering as one nonlinear program.

    The motion is written as swing.yaml, with the steering that the first full car holds, compared
    with other candidates, and verified. Exits with 1 where it is refused or not the best. After
    Ctrl-C the same command continues. Needs the extra `search`.

    Example: aerodima swing search --floor 1.2 --speed 6 --out out/motion
    """
    from aerodima.optimisation.swerve.reduced_swerves import check_aims
    from aerodima.optimisation.swing.motion_search import search_motion
    from aerodima.optimisation.swing.swerve_shooting import read_limits

    require("search", "swing search", "llvmlite", error=SwingError)
    path = out / "swing.yaml"
    check_aims([aim])
    read_limits(limit or [])
    with _new_file(path, work) as runs:
        table, complaints = search_motion(
            path,
            aim,
            limit or [],
            cars,
            runs,
            optimisation.BoundEffort(**vars(motion), seed=options.seed),
            step=step,
            **options.arguments(),
        )
    typer.echo(
        table[["candidate", "car", "value", "reduced_value", "share"]].to_string(index=False)
    )
    if complaints:
        typer.echo(f"{path}: not accepted: {'; '.join(complaints)}", err=True)
        raise typer.Exit(cli.Status.NO)
    typer.echo(f"found and verified: {path}")


@cli.grouped
def judge(
    out: Annotated[
        Path, cli.written("Folder for table, summary, swings and runs; it goes on in it.")
    ],
    candidate: Candidates = None,
    law: cli.Laws = None,
    aim: Aims = None,
    cars: TestCars = 4,
    step: Step = 0.0005,
    reduced: Reduced = False,
    further: Further = 0,
    standard: Standard = False,
    settings: cli.Settings = None,
    *,
    options: CaseOptions,
    work: cli.WorkOptions,
) -> None:
    """Compare candidates in swerves, each with its own best steering.

    Steerings are searched on reduced cars and driven on the full car at the fine step, scaled to
    where it just stays upright. Exits with 1 when no candidate with a tail is above the car without
    one. Asked for again after Ctrl-C, or with more cars, it keeps the runs that are there.

    Example: aerodima swing judge --cars 1 --speed 6 --candidate feedback --out out/judge
    """
    from aerodima.optimisation.swerve.reduced_swerves import check_aims
    from aerodima.optimisation.swerve.suite import SUITE
    from aerodima.optimisation.swerve.swerve_table import has_gain, swerve_lines, swerve_page
    from aerodima.workbench.view.report_page import write_files

    names = candidate or SUITE.default
    aims = aim or ["aside-0.5"]
    check_aims(aims)
    files: dict[str, Any] = {}
    with runs_in(out, work) as runs:
        table = optimisation.judge(
            names,
            laws=law or (),
            aims=aims,
            cars=cars,
            seed=options.seed,
            folder=out,
            runs=runs,
            step=None if reduced else step,
            further=0 if reduced else further,
            conditions=settings or (),
            **options.arguments(),
        )
        if standard:
            files["standard.csv"] = _standard(
                names, law or (), cars, options, tuple(settings or ()), runs
            )
    summary = optimisation.summarise_swerves(table)
    files |= {"swerves.csv": table, "summary.csv": summary}
    write_files(out, {**files, "report.html": swerve_page(table, summary)}, error=SweepError)
    typer.echo("\n".join(swerve_lines(summary)))
    typer.echo(f"written: {', '.join(files)} and report.html in {out}")
    if not has_gain(summary):
        typer.echo("no candidate with a tail is above the car without one", err=True)
        raise typer.Exit(cli.Status.NO)


def _standard(
    names: Sequence[str],
    laws: Sequence[str],
    cars: int,
    options: CaseOptions,
    conditions: tuple[str, ...],
    runs: CachedRunner,
) -> pd.DataFrame:
    """Drives the manoeuvres of the standard with all candidates but bounds, which have no law."""
    from aerodima.optimisation.swerve.standard_manoeuvres import compare_standard
    from aerodima.optimisation.swerve.suite import BOUNDS, ensemble_cases, select_candidates

    where = options.arguments() | {"seed": options.seed}
    where.pop("speeds", None)
    cases = ensemble_cases(part="test", number=cars, conditions=conditions, **where)
    chosen = [one for one in select_candidates(names, laws) if one not in BOUNDS]
    return compare_standard(chosen, cases, runs)


@cli.grouped
def train(
    out: Annotated[
        Path,
        cli.written("Folder for candidates.yaml and the runs; a stopped search goes on in it."),
    ],
    work: cli.WorkOptions,
    options: CaseOptions,
    candidate: Annotated[
        Literal["feedback", "rollover-control", "feedback-rollover-control"],
        typer.Option(help="Whose numbers are searched."),
    ] = "feedback",
    aim: Aims = None,
    cars: Annotated[int, typer.Option(help="So many of the training cars.", min=1)] = 6,
    laws: Annotated[int, typer.Option(help="Of a generation.", min=4)] = 16,
    generations: Annotated[int, typer.Option(help="Of a round.", min=1)] = 60,
    rounds: Annotated[
        int, typer.Option(help="Each has the best steerings of the law before.", min=1)
    ] = 3,
    around: Annotated[
        float,
        typer.Option(help="Spread of the first generation, as a share of the ranges."),
    ] = 0.1,
) -> None:
    """Search the numbers of the feedback law or of a rollover control.

    For swerves of reduced training cars; they are written as candidates.yaml. A rollover control is
    trained for a driver at full lock, without tail or together with the law.

    Example: aerodima swing train --cars 2 --laws 4 --generations 1 --rounds 1 --out out/train
    """
    from aerodima.optimisation.swerve.reduced_swerves import check_aims

    path = out / "candidates.yaml"
    check_aims(aim or [])
    search = optimisation.LawSearch(laws, generations, options.seed, around, rounds)
    with _new_file(path, work) as runs:
        optimisation.train_law(
            out,
            search,
            candidate=candidate,
            cars=cars,
            aims=aim,
            runs=runs,
            force=work.force,
            **options.arguments(),
        )
    typer.echo(f"found: {path}")
    split = f"--ensemble {options.ensemble} --tail {options.tail} --seed {options.seed}"
    typer.echo(f"judge it: aerodima swing judge --candidate {path} {split} --out {out / 'judge'}")


@contextmanager
def _new_file(path: Path, work: cli.WorkOptions) -> Iterator[CachedRunner]:
    """Opens the runs of a search whose result is a file that does not exist yet, unless forced."""
    refuse_existing(path, work.force, SwingError)
    with runs_in(path.parent, work) as runs:
        yield runs


def verify(
    swing: cli.SwingArgument,
    out: Annotated[Path, cli.written("Folder for verification.yaml and report.html.")],
    scenario: cli.OtherScenario = None,
    settings: cli.Settings = None,
    step: Step = 0.0005,
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
    for file in write_verification(out, result):
        typer.echo(f"written: {file}")
    subject = f"{result.swing.name} at {result.where}"
    if result.complaints:
        typer.echo(f"not verified: {subject}: {'; '.join(result.complaints)}", err=True)
        raise typer.Exit(cli.Status.NO)
    typer.echo(f"verified: {subject}")
