"""`aerodima demo`, `turn`, `straight` and `slalom`: simulated runs with their logs, metrics and replays."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima.workbench.atomic_write import make_folder, refuse_existing
from aerodima.workbench.cli.options import (
    RUNS,
    Anew,
    Force,
    Html,
    Law,
    Live,
    OtherCar,
    ScenarioOption,
    Settings,
    SwingOption,
    SwingScenarioOption,
    Workers,
    completer,
    grouped,
)
from aerodima.workbench.errors import LogError, UserError

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from aerodima.workbench.config.scenario import Scenario
    from aerodima.workbench.controllers.tail_law import TailLaw
    from aerodima.workbench.logs.schema import RunLog
    from aerodima.workbench.simulate.car_run import Progress


@dataclass(frozen=True)
class RunOptions:
    """What a run changes in its scenario, and what is kept and shown of it."""

    speed: Annotated[float | None, typer.Option(help="Commanded speed, m/s.")] = None
    tail: Annotated[
        str | None,
        typer.Option(
            metavar="none|held|swing", help="What the tail does.", autocompletion=completer("none", "held", "swing")
        ),
    ] = None
    law: Law = None
    settings: Settings = None
    log: Annotated[Path | None, typer.Option(help="Keep the run log as this Parquet file.")] = None
    replay: Html = None
    live: Live = False
    port: Annotated[int | None, typer.Option(help="Port of Meshcat on 127.0.0.1.")] = None
    force: Force = False


def register(app: typer.Typer) -> None:
    """Adds the four commands."""
    app.command(rich_help_panel=RUNS)(demo)
    app.command(rich_help_panel=RUNS)(turn)
    app.command(rich_help_panel=RUNS)(straight)
    app.command(rich_help_panel=RUNS)(slalom)


def demo(
    out: Annotated[Path, typer.Option(help="Folder for page, table, replays and logs.")] = Path("out/demo"),
    workers: Workers = 2,
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = 1,
    force: Anew = False,
) -> None:
    """One short turn of four cars in step, then the thesis' own turn at four speeds, and a page on both.

    Asked for again after Ctrl-C it keeps the finished runs and goes on. Example: aerodima demo --out out/demo
    """
    from aerodima.workbench.batch.row_store import terminal
    from aerodima.workbench.report.demo import DemoPlan, make_demo

    start = time.monotonic()
    page = make_demo(out, DemoPlan(seed=seed), workers=workers, force=force, progress=terminal())
    typer.echo(f"page: {page} ({time.monotonic() - start:.0f} s)")


@grouped
def turn(
    options: RunOptions,
    tail_speed: Annotated[float | None, typer.Option(help="Commanded roll rate of the swing, rad/s.")] = None,
    swing: SwingOption = None,
    other_car: OtherCar = False,
    direction: Annotated[
        str | None,
        typer.Option(metavar="left|right", help="Side of the turn.", autocompletion=completer("left", "right")),
    ] = None,
    scenario: SwingScenarioOption = None,
) -> None:
    """Drive the published turn: up to speed in 2 s, 30 degrees of steering for 0.5 s, straight on.

    A swing file brings its own car, turn, speed and claimed grip along, unless --scenario names another turn.

    Example: aerodima turn --speed 4.44 --tail swing --log run.parquet --replay run.html
    """
    flags = {
        "--tail-speed": ("controller.swing_speed", tail_speed),
        "--swing": ("controller.swing_file", swing),
        "--direction": ("manoeuvre.direction", direction),
    }
    if options.law is not None and swing is not None:
        raise UserError("--law: allowed without --swing; each says what the tail does")
    if swing is None and other_car:
        raise UserError("--other-car: allowed together with --swing")
    own: tuple[str, ...] = ()
    if swing is not None:
        from aerodima.workbench.controllers.law_of_scenario import find_swing, own_turn

        scenario, own = own_turn(find_swing(swing), scenario)
    _run(scenario or "turn_swing", flags, options, other_car, own)


@grouped
def straight(options: RunOptions, scenario: ScenarioOption = "straight") -> None:
    """Drive straight ahead at constant throttle (thesis section 6.2)."""
    _run(scenario, {}, options)


@grouped
def slalom(options: RunOptions, scenario: ScenarioOption = "slalom") -> None:
    """Drive with sinusoidal steering of +-30 degrees (thesis section 6.1.3)."""
    _run(scenario, {}, options)


Flags = dict[str, tuple[str, float | str | None]]
"""Flag -> key of the scenario that it sets, and its value."""


def _run(name: str, flags: Flags, options: RunOptions, other_car: bool = False, own: tuple[str, ...] = ()) -> None:
    # What can be wrong is looked at before Drake is imported, which takes seconds.
    log, replay = options.log, options.replay
    if options.port is not None and not options.live:
        raise UserError("--port: it names the port of the live view; allowed together with --live")
    scenario = _scenario(name, flags, options, own)
    law = None if options.law is None else _own_law(options.law, scenario)
    if law is None and not other_car:
        from aerodima.workbench.controllers.law_of_scenario import refuse_other_car

        refuse_other_car(scenario)
    if log is not None:
        refuse_existing(log, options.force, LogError)
    if replay is not None:
        if log is not None and log.resolve() == replay.resolve():
            raise UserError(f"--replay {replay}: is the file of --log too; allowed: two names")
        refuse_existing(replay, options.force, UserError)
        make_folder(replay.parent, UserError)
    new_folder = "" if log is None or log.parent.exists() else " (in a new folder)"
    run_log = _simulated(scenario, options, law)
    for line in [*_turn_line(scenario, own), *summary_lines(run_log)]:
        typer.echo(line)
    if log is not None:
        typer.echo(f"log: {log}{new_folder}")
    if replay is not None:
        from aerodima.workbench.report.replay_page import write_replay_html

        write_replay_html(run_log, replay, force=options.force)
        typer.echo(f"replay: {replay}")


def _turn_line(scenario: Scenario, own: tuple[str, ...]) -> list[str]:
    """Which turn a swing brought along, and what it claims to survive; nothing without a swing."""
    from aerodima.workbench.controllers.law_of_scenario import swing_of_scenario, turn_words

    swing = swing_of_scenario(scenario) if own else None
    return [] if swing is None else [f"turn: {scenario.name}, {turn_words(swing, scenario)}"]


def _scenario(name: str, flags: Flags, options: RunOptions, own: tuple[str, ...] = ()) -> Scenario:
    """The scenario with what the flags set, whose run has a whole turn if it has one: another has no metrics.

    `own` are settings below the flags, of a swing file.
    """
    from aerodima.workbench.config.scenario import Scenario
    from aerodima.workbench.controllers.manoeuvre import angle_to_straighten

    flags = {"--speed": ("manoeuvre.speed", options.speed), "--tail": ("tail.mode", options.tail), **flags}
    given = {flag: (key, value) for flag, (key, value) in flags.items() if value is not None}
    settings = options.settings or []
    said = [*(f"{flag} {value}" for flag, (_, value) in given.items()), *(f"--set {setting}" for setting in settings)]
    changes = [*own, *(f"{key}={value}" for key, value in given.values()), *settings]
    scenario = Scenario.load(name, changes, source_label=" ".join(said))
    manoeuvre, rate = scenario.manoeuvre, scenario.servo.rate
    angle = angle_to_straighten(
        manoeuvre.steer_angle, manoeuvre.turn_hold, rate, manoeuvre.first_angle, manoeuvre.first_hold
    )
    end = manoeuvre.turn_start + manoeuvre.turn_hold + angle / rate
    if manoeuvre.kind == "turn" and manoeuvre.duration < end:
        raise UserError(f"manoeuvre.duration: {manoeuvre.duration:g} s; allowed: >= {end:g} s, the end of the turn")
    return scenario


def _simulated(scenario: Scenario, options: RunOptions, law: TailLaw | None) -> RunLog:
    from aerodima.workbench.logs.journal import journal_path
    from aerodima.workbench.simulate.simulation import simulate

    try:
        return simulate(
            scenario,
            options.log,
            law=law,
            force=options.force,
            meshcat=live_view(options.port) if options.live else None,
            real_time_rate=float(options.live),
            progress=show_progress(),
        )
    except KeyboardInterrupt:
        if options.log is not None:
            typer.echo(f"the rows so far are kept: aerodima log recover {journal_path(options.log)}", err=True)
        raise


def _own_law(place: str, scenario: Scenario) -> TailLaw:
    from aerodima.workbench.controllers.law_of_scenario import load_law

    if scenario.tail.mode == "none":
        raise UserError(f"--law {place}: this car has no tail; allowed with --tail held or --tail swing")
    return load_law(place)


def live_view(port: int | None = None) -> Meshcat:
    """Opens Meshcat and says where to watch."""
    from aerodima.workbench.replay.viewer import open_meshcat

    meshcat = open_meshcat(port)
    typer.echo(f"watch: {meshcat.web_url()}", err=True)
    return meshcat


def show_progress(what: str = "simulating", unit: str = " s") -> Progress | None:
    """A progress line on stderr when that is a terminal; None otherwise."""
    if not sys.stderr.isatty():
        return None

    def progress(time: float, length: float) -> None:
        end = "\r" if time + 0.1 < length else "\r\x1b[K"
        print(f"{what} {time:5.1f} of {length:.1f}{unit}", end=end, file=sys.stderr, flush=True)

    return progress


def summary_lines(run_log: RunLog) -> list[str]:
    """What a run came to, for the terminal."""
    from aerodima.workbench.metrics.turn_metrics import jolt_line, metrics_of
    from aerodima.workbench.metrics.turn_signals import turn_signals

    metrics = metrics_of(run_log)
    outcome, raw = metrics.outcome, metrics.raw
    result = outcome.result + ("" if outcome.result == "flipped" else ", clean" if outcome.clean else ", not clean")
    touched = f"; touched the ground: {', '.join(outcome.touched)}" if outcome.touched else ""
    board = outcome.board_before_turn_s
    started = f"; anti-ramp board on the ground for {board:.2f} s before the turn" if board else ""
    lines = [f"outcome: {result}{touched}{started}"]
    peak_roll = f"peak roll {degrees(metrics.peak_roll_rad):.1f} deg"
    if run_log.scenario["manoeuvre"]["kind"] in ("turn", "auto_turn"):
        heading = f"heading change {degrees(metrics.heading_change_rad):.0f} deg"
        lines.append(f"speed at the turn {raw.speed_m_per_s:.2f} m/s, {heading}, {peak_roll}")
    else:
        lines.append(f"speed {float(turn_signals(run_log).speed[-1]):.2f} m/s at the end, {peak_roll}")
    lines.append(
        f"yaw rate max {raw.max_yaw_rate_rad_per_s:.2f}, mean {raw.average_yaw_rate_rad_per_s:.2f} rad/s; lateral "
        f"acceleration max {raw.max_linear_acceleration_m_per_s2:.2f}, mean "
        f"{raw.average_linear_acceleration_m_per_s2:.2f} m/s2 (unfiltered {metrics.source})"
    )
    jolt = jolt_line(metrics)
    return [*lines, *([f"note: {jolt}"] if jolt else []), *_air_lines(run_log.extra)]


def _air_lines(extra: dict[str, Any]) -> list[str]:
    """What the sail's sections met, for a simulated car with a tail."""
    if "largest_reynolds_number" not in extra:
        return []
    outside, fast = extra["sections_outside_measured_range"], extra["sections_above_quasi_steady_limit"]
    line = f"sail: Reynolds number up to {extra['largest_reynolds_number']:.0f}"
    if outside > 0.0:
        line += f"; outside the measured range of its coefficients {outside:.0%} of the time (edge value held)"
    if fast > 0.0:
        line += f"; faster than the quasi-steady model was shown to hold {fast:.0%} of the time"
    return [line]
