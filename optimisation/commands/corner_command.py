"""`aerodima optimise corner`: steering and tail that together turn cars furthest on given floors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from aerodima.workbench.cli.options import Ensemble, Force, ScenarioArgument, Settings


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
    from aerodima.optimisation.commands.swing_commands import refuse_unwritable
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
