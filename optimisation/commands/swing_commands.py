"""`aerodima optimise corner` and `verify`: find a tail swing, judge it on the full car."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.optimisation.commands.corner_command import corner
from aerodima.workbench.cli.options import (
    SWINGS,
    Ensemble,
    Force,
    Members,
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
