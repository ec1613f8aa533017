"""`aerodima corner`: who turns further on the same floor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.study_commands import engine_for
from aerodima.workbench.cli.options import SWINGS, Ensemble, OtherCar, ScenarioOption, WorkOptions, grouped


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=SWINGS)(corner)


@grouped
def corner(
    out: Annotated[Path, typer.Option(help="Folder for tables, page and runs; a stopped study goes on in it.")],
    work: WorkOptions,
    scenario: ScenarioOption = "turn_fast",
    candidate: Annotated[
        list[str] | None,
        typer.Option(
            help="none, low-ballast, low-centre, held, published, constant, trained, trained-by-yaw; may be repeated; "
            "by default all but the last."
        ),
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(help="Swing file, list of laws, or name of one that ships (best_swing); may be repeated."),
    ] = None,
    other_car: OtherCar = False,
    disturbed: Annotated[
        int,
        typer.Option(
            help="Runs of each candidate in each case with air, grip, motors and release off plan.", min=0, max=1000
        ),
    ] = 0,
    ensemble: Ensemble = "car",
    seed: Annotated[
        int, typer.Option(help="Of the split into training and test cars, and of the disturbances.", min=0)
    ] = 1,
    cars: Annotated[int, typer.Option(help="Test cars.", min=1)] = 4,
    car: Annotated[list[str] | None, typer.Option(help="This test car alone; may be repeated.")] = None,
    training: Annotated[int, typer.Option(help="Training cars, for the laws constant and trained.", min=1)] = 4,
    speed: Annotated[
        list[float] | None, typer.Option(help="m/s; may be repeated; by default 4.5.", min=1, max=8)
    ] = None,
    floor: Annotated[
        list[float] | None,
        typer.Option(help="Friction over the critical one; may be repeated; by default 1.1 and 1.3.", min=0.5, max=3.0),
    ] = None,
    pulse: Annotated[
        list[float] | None,
        typer.Option(
            help="Length of the steering, s; may be repeated; by default 0.5. Laws are trained for the first."
        ),
    ] = None,
    reduced: Annotated[
        bool, typer.Option("--reduced", help="Judge on reduced cars: many pulses in seconds, nothing proved.")
    ] = False,
    course: Annotated[
        list[int] | None, typer.Option(help="Also the time to this course: 45, 60 or 90 degrees; may be repeated.")
    ] = None,
    steering: Annotated[
        tuple[float, float], typer.Option(help="Least and largest amplitude that is tried, degrees.")
    ] = (2.0, 30.0),
    fixed: Annotated[bool, typer.Option("--fixed", help="Also with steering fixed from the training cars.")] = False,
    levels: Annotated[int, typer.Option(help="Of the steering; 2 takes seven times as long.", min=1, max=2)] = 1,
    runs: Annotated[int, typer.Option(help="Of each search for an amplitude.", min=3, max=50)] = 9,
    laws: Annotated[
        int, typer.Option(help="When laws are trained: of a generation, for each number that is free.", min=3)
    ] = 6,
    generations: Annotated[int, typer.Option(help="Of these beside the first one, on reduced cars.", min=0)] = 15,
    finalists: Annotated[int, typer.Option(help="Of the laws, driven by the full training cars.", min=1)] = 5,
    replays: Annotated[bool, typer.Option(help="Show the case in the middle: paths, and replays in step.")] = True,
) -> None:
    """Who turns the car further on the same floor, each with its own best steering: course turned by 0.5 s of it.

    Asked for again after Ctrl-C, or with more cars, speeds, floors or pulses, it keeps the runs that are there.
    Example: aerodima corner --cars 4 --speed 4.5 --out out/corner
    """
    from math import radians

    from aerodima.optimisation.studies.corner_page import corner_pulses, make_corner, summary_cells
    from aerodima.optimisation.studies.corner_plan import (
        ONE_LEVEL,
        PULSE,
        STANDARD,
        TWO_LEVELS,
        CornerPlan,
        chosen_cars,
        candidates_of,
    )
    from aerodima.optimisation.studies.disturbed_turns import survival_cells
    from aerodima.optimisation.studies.law_files import read_laws
    from aerodima.optimisation.studies.law_search import LawSearch
    from aerodima.optimisation.studies.pulse_lengths import pulse_rows
    from aerodima.optimisation.studies.steering_search import SteeringSearch
    from aerodima.workbench.config.ensemble import load_ensemble
    from aerodima.workbench.errors import SweepError
    from aerodima.workbench.text_table import text_table

    chosen = candidates_of(candidate or STANDARD)
    players = [player for name in law or () for player in read_laws(name, scenario, other_car=other_car)]
    split = load_ensemble(ensemble).split(seed)
    for option, asked, part in (("--cars", cars, split.test), ("--training", training, split.training)):
        if asked > len(part):
            raise SweepError(f"{option} {asked}: the ensemble has {len(part)}; allowed: 1 to {len(part)}")
    test = chosen_cars(split.test, car) if car else list(split.test[:cars])
    low, high = map(radians, steering)
    plan = CornerPlan(
        scenario,
        tuple(speed or (4.5,)),
        tuple(floor or (1.1, 1.3)),
        tuple(course or ()),
        tuple(pulse or (PULSE,)),
        reduced,
        (ONE_LEVEL, *(TWO_LEVELS if levels == 2 else ())),
        fixed,
        SteeringSearch(low, high, runs=runs),
        training=LawSearch(laws, generations, finalists, seed),
        disturbed=disturbed,
        seed=seed,
    )
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        measured, summary, files = make_corner(
            out,
            plan,
            chosen,
            players,
            test,
            split.training[:training],
            engine,
            force=work.force,
            progress=progress,
            show_case=replays,
        )
    several = len(plan.pulses) > 1
    cells = pulse_rows(corner_pulses(measured.cases)) if several else summary_cells(summary)
    typer.echo("\n".join(text_table(*cells)))
    if len(measured.disturbed):
        typer.echo("\n".join(["disturbed runs:", *text_table(*survival_cells(measured.survival))]))
    typer.echo(f"page: {files[-1]}")
