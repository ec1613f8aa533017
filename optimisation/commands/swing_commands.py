"""`aerodima optimise corner` and `verify`: find a tail swing, judge it on the full car."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from aerodima.workbench.cli.options import (
    SWINGS,
    Ensemble,
    Force,
    Members,
    ScenarioArgument,
    Settings,
    SwingArgument,
    SwingScenarioOption,
    Workers,
)


def register(app: typer.Typer) -> None:
    """Adds the group `optimise` and the command `verify`."""
    group = typer.Typer(no_args_is_help=True, help="Find tail swings.")
    group.callback()(_group)
    group.command()(corner)
    app.add_typer(group, name="optimise", rich_help_panel=SWINGS)
    app.command(rich_help_panel=SWINGS)(verify)


def _group() -> None:
    """Find tail swings that turn the car further."""


def refuse_unwritable(folder: Path) -> None:
    """A search takes minutes: that its result cannot be written is said before it."""
    import tempfile

    from aerodima.workbench.errors import SwingError

    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as cause:
        raise SwingError(f"{folder}: cannot be written ({cause.strerror}); allowed: another --out") from None


def corner(
    scenario: ScenarioArgument = "turn_designed",
    out: Annotated[Path, typer.Option(help="Swing file to write.")] = Path("corner_swing.yaml"),
    members: Annotated[
        int, typer.Option(help="Training cars that the swing is for; 0: the scenario's own car.", min=0)
    ] = 0,
    ensemble: Ensemble = "car",
    split_seed: Annotated[int, typer.Option(help="Of the split into training and test cars.", min=0)] = 1,
    speed: Annotated[float | None, typer.Option(help="Of the turn, m/s; by default the scenario's.")] = None,
    floor: Annotated[
        float, typer.Option(help="Friction over the published swing's critical friction at full lock, per car.")
    ] = 1.3,
    starts: Annotated[int, typer.Option(help="Random starts.", min=1, max=1000)] = 7,
    seed: Annotated[int, typer.Option(help="Of the random starts.", min=0)] = 1,
    knots: Annotated[int, typer.Option(help="Of the tail's rate.")] = 11,
    length: Annotated[float, typer.Option(help="Of the tail's motion, s.")] = 0.8,
    iterations: Annotated[int, typer.Option(help="Most iterations from a start.")] = 60,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """Steering and tail roll as one programme: what turns cars furthest by 0.5 s of steering on their floors.

    Solved on reduced cars; the full car sets the floors, and drives what was found once, at 0.5 ms. The tail's motion
    is one for all cars, the steering each car's own; the file holds both.

    Example: aerodima optimise corner turn_designed --floor 1.3 --out corner_swing.yaml
    """
    from aerodima.optimisation.corner.corner_search import CornerOptions, find_turn
    from aerodima.optimisation.sweep.study_engine import SerialRunEngine
    from aerodima.workbench.atomic_write import make_folder, refuse_existing
    from aerodima.workbench.config.ensemble import load_ensemble
    from aerodima.workbench.config.swing_file import write_swing
    from aerodima.workbench.errors import SwingError

    refuse_existing(out, force, SwingError)
    make_folder(out.parent, SwingError)
    refuse_unwritable(out.parent)
    options = CornerOptions(floor, starts, seed, knots, length, iterations)
    given = (*(settings or ()), *(() if speed is None else (f"manoeuvre.speed={speed!r}",)))
    cars: list[tuple[str, tuple[str, ...]]] = [("car", given)]
    if members:
        training = load_ensemble(ensemble).split(split_seed).training
        if members > len(training):
            raise SwingError(
                f"--members {members}: the ensemble has {len(training)} training cars; allowed: up to that"
            )
        cars = [(car.name, (*car.settings_on(scenario), *given)) for car in training[:members]]
    found = find_turn(
        out.stem, scenario, cars, options, SerialRunEngine(), progress=lambda line: typer.echo(line, err=True)
    )
    write_swing(found, out, force=force)
    typer.echo(f"swing: {out}")
    typer.echo("\n".join(_turn_words(found.provenance.found, [name for name, _ in cars])))
    typer.echo(f"drive it: aerodima turn --swing {out}")


def _turn_words(facts: dict[str, Any], cars: list[str]) -> list[str]:
    """A line per car: its steering, and its course on reduced and full car."""
    from math import degrees

    lines = [f"{facts['starts_converged']} of {facts['starts']} starts converged in {facts['wall_time_s']:.0f} s"]
    for car in cars:
        first, then = (degrees(facts[f"{car}_{name}_rad"]) for name in ("first_angle", "steer_angle"))
        full = facts.get(f"{car}_full_car_course_rad")
        came = "no exit" if full is None else f"{degrees(full):.1f} deg"
        lines.append(
            f"{car}: {first:.1f} deg for {facts[f'{car}_first_hold_s']:.2f} s, then {then:.1f} deg; course "
            f"{degrees(facts[f'{car}_course_rad']):.1f} deg, full car {came}, "
            f"{'clean' if facts[f'{car}_full_car_clean'] else 'not clean'}"
        )
    return lines


def verify(
    swing: SwingArgument,
    out: Annotated[Path, typer.Option(help="Folder for verification.csv, verification.yaml and report.html.")],
    scenario: SwingScenarioOption = None,
    settings: Settings = None,
    ensemble: Ensemble = "car",
    members: Members = None,
    step: Annotated[float, typer.Option(help="Step of the plant, s.", min=1e-5, max=0.005)] = 0.0005,
    workers: Workers = 2,
    other_car: Annotated[bool, typer.Option("--other-car", help="Verify on another car than it was made for.")] = False,
    force: Force = False,
) -> None:
    """Simulate a swing forward at the fine step, on its own car and over the ensemble, and judge it.

    Verified is what survives clean, keeps its limits and clearances, and turns at least 95 % as far as the thesis'
    swing at the highest friction that both survive. Exits with 2 when it is not; the report is written all the same.
    Speed and friction are those that the file claims to survive, for all cars, unless --set says otherwise.

    Example: aerodima verify thesis_8_rad_per_s --members 3 --out out/verify
    """
    from aerodima.optimisation.sweep.study_engine import open_run_engine
    from aerodima.optimisation.swing.verification import verify_swing
    from aerodima.optimisation.swing.verification_report import PAGE, RUNS, VERDICT, write_verification
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.config.ensemble import load_ensemble
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.controllers.law_of_scenario import (
        find_swing,
        law_of_scenario,
        own_turn,
        refuse_other_car,
        turn_words,
    )
    from aerodima.workbench.errors import SwingError
    from aerodima.workbench.plants.clearance import make_range_of_motion

    for name in (RUNS, VERDICT, PAGE):
        refuse_existing(out / name, force, SwingError)
    played = find_swing(swing)
    turn, own = own_turn(played, scenario)
    wanted = [*own, *(settings or [])]
    path = str(Path(swing).resolve()) if Path(swing).exists() else swing
    given = ["tail.mode=swing", f"controller.swing_file={path}"]
    resolved = load_scenario(turn, [*wanted, *given])
    law_of_scenario(resolved)
    if not other_car:
        refuse_other_car(resolved)
    cars = load_ensemble(ensemble)
    motion = make_range_of_motion(resolved, 25, 25)
    runs = 2 * (len(cars.members) if members is None else min(members, len(cars.members)))
    typer.echo(f"{runs} runs of the ensemble at a step of {1000 * step:g} ms, and the car of the swing", err=True)

    with open_run_engine(workers, record=out / WORKER_RECORD) as engine:
        found = verify_swing(
            played, path, turn, wanted, cars, motion, members=members, step=step,
            engine=engine,
        )  # fmt: skip
    for file in write_verification(out, played, found, force=force):
        typer.echo(f"written: {file}")
    share = ", ".join(f"{who} {value:.0%}" for who, value in found.survival.items())
    typer.echo(f"share of the ensemble that survives clean: {share}")
    where = turn_words(played, resolved)
    if found.complaints:
        raise SwingError(f"swing {played.name}: not verified at {where}: {'; '.join(found.complaints)}")
    typer.echo(f"verified: {played.name} at {where}")
