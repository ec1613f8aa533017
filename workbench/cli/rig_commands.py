"""`aerodima rig run static|flick|bar|robot`: one experiment on a wind-tunnel rig with its log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima.workbench.atomic_write import refuse_existing
from aerodima.workbench.cli.options import COEFFICIENTS, Anew, Force, Live, Workers, command_group, grouped
from aerodima.workbench.errors import LogError, UserError

if TYPE_CHECKING:
    from aerodima.workbench.logs.schema import RunLog

Tail = Annotated[int | None, typer.Option(help="Cheetah tail: 1, 2 or 3.")]
Axis = Annotated[str | None, typer.Option(help="major or minor: the width that faces the wind.")]
Wind = Annotated[float | None, typer.Option(help="Wind speed, m/s.")]
RigSettings = Annotated[
    list[str] | None, typer.Option("--set", help="Override such as maxon.torque_constant=0.35; may be repeated.")
]

KINDS = {"static": "static", "flick": "swing", "bar": "bar_swing", "robot": "robot_swing"}
"""Name of the command, and of its scenario -> kind of the experiment."""


@dataclass(frozen=True)
class ExperimentOptions:
    """What every experiment can be told."""

    out: Annotated[Path, typer.Option(help="The log (Parquet).")]
    angle: Annotated[
        float | None, typer.Option(help="Angle held, or start of the swing, in degrees; 0 hangs straight down.")
    ] = None
    seed: Annotated[int | None, typer.Option(help="Seed of bias, drift and noise.")] = None
    duration: Annotated[float | None, typer.Option(help="Length of the log, s.")] = None
    scenario: Annotated[
        str | None, typer.Option("--scenario", help="Rig scenario file (YAML) in place of the one that ships.")
    ] = None
    settings: RigSettings = None
    force: Force = False


def register(app: typer.Typer) -> None:
    """Adds the command group `rig` with its group `run`."""
    group = command_group(app, "rig", "Work with the wind-tunnel rigs.", COEFFICIENTS)
    run = command_group(group, "run", "Run an experiment on a rig and write its log.")
    for command in (static, flick, bar, robot):
        run.command()(command)
    group.command()(campaign)


@grouped
def static(
    options: ExperimentOptions,
    tail: Tail = None,
    axis: Axis = None,
    wind: Wind = None,
    rest: Annotated[float | None, typer.Option(help="Rest without wind at the start of the log, s.")] = None,
) -> None:
    """Hold a cheetah tail still in the wind (thesis section 4.4).

    Example: aerodima rig run static --tail 1 --axis major --wind 10 --angle 15 --rest 2 --out hold.parquet
    """
    _run("static", options, tail=tail, axis=axis, wind_speed=wind, wind_off=rest)


@grouped
def flick(
    options: ExperimentOptions, tail: Tail = None, axis: Axis = None, wind: Wind = None, live: Live = False
) -> None:
    """Swing a cheetah tail from 90 degrees to straight down (thesis sections 4.7 to 4.9)."""
    _run("flick", options, live, tail=tail, axis=axis, wind_speed=wind)


@grouped
def bar(options: ExperimentOptions, live: Live = False) -> None:
    """Let the bare bar go in still air: its swing shows the friction (thesis section 4.7)."""
    _run("bar", options, live)


@grouped
def robot(
    options: ExperimentOptions,
    kp: Annotated[
        float | None, typer.Option(help="Position gain of the AK70-10, N m/rad; 4 and 10 in the thesis.")
    ] = None,
    wind: Wind = None,
    live: Live = False,
) -> None:
    """Swing the robot's tail from about 50 degrees to straight down (thesis section 6.3)."""
    _run("robot", options, live, [] if kp is None else [f"robot.kp={kp}"], wind_speed=wind)


def campaign(
    name: Annotated[str, typer.Argument(help="static, flick, bar, robot, or a campaign file (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder for the logs and campaign.csv.")],
    seed: Annotated[int, typer.Option(help="Seed of the truth and the sensor errors of all logs.", min=0)] = 1,
    repeats: Annotated[int | None, typer.Option(help="Logs per experiment in place of the campaign's.", min=1)] = None,
    settings: RigSettings = None,
    workers: Workers = 2,
    force: Anew = False,
) -> None:
    """Make all the logs of a campaign, such as the 540 published static holds.

    Asked for again after Ctrl-C it keeps the finished logs and goes on.
    Example: aerodima rig campaign static --out holds
    """
    from aerodima.workbench.batch.row_store import terminal
    from aerodima.workbench.config.rig_campaign import campaign_tasks, load_campaign
    from aerodima.workbench.simulate.campaign_run import run_campaign

    start = time.monotonic()
    tasks = campaign_tasks(load_campaign(name), seed, repeats, settings or ())
    result = run_campaign(tasks, out, workers=workers, force=force, progress=terminal())
    if result.reused:
        typer.echo(f"{result.reused} of {len(tasks)} logs were there before")
    for log, reason in result.failed.items():
        typer.echo(f"warning: {log}: {reason}", err=True)
    typer.echo(f"{len(result.logs)} logs in {out} ({time.monotonic() - start:.0f} s)")
    if result.failed:
        raise UserError(f"{len(result.failed)} of {len(tasks)} logs could not be made; the reasons are above")


def _run(
    name: str,
    options: ExperimentOptions,
    live: bool = False,
    more: Sequence[str] = (),
    **given: float | int | str | None,
) -> None:
    """given: keys of the experiment; None: as in the scenario."""
    from aerodima.workbench.cli.turn_commands import live_view, show_progress
    from aerodima.workbench.config.rig_scenario import load_rig_scenario
    from aerodima.workbench.simulate.simulation import simulate

    refuse_existing(options.out, options.force, LogError)
    given["angle"] = None if options.angle is None else radians(options.angle)
    given["duration"] = options.duration
    flags = [f"experiment.{key}={value!r}" for key, value in given.items() if value is not None]
    seeded = [] if options.seed is None else [f"seed={options.seed}"]
    resolved = load_rig_scenario(options.scenario or name, [*flags, *more, *seeded, *(options.settings or [])])
    if resolved.experiment.kind != KINDS[name]:
        raise UserError(
            f"{options.scenario or name}: experiment.kind: {resolved.experiment.kind!r}; "
            f"allowed for `rig run {name}`: {KINDS[name]!r}"
        )
    log = simulate(
        resolved,
        options.out,
        force=options.force,
        meshcat=live_view() if live else None,
        real_time_rate=float(live),
        progress=show_progress(),
    )
    for line in summary_lines(log):
        typer.echo(line)
    typer.echo(f"log: {options.out}")


def summary_lines(log: RunLog) -> list[str]:
    """What an experiment came to, for the terminal."""
    import numpy as np

    extra, angle = log.extra, log.signal("angle_rad")
    mounted = {"robot": "robot tail", "none": "bare bar"}.get(
        extra["tail"], f"tail {extra['tail']}, {extra['axis']} axis"
    )
    lines = [
        f"{log.kind}: {mounted}, wind {extra['wind_speed_m_per_s']:g} m/s, {log.time[-1]:g} s at {_rate(log):g} Hz"
    ]
    if log.kind == "static":
        exposed = "" if extra["exposed"] else "; no part of the tail is in the jet"
        _, rest = extra.get("rest_s", (0.0, -1.0))
        held = log.time > rest
        rested = f", after {rest:g} s without wind" if rest > 0.0 else ""
        lines.append(
            f"angle {degrees(angle[0]):.2f} deg, mean current {np.mean(log.signal('current_a')[held]):.3f} A"
            f"{rested}{exposed}"
        )
    else:
        rate = log.signal("angular_velocity_rad_per_s")
        lines.append(
            f"angle from {degrees(angle[0]):.1f} to {degrees(angle[-1]):.1f} deg, largest rate "
            f"{np.max(np.abs(rate)):.2f} rad/s, largest current {np.max(np.abs(log.signal('current_a'))):.2f} A"
        )
    force = log.vector("force", "n")
    lines.append(
        "mean reading F " + ", ".join(f"{value:.2f}" for value in force.mean(axis=0)) + " N (zeroed and biased)"
    )
    return lines


def _rate(log: RunLog) -> float:
    return round((len(log.time) - 1) / (log.time[-1] - log.time[0]), 3)
