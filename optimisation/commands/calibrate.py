"""`aerodima calibrate`: from the published figures to the cars that they leave possible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workbench.help_sections import THESIS


def register(app: typer.Typer) -> None:
    """Adds the command `calibrate`."""
    app.command(rich_help_panel=THESIS)(calibrate)


def calibrate(
    out: Annotated[Path, typer.Option(help="Folder for runs, ensemble and report.")] = Path("out/calibration"),
    plan: Annotated[str, typer.Option(help="Plan: a name of models/calibration/plans, or a file.")] = "car",
    seed: Annotated[int | None, typer.Option(help="Seed; that of the plan when left out.")] = None,
    workers: Annotated[int, typer.Option(help="Processes on this computer.")] = 2,
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask scheduler instead.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Drop the runs that are in the folder.")] = False,
) -> None:
    """Calibrate the car: ensemble, best set, sensitivities, validation. Ctrl-C stops it; the same command goes on."""
    from optimisation.calibration.calibrate import BASE_SCENARIO
    from optimisation.calibration.calibrate import calibrate as carry_out
    from optimisation.calibration.output import write_calibration
    from optimisation.calibration.plan import load_plan
    from optimisation.calibration.runs import RunStore
    from optimisation.sweep.engine import open_engine
    from workbench.demo import terminal
    from workbench.scenario import load_scenario

    chosen = load_plan(plan)
    if seed is not None:
        chosen = chosen.model_copy(update={"seed": seed})
    store = RunStore(out, load_scenario(BASE_SCENARIO), (*chosen.car, *chosen.tail), force=force)
    say = terminal()
    try:
        with open_engine(workers, scheduler) as engine:
            result = carry_out(chosen, store, engine, say)
            report = write_calibration(result, out, store, engine, say)
    except KeyboardInterrupt:
        say(f"stopped: {len(store)} runs are in {store.path}; the same command goes on with the rest")
        raise
    typer.echo(report)
