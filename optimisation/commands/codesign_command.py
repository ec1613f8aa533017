"""`aerodima optimise tail`: tail and law designed together, for one car or for the cars of an ensemble."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.study_commands import engine_for
from aerodima.workbench.cli.options import Ensemble, ScenarioOption, WorkOptions, grouped


@grouped
def tail(
    out: Annotated[Path, typer.Option(help="Folder for tables, page and runs; a stopped search goes on in it.")],
    work: WorkOptions,
    scenario: ScenarioOption = "turn_fast",
    budget: Annotated[
        list[str] | None,
        typer.Option(
            help="Most mass beyond the roll motor's output, kg, or free: what the motors bear; may be repeated; by "
            "default 0.15, 0.3 and free."
        ),
    ] = None,
    ensemble: Ensemble = "car",
    seed: Annotated[int, typer.Option(help="Of the split into training and test cars, and of the search.", min=0)] = 1,
    training: Annotated[
        int, typer.Option(help="Training cars that the tails are designed on; 0: the nominal car alone.", min=0)
    ] = 2,
    cars: Annotated[int, typer.Option(help="Unseen cars that they are judged on beside the nominal one.", min=0)] = 4,
    speed: Annotated[float, typer.Option(help="m/s.", min=1, max=8)] = 4.5,
    floor: Annotated[
        list[float] | None,
        typer.Option(
            help="Friction of the training cars over the critical one; may be repeated; by default 1.1 and 1.3.",
            min=0.5,
            max=3.0,
        ),
    ] = None,
    judge_floor: Annotated[
        list[float] | None,
        typer.Option(help="The same of the cars that are judged on; by default that of training.", min=0.5, max=3.0),
    ] = None,
    candidates: Annotated[int, typer.Option(help="Of a generation, for each of the 14 numbers.", min=3)] = 4,
    generations: Annotated[int, typer.Option(help="Of these beside the first one, on reduced cars.", min=0)] = 20,
    finalists: Annotated[
        int, typer.Option(help="Of each budget, on the full training cars; and of the thesis' tail.", min=1)
    ] = 3,
    runs: Annotated[int, typer.Option(help="Of each search for an amplitude on full cars.", min=3, max=50)] = 9,
    reduced_runs: Annotated[int, typer.Option(help="The same on reduced cars.", min=3, max=50)] = 7,
    samples: Annotated[
        int, typer.Option(help="Of the sensitivities on a reduced car, a power of two; 0 leaves them out.", min=0)
    ] = 64,
    mount: Annotated[
        list[float] | None,
        typer.Option(help="Place of the tail's joints ahead of the rear axle to compare, m; may be repeated."),
    ] = None,
    start: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of an earlier search whose finalists this one begins with, too; may be repeated."),
    ] = None,
    mounts: Annotated[bool, typer.Option(help="Compare places of the tail's joints.")] = True,
) -> None:
    """Design size, mass and mount of a tail with its law, for several budgets of mass, and judge them.

    Searched on reduced training cars, chosen on full ones, judged at 0.5 ms on the nominal and on unseen cars against
    the tail of the scenario, each with its own best steering. Asked for again, it goes on.
    Example: aerodima optimise tail --budget 0.15 --budget 0.3 --out out/codesign
    """
    from aerodima.optimisation.studies.codesign import MOUNTS, CodesignPlan
    from aerodima.optimisation.studies.codesign_page import PARTS, gain_cells, make_codesign
    from aerodima.optimisation.studies.corner_plan import CornerPlan
    from aerodima.optimisation.studies.law_search import LawSearch
    from aerodima.optimisation.studies.steering_search import SteeringSearch
    from aerodima.optimisation.studies.tail_family import read_tails
    from aerodima.workbench.config.ensemble import load_ensemble
    from aerodima.workbench.errors import SweepError
    from aerodima.workbench.text_table import text_table

    known = load_ensemble(ensemble)
    split = known.split(seed)
    for option, asked, part in (("--cars", cars, split.test), ("--training", training, split.training)):
        if asked > len(part):
            raise SweepError(f"{option} {asked}: the ensemble has {len(part)}; allowed: 0 to {len(part)}")
    floors = tuple(floor or (1.1, 1.3))
    search = LawSearch(candidates, generations, finalists, seed, reduced_runs)
    plan = CodesignPlan(
        CornerPlan(scenario, (speed,), floors, search=SteeringSearch(runs=runs), training=search),
        tuple(_kilograms(text) for text in budget or ("0.15", "0.3", "free")),
        tuple(judge_floor or floors),
        samples,
        tuple(mount or MOUNTS) if mounts else (),
        tuple(law for folder in start or () for law in read_tails(folder)),
    )
    own = split.training[:training] or (known.best,)
    with engine_for(out, work.workers, work.scheduler) as (engine, progress):
        found, summary, files = make_codesign(
            out, plan, known.best, split.test[:cars], own, engine, force=work.force, progress=progress
        )
    for judged in (name for name in PARTS if summary[f"{name}_cases"].any()):
        typer.echo("\n".join(text_table(*gain_cells(summary, judged))))
    for design in found.designs:
        typer.echo(f"{design.name}: {' '.join(design.settings)}")
    typer.echo(f"page: {files[-1]}")


def _kilograms(text: str) -> float:
    """A budget as it is asked for."""
    from math import inf, isfinite

    from aerodima.workbench.errors import SweepError

    if text == "free":
        return inf
    try:
        value = float(text.removesuffix("kg"))
    except ValueError:
        value = inf
    if not isfinite(value) or value <= 0.0:
        raise SweepError(f"--budget {text}: allowed: a mass in kg above 0, or free")
    return value
