"""`aerodima optimise swing`, `feedback` and `verify`: find a tail swing, give it feedback, judge it on the full car."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from aerodima.optimisation.commands.corner_command import corner
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
    """Adds the group `optimise` and the commands `feedback` and `verify`."""
    group = typer.Typer(no_args_is_help=True, help="Find tail swings.")
    group.callback()(_group)
    group.command()(swing)
    group.command()(corner)
    app.add_typer(group, name="optimise", rich_help_panel=SWINGS)
    for command in (feedback, verify):
        app.command(rich_help_panel=SWINGS)(command)


def _group() -> None:
    """Find tail swings that let the car turn with more grip or speed."""


def swing(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Swing file to write.")] = Path("swing.yaml"),
    dof: Annotated[int, typer.Option(help="1: roll; 2: roll and pitch.")] = 1,
    objective: Annotated[str, typer.Option(help="friction, speed, roll or effort.")] = "friction",
    seed: Annotated[int, typer.Option(help="Of the random starts.", min=0)] = 1,
    starts: Annotated[int, typer.Option(help="Random starts per round.", min=1, max=1000)] = 4,
    knots: Annotated[int, typer.Option(help="Of the first mesh.", min=11, max=121)] = 41,
    length: Annotated[float, typer.Option(help="Length of the swing from its release, s.", min=0.2, max=3.0)] = 1.0,
    threshold: Annotated[float | None, typer.Option(help="Yaw rate that releases the swing, rad/s.")] = None,
    wait: Annotated[float, typer.Option(help="Fixed rest after the release, s; 0 leaves it free.", min=0.0)] = 0.0,
    torque: Annotated[float | None, typer.Option(help="Torque limit, N m; the motor's by default.")] = None,
    rounds: Annotated[
        int, typer.Option(help="Most rounds of profile, solution, full car; 0: only refinement.", min=0, max=20)
    ] = 4,
    bound: Annotated[float, typer.Option(help="Largest collocation error, rad.")] = 5e-3,
    solver: Annotated[str, typer.Option(help="snopt or ipopt.")] = "snopt",
    members: Annotated[int, typer.Option(help="Cars drawn from the ensemble to serve as well.", min=0)] = 0,
    ensemble: Ensemble = "car",
    refine: Annotated[
        int,
        typer.Option(
            "--refine",
            "--polish",
            help="Candidates that the refinement drives on the full car; 0: none.",
            min=0,
            max=100_000,
        ),
    ] = 0,
    feedback: Annotated[bool, typer.Option(help="Store gains for the tracker with the swing.")] = True,
    workers: Workers = 2,
    wall_time: Annotated[float, typer.Option(help="Limit of the collocation, s.", min=1.0)] = 600.0,
    warm_start: Annotated[
        str | None, typer.Option(help="Swing to begin with: a file, or the name of one that ships.")
    ] = None,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """The swing with which the car survives most friction or speed, rolls least, or asks least of its motors.

    With --refine the full model refines it: most friction, turning at least 95 % as far as the published swing.
    An interrupted search goes on when the same command is given again.

    Example: aerodima optimise swing turn_swing --set manoeuvre.speed=4.5 --threshold 0.5 --out swing.yaml
    """
    from contextlib import nullcontext

    from aerodima.optimisation.sweep.study_engine import SerialRunEngine, open_run_engine
    from aerodima.optimisation.swing.search_state import LIMIT_REACHED, SearchOptions
    from aerodima.optimisation.swing.swing_problem import OBJECTIVES
    from aerodima.optimisation.swing.swing_search import optimise_swing
    from aerodima.workbench.atomic_write import make_folder, refuse_existing
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.config.swing_file import write_swing
    from aerodima.workbench.controllers.law_of_scenario import find_swing
    from aerodima.workbench.errors import SwingError

    chosen: Any = objective
    solver_name: Any = solver
    for flag, value, allowed in (
        ("--objective", objective, OBJECTIVES),
        ("--solver", solver, ("snopt", "ipopt")),
        ("--dof", dof, (1, 2)),
    ):
        if value not in allowed:
            raise SwingError(f"{flag}: {value!r}; allowed: {', '.join(map(str, allowed))}")
    refuse_existing(out, force, SwingError)
    make_folder(out.parent, SwingError)
    refuse_unwritable(out.parent)
    options = SearchOptions(
        dof=dof, objective=chosen, seed=seed, starts=starts, knots=knots, length=length, threshold=threshold, wait=wait,
        torque=torque, rounds=rounds, bound=bound, solver=solver_name, warm_start=warm_start or "",
        ensemble=ensemble, members=members,
        polish=refine, feedback=feedback, wall_time=wall_time,
    )  # fmt: skip
    turn = load_scenario(scenario, settings or ())
    record = out.with_suffix(".workers.jsonl")
    with open_run_engine(workers, record=record) if refine or workers > 1 else nullcontext(SerialRunEngine()) as engine:
        found = optimise_swing(
            turn, options, name=out.stem, scenario_name=scenario, settings=tuple(settings or ()),
            warm_start=None if warm_start is None else find_swing(warm_start),
            checkpoint=out.with_suffix(".search.json"), engine=engine, progress=lambda line: typer.echo(line, err=True),
        )  # fmt: skip
    write_swing(found, out, force=force)
    facts = found.provenance.found
    typer.echo(f"swing: {out}")
    if "survived_friction" in facts:
        typer.echo(
            f"full car: clean at {facts['survived_speed_m_per_s']:.2f} m/s, friction {facts['survived_friction']:.3f}, "
            f"peak roll {facts['peak_roll_rad']:.3f} rad"
        )
    if "heading_ratio" in facts:
        typer.echo(
            f"heading: {facts['heading_ratio']:.1%} of the published swing's at friction "
            f"{facts['reference_friction']:.3f}, the highest that both survive"
        )
    if LIMIT_REACHED in facts:
        typer.echo(f"stopped at its limit while it still gained: {facts[LIMIT_REACHED]}")
    if "collocation_error_rad" in facts:
        typer.echo(f"collocation error {facts['collocation_error_rad']:.4f} rad on {facts['knots']} knots")


def refuse_unwritable(folder: Path) -> None:
    """A search takes minutes: that its result cannot be written is said before it."""
    import tempfile

    from aerodima.workbench.errors import SwingError

    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as cause:
        raise SwingError(f"{folder}: cannot be written ({cause.strerror}); allowed: another --out") from None


def feedback(
    swing: SwingArgument,
    out: Annotated[Path, typer.Option(help="Swing file to write.")],
    scenario: SwingScenarioOption = None,
    settings: Settings = None,
    other_car: Annotated[bool, typer.Option("--other-car", help="Use another car than it was made for.")] = False,
    force: Force = False,
) -> None:
    """Run a swing on the full car, linearise the planar model along that run, and store finite-horizon LQR gains.

    Make them at the highest friction or speed that the swing survives by itself: there they know a car on two wheels.
    Example: aerodima feedback thesis_8_rad_per_s --set manoeuvre.speed=3.61 --out tracked.yaml
    """
    from aerodima.optimisation.swing.feedback_gains import with_feedback
    from aerodima.optimisation.swing.swing_construction import tied_to
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.config.swing_file import write_swing
    from aerodima.workbench.controllers.law_of_scenario import find_swing, own_turn, refuse_other_car
    from aerodima.workbench.errors import SwingFileError

    refuse_existing(out, force, SwingFileError)
    plain = find_swing(swing)
    turn, own = own_turn(plain, scenario)
    given = (*own, *(settings or []))
    resolved = load_scenario(turn, [*given, f"controller.swing_file={swing}"])
    if not other_car:
        refuse_other_car(resolved)
    tracked = with_feedback(plain, resolved)
    if not plain.car:
        tracked = tied_to(tracked, resolved, turn, given)
    write_swing(tracked, out, force=force)
    gains = tracked.gains.feedback
    assert gains is not None
    typer.echo(f"feedback on {', '.join(gains.states)} at {len(gains.time_s)} times over {gains.time_s[-1]:.2f} s")
    typer.echo(f"swing: {out}")


def verify(
    swing: SwingArgument,
    out: Annotated[Path, typer.Option(help="Folder for verification.csv, verification.yaml and report.html.")],
    scenario: SwingScenarioOption = None,
    settings: Settings = None,
    ensemble: Ensemble = "car",
    members: Members = None,
    step: Annotated[float, typer.Option(help="Step of the plant, s.", min=1e-5, max=0.005)] = 0.0005,
    tracking: Annotated[str, typer.Option(help="automatic, feedback, torque, joint_pd or open_loop.")] = "automatic",
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
    given = ["tail.mode=swing", f"controller.swing_file={path}", f"controller.tracking={tracking}"]
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
            played, path, turn, wanted, cars, motion, members=members, step=step, tracking=tracking,
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
