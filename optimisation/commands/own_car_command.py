"""`aerodima study swing`: a law of the tail for one's own car, trained, judged and compared in one piece of work."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.study_commands import engine_for
from aerodima.workbench.cli.options import (
    SWINGS,
    Ensemble,
    ScenarioArgument,
    Settings,
    WorkOptions,
    command_group,
    grouped,
)


def register(app: typer.Typer) -> None:
    """Adds the group `study`."""
    group = command_group(app, "study", "A question about your own car, answered in one piece of work.", SWINGS)
    group.command()(swing)


@grouped
def swing(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Folder for law, page, tables and runs; a stopped study goes on in it.")],
    work: WorkOptions,
    settings: Settings = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Few laws, generations and cars: a first answer in minutes.")
    ] = False,
    members: Annotated[int | None, typer.Option(help="Unseen cars that judge the law; by default 8.", min=1)] = None,
    training: Annotated[
        int | None, typer.Option(help="Cars it is trained on beside yours; by default 4.", min=1)
    ] = None,
    floor: Annotated[
        float, typer.Option(help="Friction over the published swing's critical one at full lock.", min=0.5, max=3.0)
    ] = 1.3,
    laws: Annotated[
        int | None, typer.Option(help="Of a generation, for each free number; by default 6.", min=3)
    ] = None,
    generations: Annotated[
        int | None, typer.Option(help="Of laws beside the first one, on reduced cars; by default 15.", min=0)
    ] = None,
    finalists: Annotated[
        int | None, typer.Option(help="Of the laws, driven by the full training cars; by default 5.", min=1)
    ] = None,
    runs: Annotated[
        int | None, typer.Option(help="Of each search for a steering amplitude; by default 9.", min=3, max=50)
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the laws, and of the split into training and unseen cars.", min=0)] = 1,
    ensemble: Ensemble = "car",
) -> None:
    """A swing for your car: a law that turns it furthest in 0.5 s, compared with four others, judged on unseen cars.

    What your scenario file and --set state holds for all cars; in everything else they differ as the ensemble's do.
    Asked for again after Ctrl-C, or for more members, it keeps the runs that are there.

    Example: aerodima study swing turn_designed --set car.mass=6.5 --quick --out out/my_car
    """
    from aerodima.optimisation.studies.own_car_page import own_rows, write_own_car
    from aerodima.optimisation.studies.own_car_study import (
        QUICK,
        TURN,
        Effort,
        possible_cars,
        stated_data,
        study_own_car,
    )
    from aerodima.workbench.text_table import text_table

    asked = {
        "members": members, "training": training, "laws": laws, "generations": generations, "finalists": finalists,
        "runs": runs,
    }  # fmt: skip
    given = {name: number for name, number in asked.items() if number is not None}
    effort = replace(QUICK if quick else Effort(), seed=seed, **given)
    possible_cars(stated_data(scenario, settings or ()), ensemble, effort)  # refused before the workers start
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        found = study_own_car(
            out, scenario, settings or (), effort, engine, floor=floor, ensemble=ensemble, force=work.force,
            progress=progress,
        )  # fmt: skip
        files = write_own_car(out, found)
    typer.echo("\n".join(text_table(*own_rows(found))))
    typer.echo(f"page: {files[-1]}")
    if out / TURN in files:
        typer.echo(f"drive it: aerodima turn --scenario {out / TURN}")
    typer.echo(found.sentence())
