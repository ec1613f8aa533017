"""`aerodima threshold ...`: where a car begins to roll over."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.cli.help_sections import SWINGS
from aerodima.workbench.cli.options import Anew, ScenarioArgument, Scheduler, Settings, Workers

if TYPE_CHECKING:
    from aerodima.optimisation.sweep.rollover_threshold import Search, Threshold


def register(app: typer.Typer) -> None:
    """Adds the group `threshold`."""
    group = typer.Typer(no_args_is_help=True, help="Find where a car begins to roll over.")
    group.callback()(_group)
    group.command()(speed)
    group.command()(friction)
    group.command("map")(survival)
    app.add_typer(group, name="threshold", rich_help_panel=SWINGS)


def _group() -> None:
    """Find where a car begins to roll over: by speed, by grip, or over both."""


def speed(
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    low: Annotated[float, typer.Option("--from", help="Lowest speed, m/s.")] = 2.5,
    high: Annotated[float, typer.Option("--to", help="Highest speed, m/s.")] = 6.5,
    scan: Annotated[float, typer.Option(help="Step of the scan, m/s; narrower islands may be missed.")] = 0.25,
    tolerance: Annotated[float, typer.Option(help="Between survived and flipped, m/s.")] = 0.05,
    workers: Workers = 2,
    scheduler: Scheduler = None,
) -> None:
    """Highest speed survived at the scenario's friction, the first at which it flips, and islands beyond.

    Example: aerodima threshold speed turn_none --to 4.5
    """
    from aerodima.optimisation.sweep.rollover_threshold import SPEED, Search

    _search(scenario, settings, Search(SPEED, low, high, scan, tolerance), "m/s", workers, scheduler)


def friction(
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    low: Annotated[float, typer.Option("--from", help="Lowest tyre friction.")] = 0.4,
    high: Annotated[float, typer.Option("--to", help="Highest tyre friction.")] = 1.1,
    scan: Annotated[float, typer.Option(help="Step of the scan; narrower islands may be missed.")] = 0.05,
    tolerance: Annotated[float, typer.Option(help="Between survived and flipped.")] = 0.01,
    workers: Workers = 2,
    scheduler: Scheduler = None,
) -> None:
    """Critical friction at the scenario's speed: highest tyre friction survived, first that flips, islands beyond.

    Example: aerodima threshold friction turn_swing --set manoeuvre.speed=4.44
    """
    from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search

    _search(scenario, settings, Search(FRICTION, low, high, scan, tolerance), "", workers, scheduler)


def survival(
    out: Annotated[Path, typer.Option(help="Folder for table, plot and page.")],
    scenario: ScenarioArgument = "turn_swing",
    settings: Settings = None,
    speeds: Annotated[tuple[float, float, int], typer.Option(help="First, last and number of speeds, m/s.")] = (
        3.0,
        6.0,
        7,
    ),
    frictions: Annotated[tuple[float, float, int], typer.Option(help="First, last and number of frictions.")] = (
        0.5,
        0.9,
        9,
    ),
    workers: Workers = 2,
    scheduler: Scheduler = None,
    force: Anew = False,
) -> None:
    """Survival over speed x friction, as a table and a plot; goes on where it was stopped.

    Example: aerodima threshold map turn_swing --out maps/swing
    """
    from aerodima.optimisation.studies.survival_study import survival_study, write_survival
    from aerodima.optimisation.sweep.study import Range
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import terminal

    axes = [Range(first=first, last=last, number=number) for first, last, number in (speeds, frictions)]
    study = survival_study(scenario, settings or [], *axes)
    say = terminal()
    with open_engine(workers, scheduler, say=say, record=out / WORKER_RECORD) as engine:
        page = write_survival(study, out, engine, force, say)
    print(f"report: {page}")


def _search(
    scenario: str, settings: list[str] | None, search: Search, unit: str, workers: int, scheduler: str | None
) -> None:
    from aerodima.optimisation.sweep.rollover_threshold import Case, find_thresholds
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch.progress import terminal
    from aerodima.workbench.config.scenario import load_scenario

    load_scenario(scenario, settings)
    say = terminal()
    with ExitStack() as stack:
        engine = stack.enter_context(open_engine(workers, scheduler, say=say))
        cases = [Case(scenario, scenario, tuple(settings or ()))]
        (found,) = find_thresholds(cases, search, engine, lambda done, known: say(f"[{done}/{known}] runs"))
    print("\n".join(describe(found, unit)))


def describe(found: Threshold, unit: str) -> list[str]:
    """Lines that say what a search came to."""
    from aerodima.optimisation.sweep.rollover_threshold import TIPPED

    search = found.search
    suffix = f" {unit}" if unit else ""
    name = search.factor
    if found.lost is None and found.survived is None:
        lines = [f"{name}: no run from {search.low:g} to {search.high:g}{suffix} came to its turn"]
    elif found.lost is None:
        lines = [f"{name}: no flip from {search.low:g} to {search.high:g}{suffix}; survives up to {found.survived:g}"]
    elif found.survived is None:
        lines = [f"{name}: flips at {found.lost:g}{suffix} already, the lowest value"]
    else:
        lines = [
            f"{name}: survives up to {found.survived:g}{suffix}, flips at {found.lost:g}{suffix} "
            f"(tolerance {search.tolerance:g}, {len(found.outcomes)} runs)"
        ]
        if found.lost - found.survived > search.tolerance + 1e-9:
            lines[0] += f"; the values between them, {found.lost - found.survived:.3g} apart, told nothing"
    if over := [value for value, outcome in found.outcomes.items() if outcome == TIPPED]:
        lines.append(f"{len(over)} run(s) tipped over before their turn, the first at {over[0]:g}: no evidence of it")
    for first, last in found.islands:
        where = f"at {first:g}" if first == last else f"from {first:g} to {last:g}"
        lines.append(f"island: survives again {where}{suffix} (scan step {search.scan:g})")
    if failed := [value for value, outcome in found.outcomes.items() if outcome.startswith("failed")]:
        lines.append(f"{len(failed)} run(s) failed, the first at {failed[0]:g}{suffix}: {found.outcomes[failed[0]]}")
    return lines
