"""`aerodima rig`: one experiment on a wind-tunnel rig with its log."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.text_table import shown_value, text_table, value_rows

if TYPE_CHECKING:
    from aerodima.workbench.logs.schema import RunLog

SHOWN_FACTS = ("tail", "axis", "wind_speed_m_per_s", "exposed")
"""Keys of `extra` of a log that are shown; `exposed` is the part of the tail in the jet."""


@dataclass(frozen=True)
class ExperimentOptions:
    """Changes to the scenario of an experiment, and the path of its log."""

    out: cli.LogOut
    tail: Annotated[
        int | None, cli.Key("experiment.tail"), typer.Option(help="Cheetah tail: 1, 2 or 3.")
    ] = None
    axis: Annotated[
        str | None,
        cli.Key("experiment.axis"),
        cli.chosen("Width that faces the wind.", "major", "minor"),
    ] = None
    wind: Annotated[
        float | None, cli.Key("experiment.wind_speed"), typer.Option(help="Wind speed, m/s.")
    ] = None
    angle: Annotated[
        float | None,
        typer.Option(help="Angle held, or start of the swing, in degrees; 0 hangs straight down."),
    ] = None
    rest: Annotated[
        float | None,
        cli.Key("experiment.wind_off"),
        typer.Option(help="Static: rest without wind at the start, s."),
    ] = None
    duration: Annotated[
        float | None, cli.Key("experiment.duration"), typer.Option(help="Length of the log, s.")
    ] = None
    seed: Annotated[
        int | None, cli.Key("seed"), typer.Option(help="Seed of bias, drift and noise.")
    ] = None
    settings: cli.RigSettings = None
    live: cli.Live = False
    force: cli.Force = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(rich_help_panel=cli.COEFFICIENTS, no_args_is_help=True)(rig)


@cli.grouped
def rig(
    scenario: Annotated[str, cli.named("Experiment", "scenarios/rig")],
    options: ExperimentOptions,
) -> None:
    """Run an experiment on a wind-tunnel rig and write its log.

    static holds a cheetah tail still in the wind (thesis 4.4), flick swings one from 90 degrees to
    straight down (4.7 to 4.9), bar lets the bare bar go in still air (4.7), robot swings the
    robot's tail from about 50 degrees (6.3).

    Example: aerodima rig static --tail 1 --axis major --wind 10 --angle 15 --rest 2 --out
    hold.parquet
    """
    from aerodima.workbench.cli.run_commands import live_view, show_progress

    refuse_existing(options.out, options.force, LogError)
    settings = cli.settings_of(options)
    if options.angle is not None:
        settings.insert(0, f"experiment.angle={radians(options.angle)!r}")
    log = workbench.simulate(
        workbench.load_rig_scenario(scenario, settings),
        options.out,
        force=options.force,
        meshcat=live_view() if options.live else None,
        real_time_rate=float(options.live),
        progress=show_progress(),
    )
    for line in summary_lines(log):
        typer.echo(line)
    typer.echo(f"log: {options.out}")


def summary_lines(log: RunLog) -> list[str]:
    """Tabulate an experiment: its facts, then mean and extremes of the signals."""
    from aerodima.workbench.scenario.signal_table import TIME

    facts = [[name, shown_value(log.extra[name])] for name in SHOWN_FACTS if name in log.extra]
    measured = log.table.drop(columns=TIME).agg(["mean", "min", "max"])
    signals = text_table(["", *measured.index], value_rows(measured.items()))
    return [*text_table(["kind", log.kind], facts), "", *signals]
