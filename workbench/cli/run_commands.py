"""`aerodima run`, `demo`, `scenarios list`: simulated runs with logs, metrics and replays."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import make_folder, refuse_existing
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.text_table import shown_value, text_table

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from aerodima.workbench.car.run_view import Progress
    from aerodima.workbench.control.tail_law import TailLaw
    from aerodima.workbench.logs.schema import RunLog
    from aerodima.workbench.scenario.scenario import Scenario

SHOWN_METRICS = (
    "speed_m_per_s",
    "heading_change_rad",
    "peak_roll_rad",
    "max_yaw_rate_rad_per_s",
    "average_yaw_rate_rad_per_s",
    "max_linear_acceleration_m_per_s2",
    "filtered_max_linear_acceleration_m_per_s2",
)
"""Metrics of a run that the terminal shows; `aerodima log metrics` has all of them."""
SHOWN_FACTS = (
    "largest_reynolds_number",
    "sections_outside_measured_range",
    "sections_above_quasi_steady_limit",
)
"""Keys of `extra` of a log about the sections of a tail; the last two are shares of the time."""
_MIN_SWING = 0.2
"""Travel of the roll joint below which a tail has not swung, rad."""


@dataclass(frozen=True)
class RunOptions:
    """Changes to the scenario of a run, and what is kept and shown of the run."""

    scenario: cli.OtherScenario = None
    speed: Annotated[
        float | None, cli.Key("manoeuvre.speed"), typer.Option(help="Commanded speed, m/s.")
    ] = None
    tail: Annotated[
        str | None, cli.Key("tail.mode"), cli.chosen("What the tail does.", "none", "held", "swing")
    ] = None
    direction: Annotated[
        str | None, cli.Key("manoeuvre.direction"), cli.chosen("Side of the turn.", "left", "right")
    ] = None
    swing: Annotated[cli.SwingOption, cli.Key("controller.swing_file")] = None
    other_car: cli.OtherCar = False
    law: cli.Law = None
    diagram: cli.Build = None
    settings: cli.Settings = None
    out: cli.KeptLog = None
    html: cli.Html = None
    live: cli.Live = False
    force: cli.Force = False


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(rich_help_panel=cli.RUNS, no_args_is_help=True)(run)
    app.command(rich_help_panel=cli.RUNS)(demo)
    cli.command_group(app, "scenarios", "List the scenarios that ship.", cli.RUNS).command("list")(
        list_scenarios
    )


def demo(
    out: Annotated[Path, cli.written("Folder for page, table, replays and logs.")] = Path(
        "out/demo"
    ),
    workers: cli.Workers = 2,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 1,
    force: cli.Anew = False,
) -> None:
    """Drive a swerve of several cars in step and the thesis' own turn; write a page.

    Asked for again after Ctrl-C it keeps the finished runs and goes on. Example: aerodima demo
    --out out/demo
    """
    from aerodima.workbench.batch.row_store import terminal_progress
    from aerodima.workbench.view.demo import DemoPlan, make_demo

    start = time.monotonic()
    page = make_demo(
        out, DemoPlan(seed=seed), workers=workers, force=force, progress=terminal_progress()
    )
    typer.echo(f"page: {page} ({time.monotonic() - start:.0f} s)")


@cli.grouped
def run(options: RunOptions) -> None:
    """Simulate a scenario: a turn, slalom, lane change or your own.

    A swing file brings its own car, turn, speed and claimed grip along, unless a scenario is named
    with it.

    Example: aerodima run turn_swing --speed 4.44 --out run.parquet --html run.html
    """
    # The options are checked before Drake is imported, which takes seconds.
    from aerodima.workbench.control.swing_library import (
        find_swing,
        refuse_other_car,
        swing_of_scenario,
        turn_of_swing,
        turn_words,
    )

    drivers = {"--swing": options.swing, "--law": options.law, "--diagram": options.diagram}
    stated = [name for name, value in drivers.items() if value is not None]
    if len(stated) > 1:
        raise UserError(f"{' and '.join(stated)}: must be one only, since each drives the tail")
    if options.scenario is None and options.swing is None:
        raise UserError(
            "SCENARIO: missing; must be a file or a name of `aerodima scenarios list`, or --swing"
        )
    name = options.scenario
    own = tuple[str, ...]()
    if options.swing is not None:
        name, own = turn_of_swing(find_swing(options.swing), name)
    scenario = workbench.load_scenario(str(name), [*own, *cli.settings_of(options)])
    swing = swing_of_scenario(scenario)
    if swing is None and options.other_car:
        raise UserError("--other-car: needs a swing that is played, see --swing")
    if swing is None and options.swing is not None:
        raise UserError(f"--swing {options.swing}: needs --tail swing and controller.law=swing")
    law = None
    if options.law is not None:
        from aerodima.workbench.control.user_law import load_law

        if not scenario.has_tail:
            raise UserError(f"--law {options.law}: the car has no tail; needs --tail held or swing")
        law = load_law(options.law, scenario)
    if law is None and options.diagram is None and not options.other_car:
        refuse_other_car(scenario)
    refuse_existing(options.out, options.force, LogError)
    refuse_existing(options.html, options.force, UserError)
    if options.html is not None:
        make_folder(options.html.parent, UserError)
    run_log = _simulated(scenario, options, law)
    if own and swing is not None:
        typer.echo(f"turn: {scenario.name}, {turn_words(swing, scenario)}")
    for line in summary_lines(run_log):
        typer.echo(line)
    if options.out is not None:
        typer.echo(f"log: {options.out}")
    if options.html is not None:
        from aerodima.workbench.view.replay_page import write_replay_html

        typer.echo(f"replay: {write_replay_html(run_log, options.html, force=options.force)}")


def _simulated(scenario: Scenario, options: RunOptions, law: TailLaw | None) -> RunLog:
    from aerodima.workbench.car.termination import turn_end
    from aerodima.workbench.control.user_law import load_build, traceback_and_reason
    from aerodima.workbench.logs.journal import journal_path

    duration = scenario.manoeuvre.duration
    end = turn_end(scenario)
    if scenario.manoeuvre.kind == "turn" and duration < end:  # its metrics need the whole turn
        raise UserError(
            f"manoeuvre.duration: {duration:g} s must be >= {end:g} s, the end of the turn"
        )
    build = None
    if options.diagram is not None:
        build = load_build(options.diagram)
    try:
        return workbench.simulate(
            scenario,
            options.out,
            law=law,
            build=build,
            force=options.force,
            meshcat=live_view() if options.live else None,
            real_time_rate=float(options.live),
            progress=show_progress(),
        )
    except UserError:
        raise
    except Exception as error:
        if build is None and options.law is None:
            raise
        text, reason = traceback_and_reason(error)
        typer.echo(text, err=True)
        place = f"--law {options.law}" if build is None else f"--diagram {options.diagram}"
        raise UserError(f"{place}: {reason}") from None
    except KeyboardInterrupt:
        if options.out is not None:
            typer.echo(
                f"the rows so far are kept: aerodima log recover {journal_path(options.out)}",
                err=True,
            )
        raise


def list_scenarios() -> None:
    """List the scenarios of the car, for `run`, and of the rigs, for `rig`.

    Example: aerodima scenarios list
    """
    from aerodima.workbench.scenario.rig_scenario import RigScenario
    from aerodima.workbench.scenario.scenario import Scenario

    cars = []
    for name in Scenario.names():
        car = Scenario.load(name)
        speed = shown_value(car.manoeuvre.speed)
        cars.append([name, car.name, car.manoeuvre.kind, speed, car.tail.mode])
    rigs = []
    for name in RigScenario.names():
        rig = RigScenario.load(name)
        rigs.append([name, rig.name, rig.experiment.kind])
    table = text_table(["scenario", "name", "manoeuvre", "speed_m_per_s", "tail"], cars)
    typer.echo("\n".join([*table, "", *text_table(["rig", "name", "experiment"], rigs)]))


def live_view(port: int | None = None) -> Meshcat:
    """Open Meshcat and print where to watch."""
    from aerodima.workbench.view.viewer import open_meshcat

    meshcat = open_meshcat(port)
    typer.echo(f"watch: {meshcat.web_url()}", err=True)
    return meshcat


def show_progress(what: str = "simulating", unit: str = " s") -> Progress | None:
    """Make a progress line on stderr if that is a terminal; None otherwise."""
    if not sys.stderr.isatty():
        return None

    def progress(time: float, length: float) -> None:
        end = "\r" if time + 0.1 < length else "\r\x1b[K"
        print(f"{what} {time:5.1f} of {length:.1f}{unit}", end=end, file=sys.stderr, flush=True)

    return progress


def summary_lines(run_log: RunLog) -> list[str]:
    """Tabulate a run: its outcome, the first metrics, and the flow at the sail's sections."""
    from aerodima.workbench.view.captions import outcome_in_words

    metrics = workbench.metrics_of(run_log)
    row = metrics.as_row()
    shown = {name: row[name] for name in SHOWN_METRICS}
    shown |= {name: run_log.extra[name] for name in SHOWN_FACTS if name in run_log.extra}
    table = text_table(
        ["", run_log.scenario["name"]],
        [[name, shown_value(value)] for name, value in shown.items()],
    )
    lines = [f"outcome: {outcome_in_words(metrics.outcome)}"]
    if run_log.scenario["tail"]["mode"] == "swing":
        roll = run_log.signal("tail_roll_angle_rad")
        if roll.max() - roll.min() < _MIN_SWING:
            lines.append("note: the tail did not swing, since its law saw no reason to")
    return [*lines, *table]
